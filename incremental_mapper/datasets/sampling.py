"""A bounded number of an input's records, spread over it: what a look at it has to go by."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.errors import MeasurementError
from incremental_mapper.measurements import NANOSECONDS, LidarScan, Measurement

Stamps = NDArray[np.int64]


class SensorKind(StrEnum):
    """What a sensor measures."""

    LIDAR = 'lidar'
    IMU = 'imu'
    GNSS = 'gnss'


@dataclass(frozen=True, slots=True)
class SamplePlan:
    """How much is read: the first seconds, then short blocks at even distances.

    An IMU at rest shows gravity in the first seconds.

    Attributes:
        first: seconds at the beginning.
        blocks: number of blocks.
        seconds: length of a block.
        clouds: clouds of a block that are read in full; of the others only the headers count.
        most: clouds of a LiDAR that are read in full where there is one block.
        fixes: further fixes that are looked up one by one; they are far between.
    """

    first: float = 2.0
    blocks: int = 8
    seconds: float = 1.0
    clouds: int = 2
    most: int = 8
    fixes: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class SensorSample:
    """What was read of one sensor.

    Attributes:
        sensor: its name.
        kind: what it measures.
        count: number of its messages in the whole input.
        topic: where they come from; '' in a folder.
        frame: their frame_id; '' where there is none.
        origin: where its extrinsics come from, in words.
        logged: whether there are times of recording; in a folder there are stamps alone, which
            then stand for them.
        recorded: when each of all messages was recorded (count,), ns ascending; empty where that
            is not known.
        stamps: header stamps (M,) of the messages that were read, with the time offset of the
            settings, ns.
        received: when those were recorded (M,), ns.
        blocks: which run of neighbouring messages each belongs to (M,).
        measurements: those that could be used, in order; of clouds some of them.
        drops: those that could not, by reason.
        fields: names of a cloud's fields.
    """

    sensor: str
    kind: SensorKind
    count: int
    topic: str = ''
    frame: str = ''
    origin: str = ''
    logged: bool = False
    recorded: Stamps = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    stamps: Stamps = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    received: Stamps = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    blocks: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    measurements: tuple[Measurement, ...] = ()
    drops: Counter[str] = field(default_factory=Counter)
    fields: tuple[str, ...] = ()

    @property
    def steps(self) -> NDArray[np.float64]:
        """Seconds from message to message: of all of them, else within the blocks."""
        if len(self.recorded) > 1:
            whole: NDArray[np.float64] = np.diff(self.recorded) / NANOSECONDS
            return whole
        inside = self.blocks[1:] == self.blocks[:-1]
        within: NDArray[np.float64] = np.diff(self.received)[inside] / NANOSECONDS
        return within

    @property
    def rate(self) -> float:
        """Messages a second where they come; 0 where it cannot be told."""
        usual = float(np.median(self.steps)) if len(self.steps) else 0.0
        return 1.0 / usual if usual > 0.0 else 0.0


@runtime_checkable
class Sampled(Protocol):
    """An input of which a sample can be taken."""

    def sample(self, plan: SamplePlan) -> tuple[SensorSample, ...]:
        """Read a sample of every sensor; what cannot be read says nothing."""

    def scans(
        self, sensor: str, bounds: Sequence[tuple[int, int]]
    ) -> Iterator[tuple[int, LidarScan]]:
        """Read the usable scans of a LiDAR that were recorded in some spans (start, stop), ns.

        Each comes with the number of its span.
        """

    def truth_place(self) -> str:
        """Where ``truth`` would be read from, '' where there is none; nothing is read."""


def spans(
    begin: int, end: int, plan: SamplePlan, anchors: Stamps | None = None
) -> list[tuple[int, int]]:
    """Where a sample is taken.

    Args:
        begin: first time of the input, ns.
        end: last time.
        plan: how much.
        anchors: times of rare messages, ascending; a block begins just before the next one.

    Returns:
        Bounds (start, stop) in ns, ascending, apart; one span where the input is short.
    """
    first, length = int(plan.first * NANOSECONDS), int(plan.seconds * NANOSECONDS)
    if end - begin <= first + plan.blocks * length:
        return [(begin, end + 1)]
    found = [(begin, begin + first)]
    # The last block ends with the input.
    for start in np.linspace(begin + first, end - length, plan.blocks + 1)[1:].astype(np.int64):
        if anchors is not None and len(anchors):
            after = anchors[np.searchsorted(anchors, start) :]
            if len(after) and after[0] < start + 4 * length and after[0] <= end:
                start = min(int(after[0]) - length // 3, end - length)
        start = max(int(start), found[-1][1])
        found.append((start, min(start + length, end) + 1))
    return found


def clouds_of_each(bounds: Sequence[tuple[int, int]], plan: SamplePlan) -> int:
    """How many clouds of each span are read in full."""
    return plan.most if len(bounds) == 1 else plan.clouds


class SampleMaker:
    """Gathers one sensor's messages into a sample."""

    def __init__(self, clouds: int, **facts: Any) -> None:
        """Of each block so many ``clouds`` are made; ``facts`` are known before any is read."""
        self._most, self._facts = clouds, facts
        self._times: list[tuple[int, int, int]] = []
        self._made: list[Measurement] = []
        self._drops: Counter[str] = Counter()
        self._clouds: Counter[int] = Counter()
        self._fields: tuple[str, ...] = ()

    def add(
        self,
        block: int,
        received: int,
        stamp: int,
        make: Callable[[], Measurement],
        names: Any = (),
    ) -> None:
        """Take the next message.

        Args:
            block: number of its span.
            received: when it was recorded, ns.
            stamp: its stamp, ns.
            make: makes the measurement; raises MeasurementError where that cannot be.
            names: field names of a cloud.
        """
        self._times.append((stamp, received, block))
        if self._facts['kind'] is SensorKind.LIDAR:
            if not self.wants(block):
                return
            self._clouds[block] += 1
            self._fields = self._fields or tuple(names)
        try:
            self._made.append(make())
        except MeasurementError as error:
            self._drops[error.reason] += 1

    def wants(self, block: int) -> bool:
        """Whether another cloud of a block is made; of others the times are enough."""
        return self._clouds[block] < self._most

    def drop(self, reason: str) -> None:
        """Count a message that cannot be used at all."""
        self._drops[reason] += 1

    def sample(self) -> SensorSample:
        """What was gathered, by the time of recording."""
        table = np.array(sorted(self._times, key=lambda row: row[1]), dtype=np.int64).reshape(-1, 3)
        return SensorSample(
            **self._facts,
            stamps=table[:, 0],
            received=table[:, 1],
            blocks=table[:, 2],
            measurements=tuple(sorted(self._made, key=lambda item: item.stamp)),
            drops=self._drops,
            fields=self._fields,
        )


def scans_of(sample: SensorSample) -> Iterator[LidarScan]:
    """The scans of a LiDAR's sample."""
    return (item for item in sample.measurements if isinstance(item, LidarScan))


def spread(times: Stamps, count: int) -> Sequence[int]:
    """At most ``count`` of some times, evenly."""
    if len(times) <= count:
        return [int(time) for time in times]
    return [int(times[index]) for index in np.linspace(0, len(times) - 1, count).astype(int)]
