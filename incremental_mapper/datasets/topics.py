"""Which topics of a bag are the sensors: those that the settings name, else the likely ones."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from incremental_mapper.config import Config, Sensor
from incremental_mapper.datasets.bag_files import Topic, describe_topics
from incremental_mapper.errors import InputError

CLOUD = 'sensor_msgs/msg/PointCloud2'
IMU = 'sensor_msgs/msg/Imu'
FIX = 'sensor_msgs/msg/NavSatFix'
ODOMETRY = 'nav_msgs/msg/Odometry'
TRUTH_TOPIC = '/ground_truth/odometry'


@dataclass(frozen=True, slots=True)
class TopicChoice:
    """Topic of every sensor that the bag has, and remarks on how they were chosen."""

    topics: dict[str, Topic]
    lidars: tuple[str, ...]
    notes: tuple[str, ...]


def choose_topics(path: Path, topics: Sequence[Topic], config: Config) -> TopicChoice:
    """Find the LiDARs', the IMU's and the receiver's topics.

    Args:
        path: the bag, for messages.
        topics: what the bag has.
        config: settings, which may name topics and LiDARs.

    Returns:
        The topics; of several that could be meant, the one with the most messages.

    Raises:
        InputError: a named topic is missing or of another type, two LiDARs share one, or there is
            no cloud at all; the message lists what the bag has.
    """
    notes: list[str] = []
    lidars = _lidars(path, topics, config.lidars, notes)
    chosen = dict(lidars)
    shared = [a for a in lidars if any(lidars[a] == lidars[b] for b in lidars if b != a)]
    if shared:
        raise InputError(f'{path}: LiDARs {", ".join(shared)} have the same topic')
    for name, sensor, kind in (('imu', config.imu, IMU), ('gnss', config.gnss, FIX)):
        topic = (
            _named(path, topics, f'{name}.topic', sensor.topic, kind)
            if sensor.topic
            else _likeliest(topics, name, kind, notes)
        )
        if topic is not None:
            chosen[name] = topic
    return TopicChoice(chosen, tuple(lidars), tuple(notes))


def find_truth_topic(topics: Sequence[Topic]) -> str | None:
    """An odometry topic that holds the truth, or None."""
    names = [t.name for t in topics if t.type == ODOMETRY and t.count and 'truth' in t.name.lower()]
    return TRUTH_TOPIC if TRUTH_TOPIC in names else next(iter(names), None)


def _lidars(
    path: Path, topics: Sequence[Topic], sensors: Mapping[str, Sensor], notes: list[str]
) -> dict[str, Topic]:
    clouds = [topic for topic in topics if topic.type == CLOUD and topic.count]
    chosen = {
        name: _named(path, topics, f'lidars.{name}.topic', sensor.topic, CLOUD)
        for name, sensor in sensors.items()
        if sensor.topic
    }
    if not sensors:
        chosen = _name_clouds(clouds)
        notes.extend(f'LiDAR {name}: topic {topic.name}' for name, topic in chosen.items())
    for name in sensors:
        if name in chosen:
            continue
        free = [topic for topic in clouds if topic not in chosen.values()]
        matches = [topic for topic in free if name.lower() in topic.name.lower()]
        if len(sensors) == 1 and len(free) == 1:
            matches = free
        if not matches:
            notes.append(f'LiDAR {name}: no cloud topic has {name!r} in its name')
            continue
        chosen[name] = max(matches, key=lambda topic: topic.count)
        notes.append(f'LiDAR {name}: topic {chosen[name].name}')
    if not chosen:
        wanted = f'no cloud for the LiDARs {", ".join(sensors)}' if sensors else 'no LiDAR messages'
        raise InputError(
            f'{path}: {wanted}; set lidars.<name>.topic to one of the PointCloud2 topics. '
            + describe_topics(topics)
        )
    return chosen


def _named(path: Path, topics: Sequence[Topic], key: str, name: str, kind: str) -> Topic:
    # The node's topic names are relative; a bag's are absolute.
    topic = next((t for t in topics if t.name.lstrip('/') == name.lstrip('/')), None)
    if topic is None:
        raise InputError(f'{path}: has no topic {name!r} ({key}). {describe_topics(topics)}')
    if topic.type != kind:
        raise InputError(
            f'{path}: topic {name!r} ({key}) is {topic.type}, expected {kind}. '
            + describe_topics(topics)
        )
    return topic


def _likeliest(topics: Sequence[Topic], name: str, kind: str, notes: list[str]) -> Topic | None:
    found = [topic for topic in topics if topic.type == kind and topic.count]
    if not found:
        notes.append(f'{name}: no {kind} messages')
        return None
    best = max(found, key=lambda topic: topic.count)
    others = ', '.join(topic.name for topic in found if topic is not best)
    notes.append(
        f'{name}: topic {best.name}' + (f' has more messages than {others}' * bool(others))
    )
    return best


def _name_clouds(clouds: Sequence[Topic]) -> dict[str, Topic]:
    """Names that tell the LiDARs apart: ``/left/points`` is left, ``/points_left`` points_left."""
    names = {}
    for topic in clouds:
        parts = topic.name.strip('/').split('/')
        generic = len(parts) > 1 and any(word in parts[-1].lower() for word in ('point', 'cloud'))
        names[topic.name] = parts[-2] if generic else parts[-1]
    taken = list(names.values())
    return {
        names[t.name] if taken.count(names[t.name]) == 1 else t.name.strip('/').replace('/', '_'): t
        for t in clouds
    }
