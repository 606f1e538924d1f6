"""Stamps that jump backwards: a looped bag, a clock that was set."""

from collections import Counter
from dataclasses import dataclass

from incremental_mapper.config import TimeJumpPolicy, TimeJumpSettings
from incremental_mapper.measurements import NANOSECONDS, Drops, Measurement

WITNESSES = 5
"""So many measurements in a row behind the jump prove it; fewer are stray stamps."""


@dataclass(frozen=True, slots=True)
class Passed:
    """Measurements to map, oldest arrival first; with ``jumped`` they belong to a new map."""

    measurements: tuple[Measurement, ...]
    jumped: bool = False


class JumpFilter:
    """Tells a jump of the clock from a stray stamp, by each sensor's own newest stamp.

    A sensor whose messages are late as a whole never goes back behind itself, so it is no jump.
    """

    def __init__(self, settings: TimeJumpSettings) -> None:
        self._threshold = round(settings.threshold * NANOSECONDS)
        self._policy = settings.policy
        self._newest: dict[str, int] = {}
        self._suspects: list[Measurement] = []
        self._before: dict[str, int] = {}  # newest stamps of the run before the jump
        self._clock_jumped = False
        self.jumps = 0
        self.drops: Drops = Counter()

    def restart(self) -> None:
        """Forget all stamps; the counts stay."""
        self._newest, self._before, self._suspects = {}, {}, []

    def clock_jumped(self) -> None:
        """The clock itself went back: one measurement suffices as witness."""
        self._clock_jumped = True

    def check(self, measurement: Measurement) -> Passed:
        """What to map now that ``measurement`` came."""
        stamp, sensor = measurement.stamp, measurement.sensor
        before = self._before.get(sensor)
        if before is not None:
            ahead = stamp - max(self._newest.values(), default=stamp)
            if stamp >= before and ahead > self._threshold:
                self.drops[sensor, 'before_jump'] += 1
                return Passed(())
            del self._before[sensor]
        newest = self._newest.get(sensor)
        if newest is None or stamp >= newest - self._threshold:
            self._clear(sensor)
            self._newest[sensor] = stamp if newest is None else max(stamp, newest)
            return Passed((measurement,))
        if self._policy is TimeJumpPolicy.IGNORE:
            self.drops[sensor, 'time_jump'] += 1
            return Passed(())
        self._suspects.append(measurement)
        if len(self._suspects) < WITNESSES and not self._clock_jumped:
            return Passed(())
        return self._jump()

    def _clear(self, sensor: str) -> None:
        stray = sum(item.sensor == sensor for item in self._suspects)
        if stray:
            self.drops[sensor, 'stray_stamp'] += stray
            self._suspects = [item for item in self._suspects if item.sensor != sensor]

    def _jump(self) -> Passed:
        witnesses, self._suspects = tuple(self._suspects), []
        self._clock_jumped = False
        self.jumps += 1
        fresh: dict[str, int] = {}
        for item in witnesses:
            fresh[item.sensor] = max(item.stamp, fresh.get(item.sensor, item.stamp))
        self._before = {name: at for name, at in self._newest.items() if name not in fresh}
        self._newest = fresh
        return Passed(witnesses, jumped=True)
