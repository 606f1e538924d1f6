"""From a window's raw measurements to what factors are made of."""

import math
import time
from collections import Counter
from concurrent.futures import Future
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.candidates.model import CoreKind, CoreMeasurement
from incremental_mapper.config import Config
from incremental_mapper.errors import MeasurementError
from incremental_mapper.frontend.gnss import Datum, checked_covariance
from incremental_mapper.frontend.lidar_odometry import PreparedScan
from incremental_mapper.frontend.odometry_process import LocalStation, ProcessStation, ScanStation
from incremental_mapper.measurements import CoreInput, Drops, GnssFix, LidarScan


@dataclass(frozen=True, slots=True, eq=False)
class PreparedFix:
    """A fix as antenna position (3,) and covariance (3, 3) in local ENU, metres."""

    core: CoreMeasurement
    enu: NDArray[np.float64]
    covariance: NDArray[np.float64]


Prepared: TypeAlias = PreparedScan | PreparedFix


@dataclass(frozen=True, slots=True, eq=False)
class Preparation:
    """Core measurements of a window that are being prepared, in time order.

    ``seconds`` is what it took to begin with them.
    """

    items: tuple[tuple[CoreInput, 'Future[PreparedScan] | PreparedFix'], ...]
    seconds: float

    @property
    def done(self) -> bool:
        """Whether nothing needs to be waited for."""
        return all(not isinstance(item, Future) or item.done() for _, item in self.items)


class FrontEnd:
    """Scan matching per LiDAR, and fixes in local ENU around the first one used."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._stations: dict[str, ScanStation] = {}
        self.datum: Datum | None = None
        self._altitude = math.nan  # of the newest fix that has one
        self.drops: Drops = Counter()
        self.notes: Counter[str] = Counter()  # what was used, but not in full
        if config.odometry.processes:
            for name in config.lidars:  # they take a second or two to start
                self._station(name)

    def start(self, core: tuple[CoreInput, ...]) -> Preparation:
        """Begin to prepare a window's core measurements; fixes that cannot be used are counted.

        Args:
            core: Scans and fixes in time order; each LiDAR's scans over all calls too.

        Returns:
            What ``collect`` waits for.
        """
        began = time.perf_counter()
        items: list[tuple[CoreInput, Future[PreparedScan] | PreparedFix]] = []
        for measurement in core:
            if isinstance(measurement, LidarScan):
                items.append((measurement, self._station(measurement.sensor).submit(measurement)))
                continue
            try:
                items.append((measurement, self._fix(measurement)))
            except MeasurementError as error:
                self.drops[measurement.sensor, error.reason] += 1
        return Preparation(tuple(items), time.perf_counter() - began)

    def collect(self, preparation: Preparation) -> list[Prepared]:
        """Wait for what was begun; scans that cannot be used are counted.

        Args:
            preparation: What ``start`` gave, each of them once and in that order.

        Returns:
            The usable measurements in time order: scans with their odometry, fixes in local ENU.
        """
        prepared: list[Prepared] = []
        for measurement, item in preparation.items:
            try:
                prepared.append(item.result() if isinstance(item, Future) else item)
            except MeasurementError as error:
                self.drops[measurement.sensor, error.reason] += 1
        return prepared

    def prepare(self, core: tuple[CoreInput, ...]) -> list[Prepared]:
        """Prepare a window's core measurements in time order."""
        return self.collect(self.start(core))

    def close(self) -> None:
        """End the processes, if there are any."""
        for station in self._stations.values():
            station.close()

    def _station(self, name: str) -> ScanStation:
        if name not in self._stations:
            kind = ProcessStation if self._config.odometry.processes else LocalStation
            self._stations[name] = kind(name, self._config, self.notes)
        return self._stations[name]

    def _fix(self, fix: GnssFix) -> PreparedFix:
        covariance = checked_covariance(fix, self._config.fixes)
        if math.isnan(fix.altitude):
            # The newest altitude is the best guess; its deviation says that it is no more.
            fix = replace(fix, altitude=self._altitude)
        elif math.isnan(self._altitude) and self.datum is not None:
            # Fixes without altitude came before: they were at height 0, and so is this one.
            self.datum = replace(self.datum, altitude=fix.altitude)
        self._altitude = fix.altitude
        if self.datum is None:
            altitude = 0.0 if math.isnan(fix.altitude) else fix.altitude
            self.datum = Datum(fix.latitude, fix.longitude, altitude)
        core = CoreMeasurement(fix.stamp, fix.sensor, CoreKind.GNSS)
        return PreparedFix(core, self.datum.enu(fix), covariance)
