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
from incremental_mapper.frontend.clouds import BaseScan, Twist, thin, to_base
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


class FrontEnd:
    """Scan matching per LiDAR, and fixes in local ENU around the first one used."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._chains: dict[str, LidarChain] = {}
        self._T_base_lidar = {name: lidar.matrix() for name, lidar in config.lidars.items()}
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
        chain = self._chains.get(scan.sensor)
        if chain is None:
            chain = LidarChain(scan.sensor, self._config.odometry, self._place, self.notes)
            self._chains[scan.sensor] = chain
        link = chain.add(scan)
        if len(link.base.points) == 0:
            raise MeasurementError(
                'no_points_in_range', f'{scan.sensor} at {scan.stamp}: no point within range'
            )
        thinned = link.base.thinned
        return PreparedScan(
            core=CoreMeasurement(scan.stamp, scan.sensor, CoreKind.LIDAR),
            thinned=thinned,
            sparse=thin(thinned, self._config.mom.voxel_size),
            previous=link.previous,
            T_previous_current=link.T_previous_current,
            usable=link.usable,
        )

    def _place(self, scan: LidarScan, twist: Twist, at_stamp: bool) -> BaseScan:
        """A raw scan in base_link, deskewed by ``twist`` if the settings say so."""
        settings = self._config.odometry
        return to_base(
            scan,
            self._T_base_lidar.get(scan.sensor, np.eye(4)),
            settings.min_range,
            settings.max_range,
            self._config.map.voxel_size,
            twist if settings.deskew else None,
            at_stamp,
        )
