"""A look at the first messages of a topic: whose they are, and what part of a turn they hold."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader

from incremental_mapper.datasets.bag_files import Topic
from incremental_mapper.datasets.message_conversion import describe_times
from incremental_mapper.datasets.point_clouds import cloud_points, cloud_table
from incremental_mapper.errors import MeasurementError

LOOKED_AT = 24
"""First clouds that are looked at: two sweeps of a LiDAR that sends tenths, and some."""
_FEWEST = 12
"""Clouds that tell what a LiDAR sends."""
_BINS = 72
_PARTIAL = 0.6
"""Share of the turn that all clouds together cover, below which single ones are partial. Whole
sweeps have 1.0, halves 0.5."""
_OVERLAP = 0.5
"""Share of a cloud's directions that the next cloud of a turning LiDAR has too, at most, where each
is a part of the sweep. A LiDAR that looks one way covers the same each time."""
_DENSE = 3.0
"""Points for each of the directions that a cloud covers; with fewer nothing can be told."""
_ALTERNATE = 0.35
"""How much more a cloud is like the one before the last than like the last, where two LiDARs take
turns. One LiDAR has about 1.3 on a street, more on a turn."""
_APART = 0.3
"""Metres by which the clouds of two LiDARs differ at least, on average."""


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
    for message in _messages(reader, topic):
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
    for count, message in enumerate(_messages(reader, topic)):
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
    one = len(frames) == 1 and len(clouds) >= _FEWEST
    return TopicLook(
        dict(frames),
        times,
        _partial(clouds) if one else None,
        one and _alternating(clouds),
    )


def count_frames(reader: AnyReader, topic: Topic) -> Counter[str]:
    """Count all messages of a topic by frame_id; unreadable ones are left out."""
    return Counter(_frame(message) for message in _messages(reader, topic))


def _messages(reader: AnyReader, topic: Topic) -> Iterator[Any]:
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


def _partial(clouds: list[NDArray[np.float32]]) -> float | None:
    """Share of the directions in one cloud, where each cloud is another part of the sweep."""
    if np.median([len(cloud) for cloud in clouds]) < 1:
        return None
    covered = np.array([_directions(cloud) for cloud in clouds])
    sizes = covered.sum(axis=1)
    points = np.array([len(cloud) for cloud in clouds])
    share = float(np.median(sizes) / max(covered.any(axis=0).sum(), 1))
    with_next = (covered[:-1] & covered[1:]).sum(axis=1) / np.maximum(sizes[:-1], 1)
    dense = bool((points >= _DENSE * sizes).mean() > 0.5)
    return share if share < _PARTIAL and np.median(with_next) < _OVERLAP and dense else None


def _directions(cloud: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Which of the directions around the LiDAR have points."""
    azimuth = np.arctan2(cloud[:, 1], cloud[:, 0])
    index = ((azimuth / (2.0 * np.pi) + 0.5) * _BINS).astype(int) % _BINS
    return np.bincount(index, minlength=_BINS) > 0


def _alternating(clouds: list[NDArray[np.float32]]) -> bool:
    """Whether clouds are like the one before the last, and unlike the last."""
    if min(len(cloud) for cloud in clouds) < 2:
        return False
    kinds = np.array([[*cloud.mean(axis=0), *cloud.std(axis=0)] for cloud in clouds])
    last = float(np.median(np.abs(kinds[1:] - kinds[:-1]).sum(axis=1)))
    before = float(np.median(np.abs(kinds[2:] - kinds[:-2]).sum(axis=1)))
    return last > _APART and before < _ALTERNATE * last
