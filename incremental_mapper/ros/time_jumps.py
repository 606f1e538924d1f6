"""Stamps that jump backwards: a looped bag, a clock that was set."""

from collections import Counter
from dataclasses import dataclass

from incremental_mapper.config import TimeJumpPolicy, TimeJumpSettings
from incremental_mapper.measurements import NANOSECONDS, Drops, Measurement

WITNESSES = 5
"""So many measurements in a row behind the jump prove it; fewer are stray stamps."""
AGREEMENT = 10 * NANOSECONDS
"""Witnesses of one jump are no further apart from each other than this; stray stamps are
anywhere."""
MAJORITY = 2
"""So many times as many as the others that came meanwhile are they at least: where a clock was
set, what is left of the time before are the few that were on their way."""


@dataclass(frozen=True, slots=True)
class Passed:
    """Measurements to map, oldest arrival first; with ``jumped`` they belong to a new map."""

    measurements: tuple[Measurement, ...]
    jumped: bool = False


@dataclass(frozen=True, slots=True)
class _Suspect:
    """A measurement behind its sensor's newest, and how many were in order before it came."""

    measurement: Measurement
    in_order: int


class JumpFilter:
    """Tells a jump of the clock from a stray stamp, by each sensor's own newest stamp.

    A sensor whose messages are late as a whole never goes back behind itself, so it is no jump.
    A stamp far ahead of all sensors is passed on, but until others prove it, it is nobody's newest:
    the measurements after it would seem to go back.
    """

    def __init__(self, settings: TimeJumpSettings) -> None:
        self._threshold = round(settings.threshold * NANOSECONDS)
        self._policy = settings.policy
        self._newest: dict[str, int] = {}
        self._ahead: list[Measurement] = []
        self._suspects: list[_Suspect] = []
        self._in_order = 0
        self._before: dict[str, int] = {}  # newest stamps of the run before the jump
        self._clock_jumped = False
        self.jumps = 0
        self.drops: Drops = Counter()

    def restart(self) -> None:
        """Forget all stamps; the counts stay."""
        self._newest, self._before, self._suspects, self._ahead = {}, {}, [], []

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
            self._keep_newest(measurement)
            return self._in_time(measurement)
        if self._is_with_others(measurement):  # then its newest stamp was a stray one
            self._newest[sensor] = stamp
            return self._in_time(measurement)
        if self._policy is TimeJumpPolicy.IGNORE:
            self.drops[sensor, 'time_jump'] += 1
            return Passed(())
        return self._suspect(measurement)

    def _in_time(self, measurement: Measurement) -> Passed:
        self._in_order += 1
        self._clear(measurement.sensor)
        return Passed((measurement,))

    def _keep_newest(self, measurement: Measurement) -> None:
        """Move the sensor's newest stamp on, but not far beyond all sensors by a single one."""
        top = max(self._newest.values(), default=measurement.stamp)
        ahead = [measurement]
        if measurement.stamp - top > self._threshold:
            if self._ahead and abs(measurement.stamp - self._ahead[-1].stamp) > AGREEMENT:
                self._ahead = []
            self._ahead.append(measurement)
            if len(self._ahead) < WITNESSES:
                return
            ahead = self._ahead
        for item in ahead:
            self._newest[item.sensor] = max(item.stamp, self._newest.get(item.sensor, item.stamp))
        self._ahead = []

    def _is_with_others(self, measurement: Measurement) -> bool:
        """Whether another sensor has been where a measurement goes back to, just now."""
        return any(
            abs(at - measurement.stamp) <= self._threshold
            for name, at in self._newest.items()
            if name != measurement.sensor
        )

    def _suspect(self, measurement: Measurement) -> Passed:
        # Behind a jump each sensor's own stamps go on in order.
        if any(
            item.measurement.stamp > measurement.stamp + self._threshold
            for item in self._suspects
            if item.measurement.sensor == measurement.sensor
        ):
            self._clear(measurement.sensor)
        self._suspects.append(_Suspect(measurement, self._in_order))
        agreeing = [
            item
            for item in self._suspects
            if abs(item.measurement.stamp - measurement.stamp) <= AGREEMENT
        ]
        meanwhile = self._in_order - agreeing[0].in_order
        proven = len(agreeing) >= WITNESSES and len(agreeing) >= MAJORITY * meanwhile
        if proven or self._clock_jumped:
            return self._jump([item.measurement for item in agreeing])
        while len(self._suspects) > MAJORITY * WITNESSES:
            self._drop(self._suspects.pop(0))
        return Passed(())

    def _clear(self, sensor: str) -> None:
        for suspect in [item for item in self._suspects if item.measurement.sensor == sensor]:
            self._suspects.remove(suspect)
            self._drop(suspect)

    def _drop(self, suspect: _Suspect) -> None:
        self.drops[suspect.measurement.sensor, 'stray_stamp'] += 1

    def _jump(self, witnesses: list[Measurement]) -> Passed:
        for suspect in self._suspects:
            if not any(suspect.measurement is witness for witness in witnesses):
                self._drop(suspect)
        self._suspects, self._ahead = [], []
        self._clock_jumped = False
        self.jumps += 1
        fresh: dict[str, int] = {}
        for item in witnesses:
            fresh[item.sensor] = max(item.stamp, fresh.get(item.sensor, item.stamp))
        self._before = {name: at for name, at in self._newest.items() if name not in fresh}
        self._newest = fresh
        return Passed(tuple(witnesses), jumped=True)
