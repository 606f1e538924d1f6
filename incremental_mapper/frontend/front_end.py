"""From a window's raw measurements to what factors are made of."""

import time
from collections import Counter, deque
from collections.abc import Callable, Collection
from concurrent.futures import Future
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.candidates.model import CoreKind, CoreMeasurement
from incremental_mapper.checks.fix_covariance import checked_covariance
from incremental_mapper.config import Config
from incremental_mapper.errors import MeasurementError
from incremental_mapper.frontend.fix_gate import FixGate
from incremental_mapper.frontend.gnss import Datum, fixed_datum
from incremental_mapper.frontend.imu_supply import ImuSupply, sweep_end
from incremental_mapper.frontend.odometry_process import LocalStation, ProcessStation, ScanStation
from incremental_mapper.frontend.prepared_scan import PreparedScan
from incremental_mapper.measurements import (
    NANOSECONDS,
    CoreInput,
    Drops,
    GnssFix,
    ImuSample,
    LidarScan,
)


@dataclass(frozen=True, slots=True, eq=False)
class PreparedFix:
    """A fix as antenna position (3,) and covariance (3, 3) in local ENU, metres.

    ``doubtful`` ones may turn out wrong: they are hardly trusted.
    """

    core: CoreMeasurement
    enu: NDArray[np.float64]
    covariance: NDArray[np.float64]
    doubtful: bool = False


Prepared: TypeAlias = PreparedScan | PreparedFix
DENSEST = NANOSECONDS // 100
"""Nanoseconds between two fixes that are used, at least. No receiver measures more often, and a
window with dozens of them, each merged with its neighbours or not, cannot be searched."""


@dataclass(frozen=True, slots=True, eq=False)
class Preparation:
    """Core measurements of a window that are being prepared, in time order.

    A fix stands with its covariance (3, 3). ``seconds`` is what it took to begin with them.
    """

    items: tuple[tuple[CoreInput, 'Future[PreparedScan] | NDArray[np.float64]'], ...]
    seconds: float

    @property
    def done(self) -> bool:
        """Whether nothing needs to be waited for."""
        return all(not isinstance(item, Future) or item.done() for _, item in self.items)


@dataclass(frozen=True, slots=True, eq=False)
class _Waiting:
    """A scan that waits for the IMU to pass the end of its sweep, a stamp in ns."""

    scan: LidarScan
    end: int
    future: 'Future[PreparedScan]'


