"""When a sensor's next message is due, by the stamps of its last ones."""

from collections import deque
from statistics import median

from incremental_mapper.measurements import NANOSECONDS

_KEPT = 64
"""Messages that tell what is usual for a sensor: a minute of a receiver of 1 Hz."""
_STEP_MARGIN, _TRUSTED = 0.05, 4
"""Share of a period by which a message may come earlier than all before it, besides what their
steps differ among each other; it shrinks as more than so many steps are known."""
_LONG = 1.5
"""A step that is so many times the shortest one is of messages that were missed, and tells nothing
of what is usual."""
_LAG_MARGIN = NANOSECONDS // 20
"""Nanoseconds by which a message may come later behind the others than all before it. A loaded
machine delivers clouds of a megabyte 10 to 30 ms apart."""
_MISSED = 3
"""Messages in a row that a live sensor may miss."""


class Pace:
    """Steps of a sensor's stamps, and how far behind the others' stamps its messages come in.

    Both are by header stamps alone: what came in before a message is what its lag is measured by.
    """

    def __init__(self, stamp: int) -> None:
        """``stamp`` is the first one (ns)."""
        self._newest = stamp
        self._moved = False
        self._steps: deque[int] = deque(maxlen=_KEPT)
        self._lags: deque[int] = deque(maxlen=_KEPT)
        self._shortest = self._spread = self._margin = self._lag = 0

    def take(self, stamp: int, now: int, most: int) -> None:
        """Take the next message.

        Args:
            stamp: its stamp, ns.
            now: newest stamp of all sensors before it came, ns.
            most: nanoseconds; a lag beyond is not learnt from, as nobody waits that long.
        """
        lag = max(now - stamp, 0)
        if lag <= most:
            self._lags.append(lag)
            self._lag = max(self._lags)
        step = stamp - self._newest
        if step <= 0:
            return
        self._newest = stamp
        if self._moved:
            self._moved = False
            return
        self._steps.append(step)
        self._shortest = min(self._steps)
        usual = [item for item in self._steps if item <= _LONG * self._shortest]
        self._spread = max(usual) - self._shortest
        # What the steps differ by is known the better the more of them there are.
        share = _STEP_MARGIN * min(_TRUSTED / len(usual), 1.0)
        self._margin = self._spread + round(share * self._shortest)

    def move(self, stamp: int) -> None:
        """All clocks moved on to ``stamp`` (ns): the step there is nobody's own."""
        self._newest, self._moved = stamp, True

    def silent(self, now: int, lateness: int) -> bool:
        """Whether the sensor has missed so much by ``now`` (ns) that it is taken for dead.

        Args:
            now: newest stamp of all sensors, ns.
            lateness: silence that is never taken for death, ns.
        """
        silence = now - self._newest - self._lag
        if silence <= lateness or not self._steps:
            return False
        return silence > (_MISSED + 1) * median(self._steps)

    @property
    def longest(self) -> int | None:
        """Longest usual step, ns; None where none is known."""
        return self._shortest + self._spread if self._steps else None

    def complete_until(self, now: int, grain: int, lateness: int) -> int:
        """The stamp (ns) before which no message of this sensor is expected any more.

        Args:
            now: newest stamp of all sensors, ns.
            grain: nanoseconds by which ``now`` goes on at a time.
            lateness: the longest wait, ns.
        """
        due, passed = self._newest, now - min(self._lag + grain + _LAG_MARGIN, lateness)
        if self._steps:
            # Those that would have come by now were missed, and the next keeps their pace.
            missed = max(passed - self._newest, 0) // (self._shortest + self._spread)
            due += max((missed + 1) * self._shortest - self._margin, 0)
        return max(due, passed)
