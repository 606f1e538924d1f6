"""Which topics of a bag are the sensors: those that the settings name, else the likely ones."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from incremental_mapper.checks.chosen_topics import (
    missing_topic,
    one_of_several,
    vendor_message,
)
from incremental_mapper.checks.finding import Finding
from incremental_mapper.checks.sweeps import several_frames
from incremental_mapper.config import Config, Sensor
from incremental_mapper.datasets.bag_files import Topic, describe_topics
from incremental_mapper.datasets.livox import LIVOX_TYPES
from incremental_mapper.datasets.vendor_types import LIDAR_CONVERTERS, STANDARD, made_by
from incremental_mapper.errors import InputError

CLOUD = 'sensor_msgs/msg/PointCloud2'
CLOUDS = (CLOUD, *LIVOX_TYPES)
IMU = 'sensor_msgs/msg/Imu'
FIX = 'sensor_msgs/msg/NavSatFix'
ODOMETRY = 'nav_msgs/msg/Odometry'
TRUTH_TOPIC = '/ground_truth/odometry'


MAP_FRAMES = ('map', 'odom', 'world', 'earth', 'camera_init')
"""Frames that stand still: clouds in them are maps, or scans that somebody has moved already."""


@dataclass(frozen=True, slots=True)
class FrameTopic(Topic):
    """The messages of a topic that have one ``frame`` of several."""

    frame: str


@dataclass(frozen=True, slots=True)
class TopicChoice:
    """Topic of every sensor that the bag has, how they were chosen, and what was wrong."""

    topics: dict[str, Topic]
    lidars: tuple[str, ...]
    notes: tuple[str, ...]
    findings: tuple[Finding, ...] = ()

    def without(self, sensors: Collection[str]) -> 'TopicChoice':
        """The choice with some sensors left out."""
        topics = {name: topic for name, topic in self.topics.items() if name not in sensors}
        lidars = tuple(name for name in self.lidars if name not in sensors)
        return replace(self, topics=topics, lidars=lidars)


def choose_topics(
    path: Path,
    topics: Sequence[Topic],
    config: Config,
    frames: Mapping[str, Mapping[str, int]] | None = None,
    unsound: Mapping[str, str] | None = None,
    copies: Mapping[str, str] | None = None,
) -> TopicChoice:
    """Find the LiDARs', the IMU's and the receiver's topics.

    Args:
        path: the bag, for messages.
        topics: what the bag has.
        config: settings, which may name topics and LiDARs.
        frames: number of messages by frame_id of the cloud topics, where that is known; a topic
            with several is that of several LiDARs.
        unsound: what is wrong with IMUs and receivers, by topic; they are taken only where there
            is no other.
        copies: cloud topics that are copies of another one, and of which.

    Returns:
        The topics; of several that could be meant, the one with the most messages.

    Raises:
        InputError: a named topic is of another type, two LiDARs share one, or there is no cloud at
            all; the message lists what the bag has.
    """
    notes = [
        f'{topic.name}: {topic.type} is no cloud and is not read; {LIDAR_CONVERTERS[topic.type]} '
        'makes PointCloud2 of it (vendor_message)'
        for topic in topics
        if topic.type in LIDAR_CONVERTERS and topic.type not in CLOUDS and topic.count
    ]
    findings: list[Finding] = []
    counts = frames or {}
    single = {name: next(iter(found)) for name, found in counts.items() if len(found) == 1}
    split = _by_frame(topics, counts, findings)
    lidars = _lidars(path, split, config.lidars, single, copies or {}, notes, findings)
    chosen = dict(lidars)
    shared = [a for a in lidars if any(lidars[a] == lidars[b] for b in lidars if b != a)]
    if shared:
        raise InputError(f'{path}: LiDARs {", ".join(shared)} have the same topic')
    for name, sensor, kind in (('imu', config.imu, IMU), ('gnss', config.gnss, FIX)):
        topic = (
            _named(path, topics, name, f'{name}.topic', sensor.topic, (kind,), findings)
            if sensor.topic
            else _likeliest(topics, name, kind, notes, findings, unsound or {})
        )
        if topic is not None:
            chosen[name] = topic
    return TopicChoice(chosen, tuple(lidars), tuple(notes), tuple(findings))


def find_truth_topic(topics: Sequence[Topic]) -> str | None:
    """An odometry topic that holds the truth, or None."""
    names = [t.name for t in topics if t.type == ODOMETRY and t.count and 'truth' in t.name.lower()]
    return TRUTH_TOPIC if TRUTH_TOPIC in names else next(iter(names), None)


def _by_frame(
    topics: Sequence[Topic],
    frames: Mapping[str, Mapping[str, int]],
    findings: list[Finding],
) -> list[Topic]:
    """The topics, with one for each frame_id where clouds of several LiDARs come on one."""
    split: list[Topic] = []
    for topic in topics:
        counts = frames.get(topic.name, {})
        if topic.type not in CLOUDS or len(counts) < 2:
            split.append(topic)
            continue
        split.extend(
            FrameTopic(topic.name, topic.type, count, frame) for frame, count in counts.items()
        )
        findings.append(several_frames(topic.name, counts))
    return split


def _without_maps(clouds: list[Topic], frames: Mapping[str, str], notes: list[str]) -> list[Topic]:
    """The clouds that are in a sensor's frame."""
    kept = []
    for topic in clouds:
        frame = frames.get(topic.name, '') if not isinstance(topic, FrameTopic) else topic.frame
        if frame.lstrip('/') in MAP_FRAMES:
            notes.append(
                f"{topic.name}: its clouds are in the frame {frame!r}, which is no LiDAR's; left "
                'out (map_frame); lidars.<name>.topic uses it all the same'
            )
        else:
            kept.append(topic)
    return kept


