"""A look at the clocks of a bag: some messages of each sensor, first, last and in between."""

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.clocks import clock_findings, unstamped_finding
from incremental_mapper.checks.coarse_stamps import coarse_finding, is_coarse, standing_steps
from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.checks.sensor_clocks import NOT_LIDARS, SensorClock
from incremental_mapper.config import Tree
from incremental_mapper.datasets.bag_recovery import BagReader, is_ros1
from incremental_mapper.datasets.headers import peek_header
from incremental_mapper.datasets.message_conversion import scan_from_message
from incremental_mapper.datasets.record_times import record_times
from incremental_mapper.datasets.sensor_settings import offset_nanoseconds
from incremental_mapper.datasets.topics import CLOUD
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.settings import make_config, merge

PLACES = 9
"""Places in the recording where a message of each sensor is read."""
AN_END = 3
"""First, and last, messages of each sensor that are read: one of them may be stray."""
_IN_TURN = NANOSECONDS // 5
"""Nanoseconds by which messages may come out of turn: half of what a window waits for them."""
_PASSES = 1_000_000
"""Nanoseconds from message to message, at least, where record times are of a recording."""
_ALL = 2000
"""Messages that are read of a bag without an index or record times, from its beginning on."""

_COARSE = 40
"""Consecutive messages that are read where the first and the last ones have stamps that stand."""
_BEHIND = 2.0
"""Mean steps of a sensor's record times by which its stamps may lag now more and now less; where
messages are stamped as they are taken from a queue, a few at a time, it is as many as those."""
_PAIRS = 2
"""So many of the first and last stamps that stand make a suspicion: a message recorded twice is
one."""

Logged: TypeAlias = tuple[Any, int, bytes]
"""A connection of the bag, a record time in nanoseconds, and a message as it lies in the bag."""


@dataclass(frozen=True, slots=True)
class CheckedClocks:
    """What the clocks of an input show.

    Attributes:
        offsets: nanoseconds to add to the stamps of each sensor, mended ones included.
        settings: the mended offsets as a tree of settings.
        findings: what is wrong.
        apart: sensors that share no time with the LiDARs: they would tear the map apart.
    """

    offsets: dict[str, int]
    settings: Tree
    findings: tuple[Finding, ...]
    apart: frozenset[str]


def check_clocks(
    clocks: Callable[[Mapping[str, int], Sequence[str]], Sequence[SensorClock]],
    tree: Mapping[str, Any],
    sensors: Sequence[str],
) -> CheckedClocks:
    """Hold the clocks of an input against each other, and mend what is certain.

    Args:
        clocks: makes the evidence of the offsets in force (ns) and the sensors whose are set.
        tree: the settings; offsets that they name stay as they are.
        sensors: names of all sensors of the input.
    """
    config = make_config(tree)
    known = {**config.lidars, 'imu': config.imu, 'gnss': config.gnss}
    sections = {**dict(tree.get('lidars') or {}), **{k: tree.get(k) for k in NOT_LIDARS}}
    chosen = [name for name in sensors if 'time_offset' in (sections.get(name) or {})]
    offsets = {name: offset_nanoseconds(known[name]) if name in known else 0 for name in sensors}
    findings = clock_findings(clocks(offsets, chosen))
    settings: Tree = {}
    for finding in findings:
        if finding.severity is Severity.MENDED:
            settings = merge(settings, finding.settings)
            mended = make_config(finding.settings)
            sensor = {**mended.lidars, 'imu': mended.imu, 'gnss': mended.gnss}[finding.sensor]
            offsets[finding.sensor] = offset_nanoseconds(sensor)
    apart = frozenset(item.sensor for item in findings if item.rule == 'no_common_time')
    return CheckedClocks(offsets, settings, findings, apart)


