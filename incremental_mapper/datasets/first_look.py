"""A look at the first messages of a topic: whose they are, and what part of a turn they hold."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader

from incremental_mapper.checks.sweeps import partial_sweeps, take_turns
from incremental_mapper.datasets.bag_files import Topic
from incremental_mapper.datasets.message_conversion import describe_times
from incremental_mapper.datasets.point_clouds import cloud_points, cloud_table
from incremental_mapper.errors import MeasurementError

LOOKED_AT = 24
"""First clouds that are looked at: two sweeps of a LiDAR that sends tenths, and some."""


@dataclass(frozen=True, slots=True)
class TopicLook:
    """What the first messages of a topic show.

    Attributes:
        frames: number of messages by frame_id.
        times: what the points' times are, by frame_id, in words.
        partial: share of the sweep in one cloud, where clouds are parts of one; else None.
        alternating: whether two kinds of clouds take turns under one frame_id.
    """

    frames: dict[str, int]
    times: dict[str, str]
    partial: float | None = None
    alternating: bool = False


def look_at_frame(reader: AnyReader, topic: Topic) -> str:
    """Read the frame_id of the first message that can be read, or '' where none can."""
    for message in messages_of(reader, topic):
        return _frame(message)
    return ''


def look_at_clouds(reader: AnyReader, topic: Topic) -> TopicLook:
    """Look at the first clouds of a topic; those that cannot be read say nothing.

    Args:
        reader: an open bag.
        topic: one of ``sensor_msgs/PointCloud2``.

    Returns:
        What they show.
    """
    frames: Counter[str] = Counter()
    times: dict[str, str] = {}
    clouds: list[NDArray[np.float32]] = []
    for count, message in enumerate(messages_of(reader, topic)):
        if count >= LOOKED_AT:
            break
        frame = _frame(message)
        frames[frame] += 1
        try:
            if frame not in times:
                times[frame] = describe_times(message)
            points = cloud_points(cloud_table(message).points)
        except MeasurementError:
            continue
        clouds.append(points[np.isfinite(points).all(axis=1) & points.any(axis=1)])
    one = len(frames) == 1
    return TopicLook(
        dict(frames),
        times,
        partial_sweeps(clouds) if one else None,
        one and take_turns(clouds),
    )


def count_frames(reader: AnyReader, topic: Topic) -> Counter[str]:
    """Count all messages of a topic by frame_id; unreadable ones are left out."""
    return Counter(_frame(message) for message in messages_of(reader, topic))


def messages_of(reader: AnyReader, topic: Topic) -> Iterator[Any]:
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