def _without_copies(
    clouds: list[Topic], copies: Mapping[str, str], notes: list[str]
) -> list[Topic]:
    """The clouds that nobody made of others that are there."""
    there = {topic.name for topic in clouds}
    kept = []
    for topic in clouds:
        original = copies.get(topic.name)
        if original in there:
            notes.append(
                f'{topic.name}: has the stamps and the points of {original}; left out '
                '(copied_clouds); lidars.<name>.topic uses it all the same'
            )
        else:
            kept.append(topic)
    return kept


def _lidars(
    path: Path,
    topics: Sequence[Topic],
    sensors: Mapping[str, Sensor],
    frames: Mapping[str, str],
    copies: Mapping[str, str],
    notes: list[str],
    findings: list[Finding],
) -> dict[str, Topic]:
    clouds = [topic for topic in topics if topic.type in CLOUDS and topic.count]
    chosen: dict[str, Topic] = {}
    for name, sensor in sensors.items():
        if sensor.topic:
            key = f'lidars.{name}.topic'
            named = _named(path, topics, name, key, sensor.topic, CLOUDS, findings)
            if named is not None:
                chosen[name] = named
    free = [topic for topic in clouds if topic not in chosen.values()]
    if len(chosen) < len(sensors) or not sensors:
        free = _without_copies(_without_maps(free, frames, notes), copies, notes)
    if not sensors:
        chosen = _name_clouds(free)
        notes.extend(f'LiDAR {name}: topic {_called(topic)}' for name, topic in chosen.items())
    for name, sensor in sensors.items():
        if name in chosen or sensor.topic:
            continue
        left = [topic for topic in free if topic not in chosen.values()]
        matches = [topic for topic in left if name.lower() in _called(topic).lower()]
        if len(sensors) == 1 and len(left) == 1:
            matches = left
        if not matches:
            notes.append(f'LiDAR {name}: no cloud topic has {name!r} in its name')
            continue
        chosen[name] = max(matches, key=lambda topic: topic.count)
        notes.append(f'LiDAR {name}: topic {_called(chosen[name])}')
    if not chosen:
        wanted = f'no cloud for the LiDARs {", ".join(sensors)}' if sensors else 'no LiDAR messages'
        told = [note for note in notes if 'vendor_message' in note or 'map_frame' in note]
        reasons = ''.join(f'{what}. ' for what in (*told, *(found.text for found in findings)))
        raise InputError(
            f'{path}: {wanted}; set lidars.<name>.topic to one of the PointCloud2 topics. '
            + reasons
            + describe_topics(topics)
        )
    return chosen


