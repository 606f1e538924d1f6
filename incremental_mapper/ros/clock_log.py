"""When the messages of each sensor came in, beside their stamps: what live clocks are told by."""

from collections.abc import Collection, Mapping

import numpy as np

from incremental_mapper.checks.clocks import clock_findings
from incremental_mapper.checks.finding import Finding
from incremental_mapper.checks.sensor_clocks import SensorClock
from incremental_mapper.measurements import NANOSECONDS

FIRST_LOOK = 3.0
"""Seconds of messages from which clocks are compared; then after twice as many, and so on. A
receiver of 1 Hz has three fixes by then."""
LONG_LOOK = 20.0
"""Seconds from which steps and drifts are told: at the start connections are made and queues drain,
which looks like either."""
_FEWEST = 2
_MOST = 600
_OF_LONG = ('clock_step', 'clock_drift', 'future_stamps')


class ClockLog:
    """Keeps some stamps of each sensor, evenly over the time since the last start.

    ``chosen`` are the sensors whose time offset the user set: it is never replaced.
    """

    def __init__(self, chosen: tuple[str, ...] = ()) -> None:
        self._chosen = chosen
        self._pairs: dict[str, list[tuple[int, int]]] = {}
        self._strides: dict[str, int] = {}
        self._counts: dict[str, int] = {}
        self._first: int | None = None
        self._newest = 0
        self._next = FIRST_LOOK
        self._mending = False

    def restart(self) -> None:
        """Forget everything: stamps or offsets are others from now on."""
        self._pairs, self._strides, self._counts = {}, {}, {}
        self._first, self._newest, self._next = None, 0, FIRST_LOOK
        self._mending = False

    def take(self, sensor: str, stamp: int, received: int) -> None:
        """Keep a message's stamp, as it is in its header, and when it was received (ns)."""
        if self._first is None:
            self._first = received
        self._newest = received
        count = self._counts.get(sensor, 0)
        self._counts[sensor] = count + 1
        if count % self._strides.setdefault(sensor, 1):
            return
        pairs = self._pairs.setdefault(sensor, [])
        pairs.append((received, stamp))
        if len(pairs) > _MOST:
            del pairs[1::2]
            self._strides[sensor] *= 2

    def findings(
        self, offsets: Mapping[str, int], followed: Collection[str] = ()
    ) -> tuple[Finding, ...]:
        """What the clocks show, once in a while; most often nothing, as nobody looked.

        Args:
            offsets: nanoseconds that are added to the stamps of each sensor.
            followed: sensors whose clocks stepped and are put right already; what they were most
                of the time would be taken for what they are.
        """
        passed = 0.0 if self._first is None else (self._newest - self._first) / NANOSECONDS
        if passed < self._next or self._mending:
            return ()
        self._next = 2.0 * passed
        clocks = [
            self._clock(sensor, offsets.get(sensor, 0))
            for sensor, pairs in self._pairs.items()
            if len(pairs) >= _FEWEST and sensor not in followed
        ]
        found = clock_findings(clocks, by_spans=False) if len(clocks) > 1 else ()
        # What mends them takes its time to reach the inputs, which then begin anew.
        self._mending = any(item.changes for item in found)
        return tuple(item for item in found if passed >= LONG_LOOK or item.rule not in _OF_LONG)

    def _clock(self, sensor: str, offset: int) -> SensorClock:
        table = np.array(self._pairs[sensor], dtype=np.int64)
        return SensorClock(
            sensor, table[:, 1] + offset, table[:, 0], offset, sensor in self._chosen
        )
