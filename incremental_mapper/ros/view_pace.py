"""How often a view is made and published: seldom enough for the worker and for slow readers."""

import math
from collections.abc import Callable
from dataclasses import dataclass

SHARE = 0.1
"""Share of the time that may go into making and publishing one view."""
UNDELIVERED = 10.0
"""Seconds after which a view is made again though a reader has not got the last one."""


@dataclass(slots=True)
class ViewPace:
    """When the last one was asked for, seconds on a steady clock, and what it took, seconds."""

    last: float = -math.inf
    cost: float = 0.0

    def due(self, now: float, period: float, delivered: Callable[[], bool]) -> bool:
        """Whether the next one may be made.

        Args:
            now: The time.
            period: Shortest time between two, seconds.
            delivered: Whether all readers have got the last one; asked only where it matters. A
                new one would take its place, and a slow reader would never get any.
        """
        passed = now - self.last
        if passed < max(period, self.cost / SHARE):
            return False
        return passed >= UNDELIVERED or delivered()
