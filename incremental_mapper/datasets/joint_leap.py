"""A computer that learned the time while it recorded: the stamps of all sensors leap together.

What was stamped before is moved to the time after, where the leap shows to the millisecond: each
sensor goes on as if nothing had been, only that the clock says otherwise. A recording that was
paused goes on anywhere between two messages of a sensor.
"""

import struct
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding, Severity
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
"""Nanoseconds; where the record times go on, less may be a backlog."""
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
class JointLeap:
    """Where all clocks leap, and by how much.

    Attributes:
        by: nanoseconds to add to the stamps before it.
        at: record time (ns) of the first message after it, as the bag has it.
        recorded_by: nanoseconds to add to the record times before it; 0 where they go on.
        border: stamp (ns) between those before and those after; None where lags tell them.
        lag: usual lag (ns) of a message after it.
    """

    by: int
    at: int
    recorded_by: int
    border: int | None = None
    lag: int = 0

    def recorded(self, times: Stamps) -> Stamps:
        """Record times (N,), ns, by the clock after the leap."""
        moved: Stamps = np.where(times < self.at, times + self.recorded_by, times)
        return moved

    def spans(self, start: int | None, stop: int | None) -> Iterator[tuple[int | None, int | None]]:
        """From when until when the bag has what is between two record times of the clock after."""
        if not self.recorded_by:
            yield start, stop
            return
        moved = [None if time is None else time - self.recorded_by for time in (start, stop)]
        before, until = moved
        if before is None or before < self.at:
            yield before, self.at if until is None else min(until, self.at)
        if stop is None or stop > self.at:
            yield (self.at if start is None else max(start, self.at)), stop

    def moved(self, message: Logged, ros1: bool) -> Logged:
        """A message with its stamp and its record time by the clock after the leap."""
        connection, logged, data = message
        time = logged + self.recorded_by if logged < self.at else logged
        if connection.msgtype not in STAMPED:
            return connection, time, data
        try:
            stamp, _ = peek_header(data, ros1)
        except (struct.error, UnicodeDecodeError):
            return connection, time, data
        if stamp <= 0 or not self._is_before(stamp, logged):
            return connection, time, data
        return connection, time, stamped(data, stamp + self.by, ros1)

    def _is_before(self, stamp: int, logged: int) -> bool:
        if self.border is not None:
            return (stamp < self.border) is (self.by > 0)
        behind = logged - stamp - self.lag
        return abs(behind) > abs(behind - self.by)

    def finding(self) -> Finding:
        """What is told of it."""
        seconds = abs(self.by) / NANOSECONDS
        words = f'{seconds / 86400:.1f} days' if seconds > 2 * 86400 else f'{seconds:.3f} s'
        way = 'on' if self.by > 0 else 'back'
        return Finding(
            'clock_leap',
            Severity.MENDED,
            '',
            f'the stamps of all sensors leap {way} by {words}, as of a computer that learned the '
            'time while it recorded, and each sensor goes on as before',
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


def find_joint_leap(
    reader: Reader, times: dict[str, Stamps], ros1: Callable[[Any], bool]
) -> JointLeap | None:
    """Look for the one leap that all sensors make.

    Args:
        reader: an open bag.
        times: when the messages were recorded, ns ascending, by topic.
        ros1: tells of a connection whether it is of ROS 1.

    Returns:
        The leap; None where there is none, or where it may be a pause.
    """
    known = {c.topic for c in reader.connections if c.msgtype in STAMPED}
    sensors = {topic: own for topic, own in times.items() if topic in known and len(own) > 3}
    if len(sensors) < 2:
        return None
    look = _Look(reader, ros1)
    whole = np.sort(np.concatenate(list(sensors.values())))
    if whole[0] == whole[-1]:
        return _with_the_recorder(look.in_order(sensors))
    widest = int(np.argmax(np.diff(whole)))
    if whole[widest + 1] - whole[widest] > LONGEST_PAUSE:
        at = int(whole[widest + 1])
        places = {topic: int(np.searchsorted(own, at)) for topic, own in sensors.items()}
        return _with_the_recorder(look.seams(sensors, places), at)
    found = look.steps(sensors)
    return None if found is None else _beside_the_recorder(look.seams(sensors, found), look.late)


def _with_the_recorder(seams: Sequence[_Seam], at: int | None = None) -> JointLeap | None:
    """A leap that the record times make too at ``at``, or that has none."""
    if len(seams) < FEWEST:
        return None
    best = min(seams, key=lambda seam: seam.period)
    agree = [abs(s.by - best.by) <= AGREEMENT * s.period + SLACK for s in seams]
    if not all(agree) or not (
        best.by > LONGEST_PAUSE // 2 or (at is None and best.by < -LEAST_BACK)
    ):
        return None
    border = best.before + best.by // 2
    return JointLeap(best.by, at or 0, 0 if at is None else best.by, border)


def _beside_the_recorder(seams: Sequence[_Seam], late: int) -> JointLeap | None:
    """A leap of the stamps alone."""
    if len(seams) < 2:
        return None
    best = min(seams, key=lambda seam: seam.period)
    if any(abs(s.by - best.by) > s.period + SLACK for s in seams) or abs(best.by) < LEAST:
        return None
    return JointLeap(best.by, 0, 0, None, late)


class _Look:
    """Reads single headers. ``late`` is a usual lag (ns) at the end of the recording."""

    def __init__(self, reader: Reader, ros1: Callable[[Any], bool]) -> None:
        self._reader, self._ros1 = reader, ros1
        self.late = 0

    def seams(self, sensors: dict[str, Stamps], places: dict[str, int]) -> list[_Seam]:
        """Every sensor at its place (index of the first message after); those that have both."""
        found = []
        for topic, place in places.items():
            times = sensors[topic]
            if not 1 < place < len(times) - 1:
                continue
            before = self._stamp(topic, int(times[place - 1]))
            after = self._stamp(topic, int(times[place]))
            if before is None or after is None:
                continue
            steps = np.diff(times)
            period = int(np.median(np.delete(steps, place - 1)))
            found.append(_Seam(before, after, period))
        return found

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
            if len(own) > 3:
                steps = np.diff(own)
                place = int(np.argmax(np.abs(steps)))
                found.append(_Seam(own[place], own[place + 1], int(np.median(steps))))
        return found

    def steps(self, sensors: dict[str, Stamps]) -> dict[str, int] | None:
        """Where the lag of each sensor steps; None where it does not of all, by the same."""
        ends = {}
        for topic, times in sensors.items():
            lags = self._lag(topic, int(times[0])), self._lag(topic, int(times[-1]))
            if lags[0] is None or lags[1] is None:
                return None
            ends[topic] = lags[0], lags[1]
        changes = [late - early for early, late in ends.values()]
        if max(changes) - min(changes) > NANOSECONDS or min(map(abs, changes)) < LEAST:
            return None
        self.late = int(np.median([late for _, late in ends.values()]))
        return {topic: self._place(topic, sensors[topic], *ends[topic]) for topic in sensors}

    def _place(self, topic: str, times: Stamps, early: int, late: int) -> int:
        """Index of the first message with the late lag."""
        low, high = 0, len(times) - 1
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
