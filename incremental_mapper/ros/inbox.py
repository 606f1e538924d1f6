"""What waits for the worker: bounded, in the order of arrival, nothing lost unseen."""

import threading
import time
from collections import Counter, deque
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeAlias

from incremental_mapper.checks.finding import Finding
from incremental_mapper.config import QueueSettings, Tree
from incremental_mapper.mapping.load_shedding import NO_SHEDDING, LoadShedding
from incremental_mapper.measurements import Drops, ImuSample, LidarScan, Measurement

SEARCH_LESS_FROM, MERGE_FROM, MERGE_MORE_FROM = 0.2, 0.5, 0.75
"""Shares of the queue from which on less is spent on a window."""
MOST_CANDIDATES, LEAST_CANDIDATES = 64, 4
"""Candidates that are solved at the first sign of overload, and under full overload."""


class Order(StrEnum):
    """What the worker can be told to do between measurements."""

    FLUSH = 'flush'
    RESET = 'reset'
    SAVE = 'save_map'
    AUTOSAVE = 'autosave'
    STOP = 'stop'


class View(StrEnum):
    """What is published now and then rather than with every window."""

    MAP = 'map'
    PATH = 'path'
    GRAPH = 'graph'


@dataclass(frozen=True, slots=True)
class Command:
    """An order, and the ticket under which its reply is expected."""

    order: Order
    ticket: int = 0


@dataclass(frozen=True, slots=True)
class Renewal:
    """Settings that proved right against those of the map, and why; a new map begins with them."""

    settings: Tree
    reason: str
    findings: tuple[Finding, ...] = ()


Word: TypeAlias = Command | Renewal
"""What the worker is told between measurements."""
Item: TypeAlias = Measurement | Word


class Inbox:
    """A queue between the callbacks and the worker; every method may be called by any thread."""

    def __init__(self, settings: QueueSettings) -> None:
        self._limits = {True: settings.imu, False: settings.core}
        self._items: deque[Item] = deque()
        self._counts = {True: 0, False: 0}  # by whether it is an IMU sample
        self._views: set[View] = set()
        self._filled = threading.Condition()
        self._drops: Drops = Counter()

    def put(self, item: Item) -> None:
        """Append; where the queue is full the oldest measurement of that kind goes, counted."""
        with self._filled:
            if not isinstance(item, Word):
                inertial = isinstance(item, ImuSample)
                if self._counts[inertial] >= self._limits[inertial]:
                    self._drop_oldest(inertial)
                self._counts[inertial] += 1
            self._items.append(item)
            self._filled.notify()

    def request(self, view: View) -> None:
        """Ask for a view; it is taken before the next measurement."""
        with self._filled:
            self._views.add(view)
            self._filled.notify()

    def take(self, seconds: float | None = None) -> tuple[Item | None, set[View]]:
        """Wait for work: the oldest item, if any, and the views that are wanted.

        Args:
            seconds: Neither comes after so long; None waits for ever.
        """
        with self._filled:
            self._filled.wait_for(lambda: self._items or self._views, seconds)
            views, self._views = self._views, set()
            item = self._items.popleft() if self._items else None
            if item is not None and not isinstance(item, Word):
                self._counts[isinstance(item, ImuSample)] -= 1
            return item, views

    def count(self, measurement: Measurement, reason: str) -> None:
        """Count a measurement that was taken out and is not used."""
        with self._filled:
            self._drops[measurement.sensor, reason] += 1

    def clear(self, reason: str) -> None:
        """Drop all measurements, counted under ``reason``; what the worker is told stays."""
        with self._filled:
            words = [item for item in self._items if isinstance(item, Word)]
            self._drops.update(
                (item.sensor, reason) for item in self._items if not isinstance(item, Word)
            )
            self._items = deque(words)
            self._counts = {True: 0, False: 0}

    def waiting(self) -> tuple[int, int]:
        """How many core measurements and IMU samples wait."""
        with self._filled:
            return self._counts[False], self._counts[True]

    def nbytes(self) -> int:
        """Memory that the points of the waiting scans take."""
        with self._filled:
            return sum(item.points.nbytes for item in self._items if isinstance(item, LidarScan))

    def shedding(self) -> LoadShedding:
        """What may be spent on the next windows at this filling."""
        core, imu = self.waiting()
        return shedding_at(max(core / self._limits[False], imu / self._limits[True]))

    def drops(self) -> Drops:
        """What was dropped, by sensor and reason."""
        with self._filled:
            return self._drops.copy()

    def _drop_oldest(self, inertial: bool) -> None:
        for index, item in enumerate(self._items):
            if not isinstance(item, Word) and isinstance(item, ImuSample) == inertial:
                self._drops[item.sensor, 'queue_full'] += 1
                del self._items[index]
                self._counts[inertial] -= 1
                return


def shedding_at(filling: float) -> LoadShedding:
    """Limits at a filling of the queue between 0 and 1: first less search, then fewer windows."""
    if filling < SEARCH_LESS_FROM:
        return NO_SHEDDING
    share = max(MERGE_FROM - filling, 0.0) / (MERGE_FROM - SEARCH_LESS_FROM)
    candidates = round(LEAST_CANDIDATES + share * (MOST_CANDIDATES - LEAST_CANDIDATES))
    windows = 1 + (filling >= MERGE_FROM) + (filling >= MERGE_MORE_FROM)
    return LoadShedding(candidates=candidates, windows=windows)


class Deadline:
    """A moment on the steady clock."""

    def __init__(self, seconds: float) -> None:
        self._end = time.monotonic() + seconds

    def passed(self) -> bool:
        """Whether the moment is over."""
        return time.monotonic() >= self._end
