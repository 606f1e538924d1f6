"""How long after its last measurement a window is told of, for those who steer by it."""

from collections import deque

KEPT = 4000
"""Scans and fixes that are remembered until their window comes."""


class Lag:
    """Times of receipt beside windows; used in one thread only. All times are seconds."""

    def __init__(self) -> None:
        self._received: deque[tuple[int, float]] = deque(maxlen=KEPT)
        self._worst = 0.0

    def took(self, stamp: int, received: float) -> None:
        """A scan or a fix with a stamp (ns) was received."""
        self._received.append((stamp, received))

    def told(self, start: int, end: int, now: float) -> None:
        """The window of the stamps [start, end), ns, is told of."""
        inside = [received for stamp, received in self._received if start <= stamp < end]
        # One whose stamps were put right is among no receipts, and says nothing.
        if inside:
            self._worst = max(self._worst, now - max(inside))
        later = [item for item in self._received if item[0] >= end]
        self._received = deque(later, maxlen=KEPT)

    def restart(self) -> None:
        """A new map begins."""
        self._received.clear()

    def worst(self) -> float:
        """The longest of the windows since the last call; 0 where there was none."""
        worst, self._worst = self._worst, 0.0
        return worst
