"""Clocks that leap while a bag is recorded: what is stamped before is moved to the time after.

A computer learns the time, and the stamps of all sensors leap; a sensor is synchronised, or counts
the seconds of the hour, and its own do. Where the record times go on, they tell. Where they leap
too, the leap must show to the millisecond: each sensor goes on as if nothing had been, only that
the clock says otherwise. A recording that was paused goes on anywhere between two messages.
"""

import struct
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding, Severity, listed
from incremental_mapper.datasets.headers import peek_header, stamped
from incremental_mapper.measurements import NANOSECONDS

STAMPED = frozenset(
    f'{package}/msg/{name}'
    for package, name in (
        ('sensor_msgs', 'PointCloud2'),
        ('sensor_msgs', 'Imu'),
        ('sensor_msgs', 'NavSatFix'),
        ('nav_msgs', 'Odometry'),
        ('livox_ros_driver', 'CustomMsg'),
        ('livox_ros_driver2', 'CustomMsg'),
    )
)
"""Types of messages that begin with a header, and that are read."""
LONGEST_PAUSE = 86400 * NANOSECONDS
"""Nanoseconds; where the record times leap too, less may be a pause."""
LEAST_BACK = 1800 * NANOSECONDS
"""Nanoseconds; where there are no record times, what leaps back by less may be a drive that ends in
the time in which it began."""
LEAST = 10 * NANOSECONDS
"""Nanoseconds; where the record times go on, less may be a backlog, and is followed while mapping:
of a small step nobody knows which side of it is right."""
LOOP = 5 * NANOSECONDS
"""Nanoseconds; where all stamps leap back to within so much of the first ones, a drive begins anew:
a bag that is played in a loop, a simulator that starts again."""
STEADY = NANOSECONDS // 10
"""Nanoseconds by which lags may vary on either side of a leap."""
PLACES = 6
"""Messages of a sensor, evenly spread, whose lags show whether there is one leap in them."""
AGREEMENT, SLACK = 0.1, 5_000_000
"""Parts of a sensor's period, and nanoseconds more, by which its leap may differ from another's: it
is that near by chance in one of four pauses, that of four sensors in one of a hundred."""
MOST_READ = 100_000_000
"""Bytes that are read of a bag without record times: what is stamped before a computer learns the
time is the beginning."""
FEWEST = 3
"""Sensors that have to agree where the record times leap too."""

Logged = tuple[Any, int, bytes]
Stamps = NDArray[np.int64]


class Reader(Protocol):
    """What is asked of an open bag."""

    connections: list[Any]

    def messages(
        self, connections: Any = ..., start: int | None = ..., stop: int | None = ...
    ) -> Iterator[Logged]:
        """Messages in the order of their record times."""
        ...


@dataclass(frozen=True, slots=True)
class Leap:
    """How one topic's stamps leap.

    Attributes:
        by: nanoseconds to add to the stamps before it.
        border: stamp (ns) between those before and those after; None where lags tell them.
        lag: usual lag (ns) of a message after it.
        back: nanoseconds to add to all stamps, or those before it would be none.
    """

    by: int
    border: int | None = None
    lag: int = 0
    back: int = 0

    def is_before(self, stamp: int, logged: int) -> bool:
        """Whether a message was stamped before it, by its stamp and its record time, ns."""
        if self.border is not None:
            return (stamp < self.border) is (self.by > 0)
        behind = logged - stamp - self.lag
        return abs(behind) > abs(behind - self.by)