class ClockLook:
    """Reads headers of a bag's sensors; ``restamped`` are those that have record times for stamps.

    ``sensors`` are the topics' sensors by frame_id, None where the topic is one sensor's.
    """

    def __init__(self, reader: BagReader, sensors: Mapping[str, Mapping[str | None, str]]) -> None:
        self._reader = reader
        self._sensors = sensors
        self._pairs: dict[str, list[tuple[int, int]]] = {}
        self._leads: dict[str, int] = {}
        self.times: dict[str, NDArray[np.int64]] = {}
        self._bare: dict[str, list[int]] = {}  # record times of messages without a stamp
        self.restamped: frozenset[str] = frozenset()
        self.findings: tuple[Finding, ...] = ()
        self._look()
        self._restamp()
        self._restamp_coarse()

    def clocks(self, offsets: Mapping[str, int], chosen: Sequence[str]) -> list[SensorClock]:
        """What was read, with the offsets (ns) added; ``chosen`` are sensors whose are set."""
        made = []
        for sensor, pairs in self._pairs.items():
            table = np.array(sorted(set(pairs)), dtype=np.int64)
            offset = offsets.get(sensor, 0)
            made.append(
                SensorClock(
                    sensor,
                    table[:, 1] + offset,
                    table[:, 0],
                    offset,
                    sensor in chosen,
                    self._leads.get(sensor, 0),
                )
            )
        return made

    def order_shifts(self, offsets: Mapping[str, int]) -> dict[str, int]:
        """Nanoseconds to add to the record times of a sensor so that it takes its turn.

        Where somebody wrote the stamps in place of the record times, the sensors do not take turns
        as they did: one whose clock is an hour ahead comes after all the others. ``offsets`` are
        what is added to the stamps.
        """
        shifts: dict[str, int] = {}
        if len(self.times) < len(self._sensors):
            return shifts  # without an index the file can be read from end to end only
        for sensor, pairs in self._pairs.items():
            lag = int(np.median([received - stamp for received, stamp in pairs]))
            own = sensor not in self.restamped
            if own and abs(offsets[sensor]) > _IN_TURN and abs(lag) < _IN_TURN:
                shifts[sensor] = offsets[sensor]
        return shifts

    def _restamp(self) -> None:
        """Let record times stand in where no message of a sensor has a stamp."""
        bare = {name: times for name, times in self._bare.items() if name not in self._pairs}
        # A converter that has no record times writes one, or zeros: nothing passes.
        useful = {
            name
            for name, times in bare.items()
            if min(times) > 0 and max(times) - min(times) > _PASSES * len(times)
        }
        self.restamped = frozenset(useful)
        for name in useful:
            self._pairs[name] = [(received, received) for received in bare[name]]
        self.findings = tuple(
            unstamped_finding(name, len(times), name in useful) for name, times in bare.items()
        )

    def _restamp_coarse(self) -> None:
        """Let record times stand in where the stamps of a sensor stand still and leap."""
        for topic, by_frame in self._sensors.items():
            times = self.times.get(topic)
            if times is None or len(times) < _COARSE:
                continue
            for frame, name in by_frame.items():
                pairs = np.array(sorted(self._pairs.get(name, [])), dtype=np.int64).reshape(-1, 2)
                if name in self.restamped or not _may_stand(pairs, times):
                    continue
                start = int(times[(len(times) - _COARSE) // 2])
                run = self._pairs_of(topic, frame, start)
                if not is_coarse(run):
                    continue
                self.restamped |= {name}
                self._pairs[name] = [(received, received) for received, _ in pairs.tolist()]
                self.findings += (coarse_finding(name, standing_steps(run), len(run)),)

    def _pairs_of(self, topic: str, frame: str | None, start: int) -> NDArray[np.int64]:
        """Record times and stamps (N, 2) of consecutive messages of one sensor."""
        found = []
        messages = self._messages([topic], start)
        for _, (connection, received, data) in zip(range(2 * _COARSE), messages, strict=False):
            try:
                stamp, its = peek_header(data, is_ros1(connection))
            except (struct.error, UnicodeDecodeError):
                continue
            if frame is None or its == frame:
                found.append((received, stamp))
        return np.array(found[:_COARSE], dtype=np.int64).reshape(-1, 2)

    def _look(self) -> None:
        self.times = record_times(self._reader, list(self._sensors))
        every = list(self.times.values())
        whole = np.sort(np.concatenate(every)) if every else np.zeros(0, dtype=np.int64)
        # By one and the same record time only the first messages would be found, again and again.
        if len(self.times) < len(self._sensors) or (len(whole) and whole[0] == whole[-1]):
            self._take(self._messages(list(self._sensors), None), _ALL)
            return
        if not len(whole):
            return
        places = whole[np.linspace(0, len(whole) - 1, PLACES).astype(int)]
        for topic, times in self.times.items():
            if not len(times):
                continue
            self._take(self._messages([topic], int(times[0])), AN_END)
            late = max(len(times) - AN_END, 0)
            for index in np.unique(np.searchsorted(times, places)):
                if AN_END <= index < late:
                    self._take(self._messages([topic], int(times[index])), 1)
            self._take(self._messages([topic], int(times[late])), AN_END)

    def _messages(
        self, topics: Sequence[str], start: int | None
    ) -> Iterator[tuple[Any, int, bytes]]:
        connections = [c for c in self._reader.connections if c.topic in topics]
        messages = self._reader.messages(connections=connections, start=start)
        while True:
            # Damage is counted when its turn comes.
            try:
                yield next(messages)
            except Exception:
                return

    def _take(self, messages: Iterator[Logged], most: int) -> None:
        for _, (connection, received, data) in zip(range(most), messages, strict=False):
            try:
                stamp, frame = peek_header(data, is_ros1(connection))
            except (struct.error, UnicodeDecodeError):
                continue
            by_frame = self._sensors[connection.topic]
            sensor = by_frame.get(None) or by_frame.get(frame)
            if sensor is None:
                continue
            if stamp <= 0:
                self._bare.setdefault(sensor, []).append(received)
                continue
            self._pairs.setdefault(sensor, []).append((received, stamp))
            if sensor not in self._leads:
                self._leads[sensor] = self._lead(connection.msgtype, data)

    def _lead(self, kind: str, data: bytes) -> int:
        """Nanoseconds from the stamp of a cloud to its last point, 0 where it does not tell."""
        if kind != CLOUD:
            return 0
        try:
            times = scan_from_message(self._reader.deserialize(data, kind), 'cloud').point_times
        except Exception:
            return 0
        return 0 if times is None else max(round(float(times.max()) * NANOSECONDS), 0)


def _may_stand(pairs: NDArray[np.int64], times: NDArray[np.int64]) -> bool:
    """Whether stamps may stand between the few messages that were read.

    Args:
        pairs: Record times and stamps (N, 2) of these, ns.
        times: Record times of all messages, ns.
    """
    if standing_steps(pairs) >= _PAIRS:
        return True
    step = float(times[-1] - times[0]) / (len(times) - 1)
    return len(pairs) > 1 and float(np.ptp(pairs[:, 0] - pairs[:, 1])) > _BEHIND * step
