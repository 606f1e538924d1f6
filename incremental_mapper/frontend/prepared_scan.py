"""A LiDAR's raw scans in, points in base_link with their odometry out: stage 3 for one LiDAR."""

from collections import Counter
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.candidates.model import CoreKind, CoreMeasurement
from incremental_mapper.config import Config
from incremental_mapper.errors import MeasurementError
from incremental_mapper.frontend.imu_preintegration import EMPTY_SERIES, ImuSeries
from incremental_mapper.frontend.lidar_odometry import LidarChain
from incremental_mapper.frontend.preprocessing import Sweep, to_base, warm_up
from incremental_mapper.measurements import LidarScan
from incremental_mapper.voxels import thin, voxel_means

FEWEST_PLACES = 10
"""Places, voxels with points, below which a cloud is no scan of anything: it cannot be matched
whatever the settings (``odometry.min_points``), and what it adds to a map is not worth a pose."""
MATCHING_SHARE = 0.3
"""Scans are thinned for the map before they are thinned again for matching: at most to this
share of the matcher's voxels, or a coarse map would cost odometry."""


@dataclass(frozen=True, slots=True, eq=False)
class PreparedScan:
    """A scan with its odometry.

    ``thinned`` (N, 3) are its points in base_link for the map, in the map's single precision; it
    is (N, 4) with their intensities where the LiDAR measures them. ``sparse`` (M, 3) are the points
    for scoring, metres.
    ``T_previous_current`` links it to the scan of the same LiDAR at ``previous``; both are None
    where there is no odometry. ``covariance`` (6, 6) is that of this motion, in the frame of the
    scan and in GTSAM's order, rotation before translation; None where the matcher does not tell.
    ``usable`` says that the next scan may link to this one.
    """

    core: CoreMeasurement
    thinned: NDArray[np.float32]
    sparse: NDArray[np.float64]
    previous: int | None
    T_previous_current: gtsam.Pose3 | None
    usable: bool = True
    covariance: NDArray[np.float64] | None = None


class ScanPreparer:
    """Thins, matches and deskews the scans of one LiDAR, in their order.

    It knows nothing of other sensors: what it takes and gives can be pickled, so it may as well
    live in a process of its own.
    """

    def __init__(self, name: str, config: Config, notes: Counter[str]) -> None:
        """Make ready for the LiDAR ``name``; ``notes`` counts what was used, but not in full."""
        warm_up()
        lidar = config.lidars.get(name)
        self._odometry = config.odometry
        self._T_base_lidar = np.eye(4) if lidar is None else lidar.matrix()
        self._map_voxel = config.map.voxel_size
        self._sparse_voxel = config.mom.voxel_size
        self._voxel = min(self._map_voxel, MATCHING_SHARE * config.odometry.voxel_size)
        self._chain = LidarChain(name, config, notes)

    def prepare(self, scan: LidarScan, imu: ImuSeries = EMPTY_SERIES) -> PreparedScan:
        """The next scan with its odometry.

        Args:
            scan: As the message has it.
            imu: The IMU's samples since the scan before, up to the end of the sweep.

        Returns:
            Its points in base_link and how it lies to the scan before.

        Raises:
            MeasurementError: No point is in range, or the points are in hardly any place.
        """
        return self.match(self.thinned(scan), imu)

    def thinned(self, scan: LidarScan) -> Sweep:
        """The points in range, thinned, for ``match``; knows nothing of the scans before.

        Args:
            scan: As the message has it.
        """
        odometry = self._odometry
        return to_base(
            scan,
            self._T_base_lidar,
            odometry.min_range,
            odometry.max_range,
            self._voxel,
            odometry.deskew,
        )

    def match(self, sweep: Sweep, imu: ImuSeries = EMPTY_SERIES) -> PreparedScan:
        """See ``prepare``, with what ``thinned`` has made of the scan.

        Raises:
            MeasurementError: No point is in range, or the points are in hardly any place.
        """
        self._chain.take(imu)
        if len(sweep) == 0:
            raise MeasurementError(
                'no_points_in_range', f'{sweep.sensor} at {sweep.stamp}: no point within range'
            )
        if len(sweep) < FEWEST_PLACES:
            raise MeasurementError(
                'too_few_points',
                f'{sweep.sensor} at {sweep.stamp}: points in {len(sweep)} places within range, '
                f'{FEWEST_PLACES} are the least',
            )
        link = self._chain.add(sweep)
        rows = link.points.T
        if sweep.intensities is not None:
            rows = np.vstack([rows, sweep.intensities])
        if self._map_voxel > self._voxel:
            rows = voxel_means(rows, self._map_voxel)
        return PreparedScan(
            core=CoreMeasurement(sweep.stamp, sweep.sensor, CoreKind.LIDAR),
            thinned=rows.T.astype(np.float32, order='C'),
            sparse=thin(rows[:3].T, self._sparse_voxel),
            previous=link.previous,
            T_previous_current=link.T_previous_current,
            usable=link.usable,
            covariance=link.covariance,
        )