@dataclass(frozen=True)
class ClockLeaps:
    """The leaps of a bag, at most one of each topic.

    Attributes:
        topics: those that leap.
        at: record time (ns) of the first message after, as the bag has it.
        recorded_by: nanoseconds to add to the record times before; 0 where they go on.
        joint: whether all topics leap together.
    """

    topics: Mapping[str, Leap] = field(default_factory=dict)
    at: int = 0
    recorded_by: int = 0
    joint: bool = False

    def recorded(self, times: Stamps) -> Stamps:
        """Record times (N,), ns, by the clock after the leap."""
        moved: Stamps = np.where(times < self.at, times + self.recorded_by, times)
        return moved

    def spans(self, start: int | None, stop: int | None) -> Iterator[tuple[int | None, int | None]]:
        """From when until when the bag has what is between two record times of the clock after."""
        if not self.recorded_by:
            yield start, stop
            return
        before, until = (None if t is None else t - self.recorded_by for t in (start, stop))
        if before is None or before < self.at:
            yield before, self.at if until is None else min(until, self.at)
        if stop is None or stop > self.at:
            yield (self.at if start is None else max(start, self.at)), stop

    def moved(self, message: Logged, ros1: bool) -> Logged:
        """A message with its stamp and its record time by the clock after the leap."""
        connection, logged, data = message
        time = logged + self.recorded_by if logged < self.at else logged
        leap = self.topics.get(connection.topic)
        if leap is None:
            return connection, time, data
        try:
            stamp, _ = peek_header(data, ros1)
        except (struct.error, UnicodeDecodeError):
            return connection, time, data
        by = leap.back + (leap.by if leap.is_before(stamp, logged) else 0)
        if stamp <= 0 or by == 0:
            return connection, time, data
        return connection, time, stamped(data, stamp + by, ros1)

    def findings(self) -> list[Finding]:
        """What is told of them."""
        if self.joint:
            by = next(iter(self.topics.values())).by
            why = ', as of a computer that learned the time, and each sensor goes on as before'
            return [_finding('all sensors', by, why)]
        sizes = {round(leap.by / NANOSECONDS) for leap in self.topics.values()}
        why = ' while the record times go on: a clock that was set, or that begins again from 0'
        found = []
        for size in sorted(sizes):
            names = [t for t, leap in self.topics.items() if round(leap.by / NANOSECONDS) == size]
            found.append(_finding(listed(names), self.topics[names[0]].by, why))
        return found


