"""Measurements in, closed windows out, whose scans are being prepared meanwhile."""

from collections.abc import Sequence
from dataclasses import dataclass

from incremental_mapper.config import Config
from incremental_mapper.frontend.front_end import FrontEnd, Preparation
from incremental_mapper.mapping.imu_intake import ImuIntake
from incremental_mapper.mapping.load_shedding import LoadShedding
from incremental_mapper.mapping.same_stamp import prefer_usable
from incremental_mapper.mapping.scan_intake import ScanIntake
from incremental_mapper.mapping.window import Window, joined
from incremental_mapper.mapping.window_buffer import WindowBuffer
from incremental_mapper.measurements import Drops, ImuSample, LidarScan, Measurement

IMU = 'imu'
"""Name of the IMU among the sensors."""


@dataclass(frozen=True, slots=True, eq=False)
class ClosedWindow:
    """A window, or several as one, and what was begun with the measurements of each of them."""

    window: Window
    begun: tuple[Preparation, ...]


class MeasurementIntake:
    """Gathers measurements into windows, and has their scans prepared before they are asked for.

    ``front_end`` is what prepares them.
    """

    def __init__(self, config: Config, sensors: Sequence[str], predict: bool) -> None:
        """Make ready for the first measurement; processes of the front end may be started.

        Args:
            config: All settings.
            sensors: Names to wait for from the start.
            predict: Wait for no sensor beyond what is usual for it.
        """
        self._imu = ImuIntake(config.imu, config.preintegration.gravity)
        self._scans = ScanIntake(config.lidars)
        awaited = [name for name in sensors if name != IMU or config.imu.enabled]
        # Closed, and waiting for their scans, of so many bytes, or to be merged with the next.
        self._held: list[tuple[Window, Preparation, int]] = []
        self.front_end = FrontEnd(config, IMU in awaited)
        self._buffer = WindowBuffer(
            config.window,
            awaited,
            predict,
            better=prefer_usable(config),
            begin=self.front_end.begin if predict else None,
            sample=self.front_end.imu,
            restart=self.front_end.restart,
        )

    def push(self, measurement: Measurement) -> None:
        """Take in a measurement, and begin to prepare the scans of the windows that it closes.

        Args:
            measurement: A scan, a fix or an inertial sample, with its header stamp.
        """
        taken: Measurement | None = measurement
        if isinstance(measurement, ImuSample):
            taken = self._imu.take(measurement)
        elif isinstance(measurement, LidarScan):
            taken = self._scans.take(measurement)
        if taken is not None:
            self._buffer.push(taken)
        newest = self._buffer.newest
        if newest is not None:
            self.front_end.passed(newest)
        self._hold(self._buffer.pop_ready())

    def flush(self) -> None:
        """Close every open window without waiting for anything late."""
        self._hold(self._buffer.flush())

    @property
    def waits(self) -> bool:
        """Whether closed windows wait for their scans."""
        return bool(self._held)

    @property
    def late(self) -> int:
        """Core measurements that moved to a later window."""
        return self._buffer.late

    @property
    def drops(self) -> list[Drops]:
        """What was not used, by who left it out; they go on counting."""
        return [self._buffer.drops, self.front_end.drops, self._imu.drops, self._scans.drops]

    def ready(self, shedding: LoadShedding) -> bool:
        """Whether the oldest windows may run: as many as are merged into one.

        Args:
            shedding: Limits what is spent on the windows.

        Returns:
            Whether their scans are prepared, or enough others wait behind them.
        """
        count = shedding.windows
        if len(self._held) < count:
            return False
        oldest = [preparation for _, preparation, _ in self._held[:count]]
        if any(self.front_end.awaits_imu(preparation) for preparation in oldest):
            return False  # what they get must not depend on how far others have come
        if all(preparation.done for preparation in oldest):
            return True
        behind = [nbytes for _, _, nbytes in self._held[count:]]
        return len(behind) > shedding.read_ahead or sum(behind) > shedding.most_bytes

    def next(self, count: int) -> ClosedWindow:
        """Let go of the oldest ``count`` windows that wait, as one; at least one waits."""
        taken, self._held = self._held[:count], self._held[count:]
        return ClosedWindow(
            joined([window for window, _, _ in taken]), tuple(begun for _, begun, _ in taken)
        )

    def close(self) -> None:
        """Let go of processes and threads; nothing may be pushed afterwards."""
        self.front_end.close()

    def _hold(self, windows: Sequence[Window]) -> None:
        """Begin to prepare the scans of closed windows."""
        self._held += [
            (window, self.front_end.start(window.core), window.nbytes) for window in windows
        ]
