"""Messages that were taken, and whether many came at once that were sent one after the other.

A reliable subscription gives messages in the order in which they were sent. What was lost is sent
again, by Fast DDS up to 3 s later, and what is behind it comes with it.
"""

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

from incremental_mapper.measurements import NANOSECONDS

HELD_UP = round(0.3 * NANOSECONDS)
"""Nanoseconds that a message was on its way longer than one which came with it, to be told."""
TOGETHER = NANOSECONDS // 20
"""Nanoseconds between two messages that came at once, at most."""

Taken: TypeAlias = tuple[Any, Mapping[str, Any]]
"""A message as the middleware gives it, and what that knows of it."""


@dataclass(frozen=True, slots=True, eq=False)
class Arrived:
    """A message that was taken, and what the middleware knows of it."""

    message: Any
    about: Mapping[str, Any]

    @property
    def received(self) -> int:
        """When it was received, nanoseconds of the system's clock; now, where nobody knows."""
        return self.about.get('received_timestamp') or time.time_ns()


class HeldUp:
    """How often messages came at once, and for how many seconds the first of them was held up.

    Only differences count, so the clock of whoever sends may be another one.
    """

    def __init__(self) -> None:
        self.count = 0
        self.longest = 0.0
        self._received = 0  # when the last message was
        self._most = 0  # the longest way of those that came with it
        self._told = False

    def take(self, messages: Iterable[Mapping[str, Any]]) -> None:
        """Look at what the middleware knows of messages, in the order in which they were sent."""
        for about in messages:
            received, sent = about.get('received_timestamp'), about.get('source_timestamp')
            if not received or not sent:
                continue
            way = received - sent
            if received - self._received > TOGETHER:
                self._most, self._told = way, False
            self._received, self._most = received, max(way, self._most)
            if self._most - way > HELD_UP:
                self.count += not self._told
                self._told = True
                self.longest = max(self.longest, (self._most - way) / NANOSECONDS)
