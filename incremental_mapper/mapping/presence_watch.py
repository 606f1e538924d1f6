"""When each sensor was there: the evidence of holes in a drive."""

from collections.abc import Iterable, Sequence

import numpy as np

from incremental_mapper.checks.finding import Finding
from incremental_mapper.checks.gaps import PERIODS, SILENCE, Presence, absence_findings, is_uneven
from incremental_mapper.checks.sensor_clocks import SensorClock
from incremental_mapper.checks.time_spans import apart_findings
from incremental_mapper.mapping.window import Window
from incremental_mapper.measurements import NANOSECONDS

_SILENCE = round(SILENCE * NANOSECONDS)
_STEPS = 400
"""Steps, or some more, from message to message that tell what is usual."""
_HOLES = 1000
"""Holes that are kept of a sensor; who has more has lost most of it at either end."""

_YOUNG = 60.0
"""Seconds of a drive that goes on before absences are told: a late sensor is soon a small part."""
_PERIOD = 5 * NANOSECONDS


class _Seen:
    """First and last stamp of one sensor, its usual steps, and its holes."""

    def __init__(self, first: int) -> None:
        self.first = self.last = first
        self.steps: list[float] = []
        self.holes: list[tuple[int, int]] = []

    def take(self, stamps: Iterable[int]) -> None:
        """Take the next stamps; one that is no newer than the last changes nothing."""
        last, learning = self.last, len(self.steps) < _STEPS
        for stamp in stamps:
            step = stamp - last
            if step <= 0:
                continue
            if learning:
                self.steps.append(step / NANOSECONDS)
            if step > _SILENCE and len(self.holes) < _HOLES:
                self.holes.append((last, stamp))
            last = stamp
        self.last = last

    def presence(self, sensor: str) -> Presence:
        """The sensor's holes by what is usual for it."""
        steps = np.array(self.steps)
        usual = float(np.median(steps)) if len(steps) else 0.0
        least = max(SILENCE, PERIODS * usual) * NANOSECONDS
        holes = () if is_uneven(steps) else tuple(h for h in self.holes if h[1] - h[0] > least)
        return Presence(sensor, self.first, self.last, holes)


class PresenceWatch:
    """Looks at the stamps of windows: on plain numbers, since a window has few of each sensor."""

    def __init__(self) -> None:
        self._seen: dict[str, _Seen] = {}
        self._newest = 0
        self._next = 0
        self._found: list[Finding] = []

    def window(self, window: Window) -> None:
        """Look at what a window holds; what was dropped before is not there."""
        for item in window.core:
            self._take(item.sensor, (item.stamp,))
        if window.imu:
            self._take('imu', [sample.stamp for sample in window.imu])
        self._newest = max(self._newest, window.end)

    def _take(self, sensor: str, stamps: Sequence[int]) -> None:
        seen = self._seen.get(sensor)
        if seen is None:
            seen = self._seen[sensor] = _Seen(stamps[0])
        seen.take(stamps)

    def so_far(self) -> list[Finding]:
        """The same for a drive that goes on: looked at now and then, and not while it is young."""
        if self._newest >= self._next:
            begun = min((seen.first for seen in self._seen.values()), default=self._newest)
            young = self._newest - begun < _YOUNG * NANOSECONDS
            self._found = [] if young else self.findings()
            self._next = self._newest + _PERIOD
        return self._found

    def findings(self) -> list[Finding]:
        """Sensors that share no time with the LiDARs, or were away for long."""
        present = [seen.presence(sensor) for sensor, seen in self._seen.items()]
        clocks = [
            SensorClock(item.sensor, np.array([item.first, item.last], dtype=np.int64))
            for item in present
        ]
        apart = apart_findings(clocks)
        away = {finding.sensor for finding in apart}
        together = [item for item in present if item.sensor not in away]
        return [*apart, *absence_findings(together)]
