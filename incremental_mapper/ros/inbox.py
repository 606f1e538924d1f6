"""What waits for the worker: bounded, in the order of arrival, nothing lost unseen.

Where the worker cannot follow, first less is spent on each window, and then scans are left out, so
that what it maps is never much older than ``queue.max_delay``.
"""

import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeAlias

from incremental_mapper.checks.finding import Finding
from incremental_mapper.config import QueueSettings, Tree
from incremental_mapper.mapping.load_shedding import NO_SHEDDING, LoadShedding
from incremental_mapper.measurements import Drops, ImuSample, LidarScan, Measurement

SEARCH_LESS_FROM, MERGE_FROM, MERGE_MORE_FROM, LEAVE_OUT_FROM = 0.2, 0.5, 0.75, 0.8
"""Shares of the queue, or of the longest delay, from which on less is spent on a window; behind the
last one scans are left out, where it is the delay."""
READ_AHEAD = 1
"""Windows whose scans are prepared behind an older one, while windows are merged: they wait too."""
OVERLOAD = 'overload'
"""Why a scan is left out that waited while newer ones of its LiDAR came."""
MOST_CANDIDATES, LEAST_CANDIDATES = 64, 4
"""Candidates that are solved at the first sign of overload, and under full overload."""


class Order(StrEnum):
    """What the worker can be told to do between measurements."""

    FLUSH = 'flush'
    RESET = 'reset'
    SAVE = 'save_map'
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
    """Settings that proved right against those of the map, and why; a new map begins with them.

    ``optional`` ones are not worth the map where that cannot be mapped again: the next one takes
    them.
    """

    settings: Tree
    reason: str
    findings: tuple[Finding, ...] = ()
    optional: bool = False


Word: TypeAlias = Command | Renewal
"""What the worker is told between measurements."""
Item: TypeAlias = Measurement | Word


@dataclass(frozen=True, slots=True)
class _Entry:
    """What waits, and when the newest measurement came by then, seconds."""

    item: Item
    arrived: float


class Inbox:
    """A queue between the callbacks and the worker; every method may be called by any thread."""

    def __init__(
        self, settings: QueueSettings, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Begin empty; ``clock`` tells when what is put in came, in seconds."""
        self._limits = {True: settings.imu, False: settings.core}
        self._max_delay = settings.max_delay
        self.clock = clock
        self._items: deque[_Entry] = deque()
        self._scans: Counter[str] = Counter()  # that wait, by sensor
        self._newest = 0.0  # arrival
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
                self._newest = max(self.clock(), self._newest)
                self._scans[item.sensor] += isinstance(item, LidarScan)
            self._items.append(_Entry(item, self._newest))
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
            return self._pop(), views

    def count(self, measurement: Measurement, reason: str) -> None:
        """Count a measurement that was taken out and is not used."""
        with self._filled:
            self._drops[measurement.sensor, reason] += 1

    def clear(self, reason: str) -> None:
        """Drop all measurements, counted under ``reason``; what the worker is told stays."""
        with self._filled:
            words = [entry for entry in self._items if isinstance(entry.item, Word)]
            self._drops.update(
                (entry.item.sensor, reason)
                for entry in self._items
                if not isinstance(entry.item, Word)
            )
            self._items = deque(words)
            self._counts = {True: 0, False: 0}
            self._scans.clear()

    def waiting(self) -> tuple[int, int]:
        """How many core measurements and IMU samples wait."""
        with self._filled:
            return self._counts[False], self._counts[True]

    def nbytes(self) -> int:
        """Memory that the waiting scans take."""
        with self._filled:
            waiting = (entry.item for entry in self._items)
            return sum(item.nbytes for item in waiting if isinstance(item, LidarScan))

    def delay(self) -> float:
        """Seconds between the arrivals of the oldest and the newest measurement that wait.

        What comes all at once, and is followed by nothing, is no delay: nobody waits for it.
        """
        with self._filled:
            return self._newest - self._items[0].arrived if self._items else 0.0

    def shedding(self) -> LoadShedding:
        """What may be spent on the next windows at this filling."""
        core, imu = self.waiting()
        filling = max(core / self._limits[False], imu / self._limits[True])
        share = self.delay() / self._max_delay if self._max_delay > 0 else 0.0
        return shedding_at(max(filling, share))

    def drops(self) -> Drops:
        """What was dropped, by sensor and reason."""
        with self._filled:
            return self._drops.copy()

    def _pop(self) -> Item | None:
        """Take the oldest item, and leave out scans before it that waited too long."""
        while self._items:
            entry = self._items.popleft()
            item = entry.item
            if isinstance(item, Word):
                return item
            self._counts[isinstance(item, ImuSample)] -= 1
            if not isinstance(item, LidarScan):
                return item
            self._scans[item.sensor] -= 1
            behind = self._newest - entry.arrived
            if not leaves_out(behind, self._max_delay) or self._scans[item.sensor] == 0:
                return item
            self._drops[item.sensor, OVERLOAD] += 1
        return None

    def _drop_oldest(self, inertial: bool) -> None:
        for index, entry in enumerate(self._items):
            item = entry.item
            if not isinstance(item, Word) and isinstance(item, ImuSample) == inertial:
                self._drops[item.sensor, 'queue_full'] += 1
                del self._items[index]
                self._counts[inertial] -= 1
                self._scans[item.sensor] -= isinstance(item, LidarScan)
                return


def shedding_at(filling: float) -> LoadShedding:
    """Limits at a share of the queue, or of the longest delay: less search, then fewer windows."""
    if filling < SEARCH_LESS_FROM:
        return NO_SHEDDING
    share = max(MERGE_FROM - filling, 0.0) / (MERGE_FROM - SEARCH_LESS_FROM)
    candidates = round(LEAST_CANDIDATES + share * (MOST_CANDIDATES - LEAST_CANDIDATES))
    windows = 1 + (filling >= MERGE_FROM) + (filling >= MERGE_MORE_FROM)
    if windows == 1:
        return LoadShedding(candidates=candidates)
    return LoadShedding(candidates=candidates, windows=windows, read_ahead=READ_AHEAD)


def leaves_out(delay: float, most: float) -> bool:
    """Whether a scan is left out that was followed by newer ones of its LiDAR.

    Args:
        delay: Seconds since it came, by the newest measurement.
        most: Seconds that none should wait; 0 where all may.
    """
    return 0.0 < LEAVE_OUT_FROM * most <= delay


class Deadline:
    """A moment on the steady clock."""

    def __init__(self, seconds: float) -> None:
        self._end = time.monotonic() + seconds

    def passed(self) -> bool:
        """Whether the moment is over."""
        return time.monotonic() >= self._end
