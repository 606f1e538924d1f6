"""What a topic does not get: numbers that are not finite."""

from collections import Counter
from collections.abc import Callable
from typing import Any

from incremental_mapper.finite import not_finite


class FiniteGate:
    """Tells whether something may be published; each topic's first refusal is told of.

    Whoever steers by a pose must never see one that is none, and what reads a cloud may end by it.
    """

    def __init__(self, tell: Callable[[str], object]) -> None:
        self.refused: Counter[str] = Counter()
        """Messages that were not published, by topic."""
        self._tell = tell

    def passes(self, topic: str, **numbers: Any) -> bool:
        """Whether all numbers of a message are finite.

        Args:
            topic: Where it would go, or several of them.
            numbers: Arrays by what they are; None is left out.
        """
        wrong = not_finite(numbers)
        if not wrong:
            return True
        self.refused[topic] += 1
        if self.refused[topic] == 1:
            self._tell(f'{topic}: not published: {wrong} are not finite (told once for a topic)')
        return False
