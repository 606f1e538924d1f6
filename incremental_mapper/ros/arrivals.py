"""Messages that were taken, and when: what was lost on the way comes late, and all behind it waits.

A reliable subscription gives messages in the order in which they were sent. What was lost is sent
again, by Fast DDS up to 3 s later; what is behind it was received by then, and could not be taken.
"""

import itertools
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from incremental_mapper.measurements import NANOSECONDS

HELD_UP = 0.3
"""Seconds that a message comes after one which was sent behind it, from which on it is told."""

Taken: TypeAlias = tuple[Any, Mapping[str, Any]]
"""A message as the middleware gives it, and what that knows of it."""


@dataclass(frozen=True, slots=True, eq=False)
class Arrived:
    """A message that was taken.

    Attributes:
        message: It.
        about: What the middleware knows of it.
        due: When it could be taken, nanoseconds of the system's clock: when it was received, or one
            that was sent before it. 0 where the middleware does not know.
    """

    message: Any
    about: Mapping[str, Any]
    due: int

    @property
    def received(self) -> int:
        """When it was received, nanoseconds of the system's clock; now, where nobody knows."""
        return self.about.get('received_timestamp') or time.time_ns()


@dataclass(slots=True)
class HeldUp:
    """How often and by how much, in seconds, a message came after one that was sent behind it."""

    count: int = 0
    longest: float = 0.0

    def take(self, received: Sequence[int]) -> None:
        """Look at the times of receipt (ns) of messages in the order in which they were sent."""
        for first, second in itertools.pairwise(received):
            late = (first - second) / NANOSECONDS
            if second > 0 and late > HELD_UP:
                self.count += 1
                self.longest = max(self.longest, late)


def when_due(received: Sequence[int]) -> list[int]:
    """When messages could be taken that one reliable subscription gives.

    Args:
        received: When they were received, in the order in which they were sent.
    """
    return list(itertools.accumulate(received, max))