class FrontEnd:
    """Scan matching per LiDAR, and fixes in local ENU around the first one that holds."""

    def __init__(self, config: Config, imu_expected: bool = False) -> None:
        """Make ready for the first measurement.

        Args:
            config: All settings.
            imu_expected: Whether there is an IMU; without, scans wait for none until it has told.
        """
        self._config = config
        self._imu_expected = imu_expected
        self._imu = ImuSupply(imu_expected, config.window.lateness)
        self._waiting: dict[str, deque[_Waiting]] = {}
        self._stations: dict[str, ScanStation] = {}
        self._begun: dict[tuple[str, int], tuple[LidarScan, Future[PreparedScan]]] = {}
        self.gate = FixGate(
            config.fixes,
            config.gnss.matrix()[:3, 3],
            config.odometry.method,
            fixed_datum(config.datum),
            config.gnss.time_offset,
            {name: lidar.scale for name, lidar in config.lidars.items()},
        )
        self._newest_fix = -DENSEST  # stamp of the newest one that is used
        self.drops: Drops = Counter()
        self.notes: Counter[str] = Counter()  # what was used, but not in full
        if config.odometry.processes:
            for name in config.lidars:  # they take a second or two to start
                self._station(name)

    @property
    def datum(self) -> Datum | None:
        """Origin of ENU as the larger part of the fixes has it, None before the first one."""
        return self.gate.datum

    def begin(self, measurement: CoreInput) -> None:
        """Begin to prepare a scan before its window is closed.

        Args:
            measurement: The next one of its LiDAR; fixes take no time and are left alone.
        """
        if isinstance(measurement, LidarScan):
            future = self._submit(measurement)
            self._begun[measurement.sensor, measurement.stamp] = (measurement, future)

    def imu(self, sample: ImuSample) -> None:
        """Take in a sample of the IMU: scans are guessed and deskewed by it.

        Args:
            sample: In rad/s and m/s^2.
        """
        if self._config.odometry.imu_guess:
            self._imu.add(sample)
            self._release()

    def restart(self) -> None:
        """Forget what was begun and all samples; to be called before the first ``start``."""
        self._imu = ImuSupply(self._imu_expected, self._config.window.lateness)
        self._waiting = {}
        spoiled = {sensor for sensor, _ in self._begun}
        self._begun = {}
        self.notes = Counter()
        for name in spoiled & self._stations.keys():
            self._stations.pop(name).close()
            if self._config.odometry.processes:
                self._station(name)

    def passed(self, newest: int) -> None:
        """Take note of the newest stamp (ns) of all sensors, by which a silent IMU is told."""
        self._imu.passed(newest)
        self._release()

    def awaits_imu(self, preparation: Preparation) -> bool:
        """Whether a scan of a window still waits for the IMU to pass its end."""
        waiting = {id(item.future) for queue in self._waiting.values() for item in queue}
        return any(id(item) in waiting for _, item in preparation.items)

    def start(self, core: tuple[CoreInput, ...]) -> Preparation:
        """Begin to prepare a window's core measurements; fixes that cannot be used are counted.

        Args:
            core: Scans and fixes in time order; each LiDAR's scans over all calls too.

        Returns:
            What ``collect`` waits for.
        """
        began = time.perf_counter()
        items: list[tuple[CoreInput, Future[PreparedScan] | NDArray[np.float64]]] = []
        for measurement in core:
            if isinstance(measurement, LidarScan):
                items.append((measurement, self._future(measurement)))
                continue
            try:
                covariance = checked_covariance(measurement, self._config.fixes)
                items.append((measurement, covariance))
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
            if isinstance(measurement, LidarScan):
                self._release(measurement)
            try:
                prepared.append(self._collected(measurement, item))
            except MeasurementError as error:
                self.drops[measurement.sensor, error.reason] += 1
        return prepared

    def prepare(self, core: tuple[CoreInput, ...]) -> list[Prepared]:
        """Prepare a window's core measurements in time order."""
        return self.collect(self.start(core))

    def refound(
        self, refuted: Collection[int]
    ) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
        """Count fixes that proved wrong after they were handed on, and leave their datum.

        Args:
            refuted: Their stamps, ns, as the gate told them.

        Returns:
            What moves a position (3,) from ENU so far to ENU from now on, metres.
        """
        self.drops[self.gate.sensor, 'datum_outlier'] += len(refuted)
        return self.gate.refound()

    def close(self) -> None:
        """End the processes, if there are any."""
        for station in self._stations.values():
            station.close()

    def _future(self, scan: LidarScan) -> 'Future[PreparedScan]':
        """What a scan will become, whether it was begun or not."""
        begun, future = self._begun.pop((scan.sensor, scan.stamp), (None, None))
        # Of two with one stamp the other one may have been handed out.
        if begun is not scan or future is None:
            return self._submit(scan)
        return future

    def _submit(self, scan: LidarScan) -> 'Future[PreparedScan]':
        """Hand over a scan once the IMU has passed the end of its sweep."""
        if not self._config.odometry.imu_guess:
            return self._station(scan.sensor).submit(scan)
        item = _Waiting(scan, sweep_end(scan), Future())
        self._waiting.setdefault(scan.sensor, deque()).append(item)
        self._release()
        return item.future

    def _release(self, needed: LidarScan | None = None) -> None:
        """Hand over the scans that need not wait any longer, and one that is needed now."""
        for sensor, queue in self._waiting.items():
            forced = needed is not None and any(item.scan is needed for item in queue)
            while queue and (forced or self._imu.complete(queue[0].end)):
                item = queue.popleft()
                forced = forced and item.scan is not needed
                samples = self._imu.take(sensor, item.end)
                made = self._station(sensor).submit(item.scan, samples)
                made.add_done_callback(_handing_on(item.future))

    def _station(self, name: str) -> ScanStation:
        if name not in self._stations:
            kind = ProcessStation if self._config.odometry.processes else LocalStation
            self._stations[name] = kind(name, self._config, self.notes)
        return self._stations[name]

    def _collected(
        self, measurement: CoreInput, item: 'Future[PreparedScan] | NDArray[np.float64]'
    ) -> Prepared:
        if isinstance(item, Future):
            scan = item.result()
            self.gate.scan(scan)
            return scan
        assert isinstance(measurement, GnssFix)
        if 0 <= measurement.stamp - self._newest_fix < DENSEST:
            raise MeasurementError(
                'too_dense', f'{measurement.sensor} at {measurement.stamp}: within 10 ms of another'
            )
        judged = self.gate.fix(measurement, item)
        self._newest_fix = measurement.stamp
        core = CoreMeasurement(measurement.stamp, measurement.sensor, CoreKind.GNSS)
        return PreparedFix(core, judged.enu, judged.covariance, judged.doubtful)


def _handing_on(promise: 'Future[PreparedScan]') -> Callable[['Future[PreparedScan]'], None]:
    """What gives a future's outcome to another one."""

    def hand_on(made: 'Future[PreparedScan]') -> None:
        if made.cancelled():
            promise.cancel()
        elif (error := made.exception()) is not None:
            promise.set_exception(error)
        else:
            promise.set_result(made.result())

    return hand_on
