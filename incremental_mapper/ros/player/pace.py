"""When a logged message is due: stamps of a bag on a steady clock."""

import math
import time
from collections.abc import Callable

from incremental_mapper.measurements import NANOSECONDS


class Pace:
    """Maps stamps of the bag to instants of a steady clock; deadlines are absolute.

    Lateness of one message therefore never moves the next one, and nothing drifts.
    """

    def __init__(
        self, rate: float, stamp: int, clock: Callable[[], int] = time.monotonic_ns
    ) -> None:
        """Start now at ``stamp`` (ns), ``rate`` seconds of the bag a second of ``clock`` (ns)."""
        self._rate = rate
        self._clock = clock
        self._stamp = stamp
        self._begin = clock()
        self._paused_at: int | None = None

    @property
    def paused(self) -> bool:
        """Whether time stands still."""
        return self._paused_at is not None

    def toggle(self) -> None:
        """Pause, or go on where it was paused."""
        now = self._clock()
        if self._paused_at is None:
            self._paused_at = now
        else:
            self._begin += now - self._paused_at
            self._paused_at = None

    def stamp(self) -> int:
        """The bag's time now, ns."""
        now = self._clock() if self._paused_at is None else self._paused_at
        return self._stamp + round((now - self._begin) * self._rate)

    def left(self, stamp: int) -> float:
        """Seconds until ``stamp`` is due; negative where it is late, infinite while paused."""
        if self._paused_at is not None:
            return math.inf
        due = self._begin + (stamp - self._stamp) / self._rate
        return (due - self._clock()) / NANOSECONDS