def _called(topic: Topic) -> str:
    """A topic for people, with its frame where it is one of several."""
    return f'{topic.name}, frame {topic.frame}' if isinstance(topic, FrameTopic) else topic.name


def _named(
    path: Path,
    topics: Sequence[Topic],
    sensor: str,
    key: str,
    name: str,
    kinds: Sequence[str],
    findings: list[Finding],
) -> Topic | None:
    """The topic that the settings name; None with a finding where the bag lacks it.

    Of a topic with several frames it is the one that has the ``sensor``'s name in it, else the one
    with the most messages.
    """
    # The node's topic names are relative; a bag's are absolute.
    found = [t for t in topics if t.name.lstrip('/') == name.lstrip('/')]
    if not found:
        of_kind = sorted({t.name for t in topics if t.type in kinds})
        findings.append(missing_topic(sensor, key, name, of_kind))
        findings.extend(() if of_kind else _by_vendor(topics, sensor))
        return None
    if found[0].type not in kinds:
        raise InputError(
            f'{path}: topic {name!r} ({key}) is {found[0].type}, expected {kinds[0]}'
            f'{_maker(found[0], sensor)}. ' + describe_topics(topics)
        )
    fitting = [t for t in found if isinstance(t, FrameTopic) and sensor.lower() in t.frame.lower()]
    return max(fitting or found, key=lambda topic: topic.count)


def _likeliest(
    topics: Sequence[Topic],
    name: str,
    kind: str,
    notes: list[str],
    findings: list[Finding],
    unsound: Mapping[str, str],
) -> Topic | None:
    """The topic with the most messages, of those that are sound if any is."""
    found = [topic for topic in topics if topic.type == kind and topic.count]
    if not found:
        notes.append(f'{name}: no {kind} messages')
        findings.extend(_by_vendor(topics, name))
        return None
    sound = [topic for topic in found if topic.name not in unsound]
    best = max(sound or found, key=lambda topic: topic.count)
    others = [topic for topic in found if topic is not best]
    passed = {topic.name: unsound[topic.name] for topic in others if topic.name in unsound}
    if sound and passed:
        what = 'IMUs' if kind == IMU else 'receivers'
        findings.append(one_of_several(name, what, best.name, passed, len(found)))
    listed = ', '.join(topic.name for topic in others)
    more = f' has more messages than {listed}' if others and not (sound and passed) else ''
    notes.append(f'{name}: topic {best.name}{more}')
    return best


def _by_vendor(topics: Sequence[Topic], sensor: str) -> list[Finding]:
    """Messages of a sensor that is missing, under types that are not read."""
    if sensor not in STANDARD:
        return []
    standard, makers = STANDARD[sensor]
    return [
        vendor_message(sensor, topic.name, topic.type, makers[topic.type], standard)
        for topic in topics
        if topic.count and topic.type in makers
    ]


def _maker(topic: Topic, sensor: str) -> str:
    """What makes messages that are read of a topic's; '' where nobody is known."""
    maker = made_by(sensor).get(topic.type)
    return '' if maker is None else f'; {maker} makes that of it'


def _name_clouds(clouds: Sequence[Topic]) -> dict[str, Topic]:
    """Names that tell the LiDARs apart: ``/left/points`` is left, ``/points_left`` points_left."""
    names = {}
    framed = {
        topic.frame.strip('/').replace('/', '_') or 'lidar': topic
        for topic in clouds
        if isinstance(topic, FrameTopic)
    }
    clouds = [topic for topic in clouds if not isinstance(topic, FrameTopic)]
    for topic in clouds:
        parts = topic.name.strip('/').split('/')
        generic = len(parts) > 1 and any(word in parts[-1].lower() for word in ('point', 'cloud'))
        names[topic.name] = parts[-2] if generic else parts[-1]
    taken = list(names.values())
    return {
        names[t.name] if taken.count(names[t.name]) == 1 else t.name.strip('/').replace('/', '_'): t
        for t in clouds
    } | framed