def _finding(whose: str, by: int, why: str) -> Finding:
    seconds = abs(by) / NANOSECONDS
    words = f'{seconds / 86400:.1f} days' if seconds > 2 * 86400 else f'{seconds:.3f} s'
    way = 'on' if by > 0 else 'back'
    return Finding(
        'clock_leap',
        Severity.MENDED,
        '',
        f'the stamps of {whose} leap {way} by {words}{why}',
        'those before are moved to the time after',
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Seam:
    """One sensor at a leap: stamps (ns) before and after, and its usual step."""

    before: int
    after: int
    period: int

    @property
    def by(self) -> int:
        return self.after - self.before - self.period


def find_leaps(
    reader: Reader, times: Mapping[str, Stamps], ros1: Callable[[Any], bool]
) -> ClockLeaps | None:
    """Look for the leaps of a bag.

    Args:
        reader: an open bag.
        times: when the messages were recorded, ns ascending, by topic.
        ros1: tells of a connection whether it is of ROS 1.

    Returns:
        The leaps; None where there are none, or where one may be a pause.
    """
    known = {c.topic for c in reader.connections if c.msgtype in STAMPED}
    sensors = {topic: own for topic, own in times.items() if topic in known and len(own) > PLACES}
    if len(sensors) < 2:
        return None
    look = _Look(reader, ros1)
    whole = np.sort(np.concatenate(list(sensors.values())))
    if whole[0] == whole[-1]:
        return _with_the_recorder(look.in_order(sensors), known)
    widest = int(np.argmax(np.diff(whole)))
    if whole[widest + 1] - whole[widest] > LONGEST_PAUSE:
        at = int(whole[widest + 1])
        seams = [
            look.seam(topic, own, int(np.searchsorted(own, at))) for topic, own in sensors.items()
        ]
        return _with_the_recorder([seam for seam in seams if seam is not None], known, at)
    leaps = {topic: look.leap(topic, own) for topic, own in sensors.items()}
    found = {topic: leap for topic, leap in leaps.items() if leap is not None}
    if not found:
        return None
    sizes = [leap.by for leap in found.values()]
    joint = len(found) == len(sensors) and max(sizes) - min(sizes) < STEADY
    if joint and look.anew:
        return None
    # What has too few messages to be looked at, such as fixes, does as all others do.
    others = dict.fromkeys(known, next(iter(found.values()))) if joint else {}
    return ClockLeaps({**others, **found}, joint=joint)


def _with_the_recorder(
    seams: Sequence[_Seam], topics: Collection[str], at: int | None = None
) -> ClockLeaps | None:
    """A leap that the record times make too at ``at``, or that has none."""
    if len(seams) < FEWEST:
        return None
    best = min(seams, key=lambda seam: seam.period)
    if any(abs(seam.by - best.by) > AGREEMENT * seam.period + SLACK for seam in seams):
        return None
    if not (best.by > LONGEST_PAUSE // 2 or (at is None and best.by < -LEAST_BACK)):
        return None
    leap = Leap(best.by, best.before + best.by // 2)
    by = 0 if at is None else best.by
    return ClockLeaps(dict.fromkeys(topics, leap), at or 0, by, joint=True)


class _Look:
    """Reads single headers."""

    def __init__(self, reader: Reader, ros1: Callable[[Any], bool]) -> None:
        self._reader, self._ros1 = reader, ros1
        self.anew = False  # whether a sensor leaps back to its first stamps

    def seam(self, topic: str, times: Stamps, place: int) -> _Seam | None:
        """A sensor at a place, the index of its first message after; None at either end."""
        if not 1 < place < len(times) - 1:
            return None
        before = self._stamp(topic, int(times[place - 1]))
        after = self._stamp(topic, int(times[place]))
        if before is None or after is None:
            return None
        return _Seam(before, after, int(np.median(np.delete(np.diff(times), place - 1))))

    def in_order(self, topics: Collection[str]) -> list[_Seam]:
        """Every sensor at its largest leap, in what comes first of a bag without record times."""
        stamps: dict[str, list[int]] = {topic: [] for topic in topics}
        size = 0
        connections = [c for c in self._reader.connections if c.topic in stamps]
        try:
            for connection, _, data in self._reader.messages(connections=connections):
                stamps[connection.topic].append(peek_header(data, self._ros1(connection))[0])
                size += len(data)
                if size > MOST_READ:
                    break
        # Damage is told of when its turn comes.
        except Exception:
            return []
        found = []
        for own in stamps.values():
            if len(own) > PLACES:
                steps = np.diff(own)
                place = int(np.argmax(np.abs(steps)))
                found.append(_Seam(own[place], own[place + 1], int(np.median(steps))))
        return found

    def leap(self, topic: str, times: Stamps) -> Leap | None:
        """The one leap of a sensor beside record times that go on."""
        places = np.unique(np.linspace(0, len(times) - 1, PLACES).astype(int)).tolist()
        lags = [self._lag(topic, int(times[place])) for place in places]
        known = [lag for lag in lags if lag is not None]
        if len(known) < len(lags) or abs(known[-1] - known[0]) < LEAST:
            return None
        early = [abs(lag - known[0]) < STEADY for lag in known]
        late = [abs(lag - known[-1]) < STEADY for lag in known]
        first = late.index(True)
        if not all(early[:first]) or not all(late[first:]):
            return None  # it drifts, or leaps more than once
        place = self._place(topic, times, places[first - 1], places[first], known[0], known[-1])
        seam = self.seam(topic, times, place)
        if seam is None:
            return None
        passed = int(times[place] - times[place - 1])
        if abs(seam.after - seam.before - seam.period) < abs(passed - seam.period):
            return None  # it is the recorder's clock that leaps, or that was away
        by = known[0] - known[-1]
        first = int(times[0]) - known[0]
        self.anew = self.anew or abs(seam.after - first) < LOOP
        exact = abs(seam.by - by) < seam.period // 2 and passed < 2 * seam.period
        by = seam.by if exact else by
        return Leap(by, None, known[-1], -by if first + by <= 0 else 0)

    def _place(self, topic: str, times: Stamps, low: int, high: int, early: int, late: int) -> int:
        """Index of the first message with the late lag."""
        while high - low > 1:
            middle = (low + high) // 2
            lag = self._lag(topic, int(times[middle]))
            if lag is None or abs(lag - early) <= abs(lag - late):
                low = middle
            else:
                high = middle
        return high

    def _lag(self, topic: str, time: int) -> int | None:
        stamp = self._stamp(topic, time)
        return None if stamp is None else time - stamp

    def _stamp(self, topic: str, time: int) -> int | None:
        """Header stamp of the message of a topic that was recorded at a time, ns."""
        connections = [c for c in self._reader.connections if c.topic == topic]
        try:
            messages = self._reader.messages(connections=connections, start=time)
            for connection, _, data in islice(messages, 1):
                stamp, _ = peek_header(data, self._ros1(connection))
                return stamp if stamp > 0 else None
        # Damage is told of when its turn comes.
        except Exception:
            return None
        return None
