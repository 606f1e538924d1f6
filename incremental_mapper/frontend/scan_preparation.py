"""From a LiDAR's raw scans to points in base_link with their odometry."""

from collections import Counter
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.candidates.model import CoreKind, CoreMeasurement
from incremental_mapper.config import Config
from incremental_mapper.errors import MeasurementError
from incremental_mapper.frontend.lidar_odometry import LidarChain
from incremental_mapper.frontend.preprocessing import to_base
from incremental_mapper.measurements import LidarScan
from incremental_mapper.voxels import thin


@dataclass(frozen=True, slots=True, eq=False)
class PreparedScan:
    """A scan with its odometry.

    ``thinned`` (N, 3) are its points in base_link for the map, in the map's single precision,
    ``sparse`` (M, 3) those for scoring, metres.
    ``T_previous_current`` links it to the scan of the same LiDAR at ``previous``; both are None
    where there is no odometry. ``usable`` says that the next scan may link to this one.
    """

    core: CoreMeasurement
    thinned: NDArray[np.float32]
    sparse: NDArray[np.float64]
    previous: int | None
    T_previous_current: gtsam.Pose3 | None
    usable: bool = True


MATCHING_SHARE = 0.3
"""Scans are thinned for the map before they are thinned again for matching: at most to this
share of the matcher's voxels, or a coarse map would cost odometry."""


class ScanPreparer:
    """Thins, matches and deskews the scans of one LiDAR, in their order.

    It knows nothing of other sensors: what it takes and gives can be pickled, so it may as well
    live in a process of its own.
    """

    def __init__(self, name: str, config: Config, notes: Counter[str]) -> None:
        """Make ready for the LiDAR ``name``; ``notes`` counts what was used, but not in full."""
        lidar = config.lidars.get(name)
        self._odometry = config.odometry
        self._T_base_lidar = np.eye(4) if lidar is None else lidar.matrix()
        self._map_voxel = config.map.voxel_size
        self._sparse_voxel = config.mom.voxel_size
        self._voxel = min(self._map_voxel, MATCHING_SHARE * config.odometry.voxel_size)
        self._chain = LidarChain(name, config.odometry, notes)

    def prepare(self, scan: LidarScan) -> PreparedScan:
        """The next scan with its odometry; raises MeasurementError where no point is in range."""
        odometry = self._odometry
        sweep = to_base(
            scan,
            self._T_base_lidar,
            odometry.min_range,
            odometry.max_range,
            self._voxel,
            odometry.deskew,
        )
        if len(sweep) == 0:
            raise MeasurementError(
                'no_points_in_range', f'{scan.sensor} at {scan.stamp}: no point within range'
            )
        link = self._chain.add(sweep)
        coarser = self._map_voxel > self._voxel
        thinned = thin(link.points, self._map_voxel) if coarser else link.points
        return PreparedScan(
            core=CoreMeasurement(scan.stamp, scan.sensor, CoreKind.LIDAR),
            thinned=thinned.astype(np.float32, order='C'),
            sparse=thin(thinned, self._sparse_voxel),
            previous=link.previous,
            T_previous_current=link.T_previous_current,
            usable=link.usable,
        )
