"""A look at the first messages of a topic: whose they are, and what part of a turn they hold."""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from incremental_mapper.checks.cloud_copies import FULL_CLOUDS, CloudTopic
from incremental_mapper.checks.sweeps import FEWEST_CLOUDS, partial_sweeps, take_turns
from incremental_mapper.datasets.bag_files import Topic
from incremental_mapper.datasets.bag_recovery import BagReader
from incremental_mapper.datasets.message_conversion import describe_times, header_stamp
from incremental_mapper.datasets.point_clouds import cloud_table
from incremental_mapper.errors import MeasurementError
from incremental_mapper.measurements import Points

LOOKED_AT = 2 * FEWEST_CLOUDS
"""First clouds that are looked at where each is a part of a sweep: two sweeps of tenths, and some;
half as many tell of whole sweeps."""
_SAMPLE = 4001
"""Points of a cloud that are looked at. It is prime: a step through the cloud stays in no step with
the lasers."""
STRAY = 0.05
"""Share of a topic's messages below which a frame_id is that of stray messages. Of LiDARs that take
turns on one topic the slowest has a tenth: one at 1 Hz beside one at 10 Hz."""


@dataclass(frozen=True, slots=True)
class TopicLook:
    """What the first messages of a topic show.

    Attributes:
        frames: number of messages by frame_id.
        times: what the points' times are, by frame_id, in words.
        points: usable points of a cloud, by frame_id; the median.
        sizes: usable points of each cloud, by stamp.
        whole: usable points (N, 3) of the first few clouds, by stamp.
        partial: share of the sweep in one cloud, by frame_id, where clouds are parts of one.
        alternating: whether two kinds of clouds take turns under one frame_id.
    """

    frames: dict[str, int]
    times: dict[str, str]
    points: dict[str, float]
    sizes: dict[int, int]
    whole: dict[int, Points]
    partial: dict[str, float] = field(default_factory=dict)
    alternating: bool = False

    def topic(self) -> CloudTopic:
        """The evidence of whether these are copies of another topic's clouds."""
        return CloudTopic(next(iter(self.frames), ''), self.sizes, self.whole)


def look_at_frame(reader: BagReader, topic: Topic) -> str:
    """Read the frame_id of the first message that can be read, or '' where none can."""
    for message in messages_of(reader, topic):
        return _frame(message)
    return ''


def look_at_clouds(reader: BagReader, topic: Topic) -> TopicLook:
    """Look at the first clouds of a topic; those that cannot be read say nothing.

    Args:
        reader: an open bag.
        topic: one of clouds.

    Returns:
        What they show.
    """
    frames: Counter[str] = Counter()
    times: dict[str, str] = {}
    by_frame: dict[str, list[int]] = {}
    sizes: dict[int, int] = {}
    whole: dict[int, Points] = {}
    clouds: dict[str, list[Points]] = {}
    parts: dict[str, float] | None = None
    for count, message in enumerate(messages_of(reader, topic)):
        # Parts of sweeps take twice as many, of each LiDAR.
        if parts is None and count >= FEWEST_CLOUDS * max(len(frames), 1):
            parts = _parts(clouds)
            if len(frames) == 1 and not parts:
                break
        if count >= LOOKED_AT * (len(frames) if parts else 1):
            break
        frame = _frame(message)
        frames[frame] += 1
        try:
            if frame not in times:
                times[frame] = describe_times(message)
            stamp, points = header_stamp(message), _usable(message)
        except MeasurementError:
            continue
        sizes[stamp] = len(points)
        by_frame.setdefault(frame, []).append(len(points))
        if len(whole) < FULL_CLOUDS:
            whole[stamp] = points
        clouds.setdefault(frame, []).append(_sample(points))
    shares = _parts(clouds) if parts else {}
    alone = next(iter(clouds.values())) if len(frames) == 1 == len(clouds) else []
    return TopicLook(
        dict(frames),
        times,
        {frame: float(np.median(found)) for frame, found in by_frame.items()},
        sizes,
        whole,
        shares,
        not shares and take_turns(alone),
    )


def _parts(clouds: Mapping[str, list[Points]]) -> dict[str, float]:
    """Share of the sweep in one cloud, by frame_id, where clouds are parts of one."""
    shares = {frame: partial_sweeps(own) for frame, own in clouds.items()}
    return {frame: share for frame, share in shares.items() if share is not None}


def _usable(message: Any) -> Points:
    """The points of a cloud that are some; raises MeasurementError where there is no cloud."""
    points = cloud_table(message).xyz()
    with np.errstate(over='ignore', invalid='ignore'):
        distance = np.abs(points).sum(axis=1)
    usable: Points = points[np.isfinite(distance) & (distance > 0.0)]
    return usable


def _sample(points: Points) -> Points:
    if len(points) <= _SAMPLE:
        return points
    return points[np.arange(_SAMPLE) * len(points) // _SAMPLE]


def count_frames(reader: BagReader, topic: Topic) -> Counter[str]:
    """Count all messages of a topic by frame_id; unreadable ones are left out."""
    return Counter(_frame(message) for message in messages_of(reader, topic))


def frames_of_sensors(counts: Mapping[str, int]) -> Counter[str]:
    """The frame_ids of a topic that LiDARs send, the one with the most messages first.

    Args:
        counts: number of messages by frame_id.
    """
    fewest = STRAY * sum(counts.values())
    ranked = sorted(counts.items(), key=lambda item: -item[1])
    return Counter({frame: count for frame, count in ranked if count >= fewest})


def messages_of(reader: BagReader, topic: Topic) -> Iterator[Any]:
    """Read the messages of a topic that can be read, up to the first damaged chunk."""
    connections = [c for c in reader.connections if c.topic == topic.name]
    if not connections:
        return
    messages = reader.messages(connections=connections)
    while True:
        # Damaged messages are counted when their turn comes; nothing is told of them here.
        try:
            connection, _, data = next(messages)
        except StopIteration:
            return
        except Exception:
            return
        try:
            message = reader.deserialize(data, connection.msgtype)
        except Exception:
            continue
        yield message


def _frame(message: Any) -> str:
    return str(message.header.frame_id)
