"""From a window's raw measurements to what factors are made of."""

from collections import Counter
from dataclasses import dataclass
from typing import TypeAlias

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.candidates.clusters import CoreKind, CoreMeasurement
from incremental_mapper.config import Config
from incremental_mapper.errors import MeasurementError
from incremental_mapper.frontend.clouds import thin, to_base
from incremental_mapper.frontend.geodesy import Datum, checked_covariance
from incremental_mapper.mapper.lidar_chain import LidarChain
from incremental_mapper.measurements import Drops, GnssFix, LidarScan
from incremental_mapper.windows.buffer import CoreInput


@dataclass(frozen=True, slots=True, eq=False)
class PreparedScan:
    """A scan with its odometry.

    ``thinned`` (N, 3) are its points in base_link for the map, ``sparse`` (M, 3) those for
    scoring, metres.
    ``T_previous_current`` links it to the scan of the same LiDAR at ``previous``; both are None
    where there is no odometry. ``usable`` says that the next scan may link to this one.
    """

    core: CoreMeasurement
    thinned: NDArray[np.float64]
    sparse: NDArray[np.float64]
    previous: int | None
    T_previous_current: gtsam.Pose3 | None
    usable: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class PreparedFix:
    """A fix as antenna position (3,) and covariance (3, 3) in local ENU, metres."""

    core: CoreMeasurement
    enu: NDArray[np.float64]
    covariance: NDArray[np.float64]


Prepared: TypeAlias = PreparedScan | PreparedFix

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
            thinned=thinned,
            sparse=thin(thinned, self._sparse_voxel),
            previous=link.previous,
            T_previous_current=link.T_previous_current,
            usable=link.usable,
        )


class FrontEnd:
    """Scan matching per LiDAR, and fixes in local ENU around the first one used."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._preparers: dict[str, ScanPreparer] = {}
        self.datum: Datum | None = None
        self.drops: Drops = Counter()
        self.notes: Counter[str] = Counter()  # what was used, but not in full

    def prepare(self, core: tuple[CoreInput, ...]) -> list[Prepared]:
        """Prepare a window's core measurements in time order; the unusable are counted."""
        prepared: list[Prepared] = []
        for measurement in core:
            try:
                if isinstance(measurement, LidarScan):
                    prepared.append(self._scan(measurement))
                else:
                    prepared.append(self._fix(measurement))
            except MeasurementError as error:
                self.drops[measurement.sensor, error.reason] += 1
        return prepared

    def _fix(self, fix: GnssFix) -> PreparedFix:
        covariance = checked_covariance(fix, self._config.fixes)
        if self.datum is None:
            self.datum = Datum(fix.latitude, fix.longitude, fix.altitude)
        core = CoreMeasurement(fix.stamp, fix.sensor, CoreKind.GNSS)
        return PreparedFix(core, self.datum.enu(fix), covariance)

    def _scan(self, scan: LidarScan) -> PreparedScan:
        preparer = self._preparers.get(scan.sensor)
        if preparer is None:
            preparer = ScanPreparer(scan.sensor, self._config, self.notes)
            self._preparers[scan.sensor] = preparer
        return preparer.prepare(scan)
