"""ROS bags as a source of measurements: rosbag2 (MCAP, SQLite) and ROS 1."""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

from rosbags.interfaces import Connection

from incremental_mapper.checks.cloud_copies import copied_from
from incremental_mapper.checks.live_inputs import map_frame
from incremental_mapper.checks.sweeps import other_frame, sector_clouds, two_lidars_one_frame
from incremental_mapper.checks.usual_lags import usual_lags
from incremental_mapper.datasets.bag_files import Topic, bag_files, open_bag
from incremental_mapper.datasets.bag_recovery import BagReader, is_ros1
from incremental_mapper.datasets.bag_samples import read_span, sample_bag
from incremental_mapper.datasets.bag_settings import (
    SETTINGS_FILE,
    own_settings,
    sector_settings,
    topic_settings,
)
from incremental_mapper.datasets.bag_truth import truth_of_topic
from incremental_mapper.datasets.bag_turns import Turns
from incremental_mapper.datasets.clock_leaps import ClockLeaps, find_leaps
from incremental_mapper.datasets.clock_look import ClockLook, check_clocks
from incremental_mapper.datasets.extrinsics import find_extrinsics
from incremental_mapper.datasets.first_look import (
    TopicLook,
    count_frames,
    frames_of_sensors,
    look_at_clouds,
    look_at_frame,
)
from incremental_mapper.datasets.headers import stamped
from incremental_mapper.datasets.imu_look import look_at_imus
from incremental_mapper.datasets.message_conversion import (
    fix_from_message,
    imu_from_message,
    scan_from_message,
)
from incremental_mapper.datasets.one_frame import OneFrame
from incremental_mapper.datasets.receiver_look import look_at_receivers
from incremental_mapper.datasets.record_times import record_times
from incremental_mapper.datasets.remarks import Remarks
from incremental_mapper.datasets.sampling import SamplePlan, SensorKind, SensorSample
from incremental_mapper.datasets.sectors import NO_POINTS, SectorGatherer
from incremental_mapper.datasets.sensor_settings import extrinsics_of, listed_lidars
from incremental_mapper.datasets.source import SourceInfo
from incremental_mapper.datasets.static_transforms import STATIC_TOPIC, clean
from incremental_mapper.datasets.topics import (
    CLOUDS,
    FIX,
    IMU,
    MAP_FRAMES,
    FrameTopic,
    choose_topics,
    find_truth_topic,
)
from incremental_mapper.datasets.truth import find_truth, truth_file
from incremental_mapper.errors import InputError, MeasurementError
from incremental_mapper.measurements import NANOSECONDS, Drops, LidarScan, Measurement
from incremental_mapper.settings import make_config, merge, read_yaml
from incremental_mapper.trajectory import Trajectory

Maker: TypeAlias = Callable[[Any, str, int], Measurement]
Converter: TypeAlias = Callable[[Any], Measurement]


class BagSource:
    """A bag, opened and checked; messages are decoded one at a time."""

    def __init__(self, path: Path, settings: Mapping[str, Any] | None = None) -> None:
        """Open the bag; ``settings`` is the user's tree (topics, time offsets).

        Raises InputError where the bag or its topics cannot be used, ConfigError for bad settings.
        """
        tree = settings or {}
        self._given = tree
        self._path = path
        self._files = bag_files(path)
        self._folder = path if path.is_dir() else path.parent
        self._drops: Drops = Counter()
        self._remarks = Remarks()
        self._other_frames: Counter[tuple[str, str]] = Counter()
        self._one_frame = OneFrame()
        own = own_settings(self._folder, listed_lidars(tree))
        config = make_config(merge(own, tree))
        self._leaps: ClockLeaps | None = None
        with self._open() as reader:
            self._leaps = reader.leaps = find_leaps(
                reader, record_times(reader, reader.topics), is_ros1
            )
            self._topics = [
                Topic(name, info.msgtype or 'several types', info.msgcount)
                for name, info in reader.topics.items()
            ]
            looks = {
                topic.name: look_at_clouds(reader, topic)
                for topic in self._topics
                if topic.type in CLOUDS and topic.count
            }
            counts = {
                topic.name: look.frames
                if len(look.frames) < 2
                else frames_of_sensors(count_frames(reader, topic))
                for topic in self._topics
                if (look := looks.get(topic.name)) is not None
            }
            imus = [topic for topic in self._topics if topic.type == IMU and topic.count]
            several = len(imus) > 1 and not config.imu.topic
            gravity = config.preintegration.gravity
            unsound = look_at_imus(reader, imus, gravity) if several else {}
            receivers = [topic for topic in self._topics if topic.type == FIX and topic.count]
            if len(receivers) > 1 and not config.gnss.topic:
                unsound |= look_at_receivers(reader, receivers, config.fixes)
            copies = copied_from(
                {
                    name: look.topic()
                    for name, look in looks.items()
                    if len(look.frames) == 1 and not {*map(clean, look.frames)} & {*MAP_FRAMES}
                }
            )
            self._choice = choose_topics(path, self._topics, config, counts, unsound, copies)
            self._frames = {
                name: topic.frame
                if isinstance(topic, FrameTopic)
                else next(iter(counts.get(topic.name, {})), None) or look_at_frame(reader, topic)
                for name, topic in self._choice.topics.items()
            }
            sizes = {
                name: topic.count * looks[topic.name].points.get(self._frames[name], 0.0)
                for name, topic in self._choice.topics.items()
                if name in self._choice.lidars
            }
            extrinsics = find_extrinsics(reader, merge(own, tree), self._frames, sizes)
            self._choice = self._choice.without(extrinsics.left_out)
            self._begin, self._end = reader.start_time, reader.end_time
            lidars = self._looked_at(looks)
            self._sensors: dict[str, dict[str | None, str]] = {}
            for name, topic in self._choice.topics.items():
                frame = topic.frame if isinstance(topic, FrameTopic) else None
                self._sensors.setdefault(topic.name, {})[frame] = name
            clock_look = ClockLook(reader, self._sensors)
            clocks = check_clocks(clock_look.clocks, merge(own, tree), list(self._choice.topics))
            sectors = {
                name: look.partial[frame] for name, frame, look in lidars if frame in look.partial
            }
            notes = [
                *self._choice.notes,
                *extrinsics.notes,
                *(f'LiDAR {name}: {look.times[frame]}' for name, frame, look in lidars),
            ]
            findings = [
                *reader.findings,
                *([] if self._leaps is None else self._leaps.findings()),
                *self._choice.findings,
                *extrinsics.findings,
                *(
                    sector_clouds(name, self._choice.topics[name].name, share)
                    for name, share in sectors.items()
                ),
                *(
                    map_frame(name, f'lidars.{name}.topic', self._choice.topics[name].name, frame)
                    for name, frame, _ in lidars
                    if frame.lstrip('/') in MAP_FRAMES
                ),
                *(
                    two_lidars_one_frame(name, self._choice.topics[name].name, frame)
                    for name, frame, look in lidars
                    if look.alternating
                ),
                *clock_look.findings,
                *clocks.findings,
            ]
        self._offsets, self._apart = clocks.offsets, clocks.apart
        self._turns = Turns(
            self._sensors,
            usual_lags(clock_look.clocks({}, ())),
            clock_look.restamped,
            clock_look.order_shifts(clocks.offsets),
        )
        self._gathered = {name for name, lidar in config.lidars.items() if lidar.sectors}
        self._gathered = (self._gathered | set(sectors)) & set(self._choice.lidars)
        self._messages = {name: topic.count for name, topic in self._choice.topics.items()}
        self._info = SourceInfo(
            path=path,
            kind='ROS 1 bag' if self._files[0].suffix == '.bag' else 'ROS 2 bag',
            counts={
                name: math.ceil(count * sectors.get(name, 1.0))
                for name, count in self._messages.items()
            },
            duration=max(self._end - self._begin, 0) / NANOSECONDS,
            settings=merge(
                merge(
                    merge(own, topic_settings(self._choice, list(config.lidars))),
                    merge(extrinsics.settings, sector_settings(sectors)),
                ),
                clocks.settings,
            ),
            notes=tuple(notes),
            findings=tuple(findings),
        )

    @property
    def info(self) -> SourceInfo:
        """Facts about the bag, with what the last run of ``measurements`` remarked."""
        frames = [
            other_frame(sensor, self._frames[sensor], frame, count, self._lidar_of(frame))
            for (sensor, frame), count in self._other_frames.items()
        ]
        others = self._one_frame.findings()
        findings = (*self._info.findings, *frames, *others, *self._remarks.findings())
        return replace(self._info, findings=findings)

    @property
    def drops(self) -> Drops:
        """Messages that the last run of ``measurements`` could not use."""
        return self._drops + self._one_frame.drops

    def measurements(self) -> Iterator[Measurement]:
        """All usable measurements in the order in which the bag logged them.

        Messages that the bag announces but lost to damage are counted as ``damaged``; InputError
        where not one can be read.
        """
        self._drops = Counter()
        self._remarks = Remarks()
        self._other_frames = Counter()
        self._one_frame = OneFrame()
        converters = self._converters()
        gatherers = {name: SectorGatherer() for name in self._gathered}
        left = Counter(self._messages)
        with self._open() as reader:
            for connection, data in self._raw(reader, left):
                topic = connection.topic
                try:
                    # On damaged data the decoder raises whatever it stumbles over.
                    message = reader.deserialize(data, connection.msgtype)
                except Exception:
                    sensor = next(iter(self._sensors[topic].values()))
                    left[sensor] -= 1
                    self._drops[sensor, 'undecodable'] += 1
                    continue
                found = self._sensor(topic, message)
                if found is None:
                    continue
                sensor = found
                left[sensor] -= 1
                if sensor in self._apart:
                    self._drops[sensor, 'no_common_time'] += 1
                    continue
                sensor = self._by_frame(sensor, message)
                try:
                    measurement = converters[sensor](message)
                except MeasurementError as error:
                    # A sector of the sky has no points, and is no loss.
                    if sensor not in gatherers or error.reason not in NO_POINTS:
                        self._drops[sensor, error.reason] += 1
                    continue
                if isinstance(measurement, LidarScan) and sensor in gatherers:
                    sweep = gatherers[sensor].take(measurement)
                    if sweep is None:
                        continue
                    measurement = sweep
                if not self._is_own(sensor, message, measurement.stamp):
                    continue
                self._remarks.take(measurement)
                yield measurement
        for gatherer in gatherers.values():
            last = gatherer.finish()
            if last is not None:
                self._remarks.take(last)
                yield last

    def sample(self, plan: SamplePlan) -> tuple[SensorSample, ...]:
        """Read a sample of every sensor; the rest of the bag is not read."""
        kinds = {'imu': SensorKind.IMU, 'gnss': SensorKind.GNSS}
        facts = {
            name: {
                'kind': kinds.get(name, SensorKind.LIDAR),
                'count': topic.count,
                'topic': topic.name,
                'frame': self._frames[name],
                'origin': self._origin(name),
            }
            for name, topic in self._choice.topics.items()
        }
        with self._open() as reader:
            return sample_bag(reader, plan, facts, self._sensor, self._converters(), self._offsets)

    def scans(
        self, sensor: str, bounds: Sequence[tuple[int, int]]
    ) -> Iterator[tuple[int, LidarScan]]:
        """See ``Sampled``."""
        convert = self._converters()[sensor]
        topic = self._choice.topics[sensor].name
        with self._open() as reader:
            for number, (start, stop) in enumerate(bounds):
                gatherer = SectorGatherer() if sensor in self._gathered else None
                for message in read_span(reader, topic, start, stop):
                    try:
                        if self._sensor(topic, message) != sensor:
                            continue
                        scan = convert(message)
                        assert isinstance(scan, LidarScan)
                        sweep = scan if gatherer is None else gatherer.take(scan)
                    except (MeasurementError, AttributeError):
                        continue
                    if sweep is not None:
                        yield number, sweep

    def _origin(self, name: str) -> str:
        """Where a sensor's extrinsics come from, in words."""
        if extrinsics_of(self._given, name, self._choice.lidars) is not None:
            return 'the settings'
        if extrinsics_of(self._info.settings, name, self._choice.lidars) is None:
            return 'nowhere: identity'
        beside = (self._folder / SETTINGS_FILE).is_file()
        own = read_yaml(self._folder / SETTINGS_FILE) if beside else {}
        known = extrinsics_of(own, name, self._choice.lidars) is not None
        return SETTINGS_FILE if known else STATIC_TOPIC

    def truth(self) -> Trajectory | None:
        """Truth from an odometry topic with ``truth`` in its name, else from a file beside."""
        topic = find_truth_topic(self._topics)
        if topic is not None:
            with self._open() as reader:
                return truth_of_topic(reader, topic)
        truth = find_truth(self._truth_folders())
        # A file in the folder above may belong to another drive.
        if truth is None or truth.stamps[-1] < self._begin or truth.stamps[0] > self._end:
            return None
        return truth

    def truth_place(self) -> str:
        """See ``Sampled``; a file in the folder above may turn out to be another drive's."""
        topic = find_truth_topic(self._topics)
        path = truth_file(self._truth_folders())
        return topic or ('' if path is None else path.name)

    def _truth_folders(self) -> list[Path]:
        return [self._folder, self._path.parent] if self._path.is_dir() else [self._folder]

    def _sensor(self, topic: str, message: Any) -> str | None:
        """Whose message it is; None where it has a frame of a topic's that no LiDAR has."""
        by_frame = self._sensors[topic]
        if None in by_frame:
            return by_frame[None]
        return by_frame.get(str(message.header.frame_id))

    def _by_frame(self, sensor: str, message: Any) -> str:
        """Whose cloud it is by its frame, which is noted where it is not that of the first ones."""
        if sensor not in self._choice.lidars:
            return sensor
        frame = str(message.header.frame_id)
        if frame == self._frames[sensor]:
            return sensor
        self._other_frames[sensor, frame] += 1
        return self._lidar_of(frame) or sensor

    def _is_own(self, sensor: str, message: Any, stamp: int) -> bool:
        """Whether a fix or a sample is the sensor's, and of no second one on its topic."""
        if sensor in self._choice.lidars:
            return True
        return self._one_frame.take(sensor, str(message.header.frame_id), stamp)

    def _lidar_of(self, frame: str) -> str:
        """The one LiDAR whose first clouds had this frame; '' where there is none."""
        owners = [name for name in self._choice.lidars if self._frames[name] == frame]
        return owners[0] if frame and len(owners) == 1 else ''

    def _looked_at(self, looks: Mapping[str, TopicLook]) -> list[tuple[str, str, TopicLook]]:
        """(LiDAR, frame, look) of those whose points' times are known."""
        return [
            (name, self._frames[name], look)
            for name in self._choice.lidars
            if (look := looks.get(self._choice.topics[name].name)) is not None
            and self._frames[name] in look.times
        ]

    @contextmanager
    def _open(self) -> Iterator[BagReader]:
        reader = open_bag(self._path)
        reader.leaps = self._leaps
        try:
            yield reader
        finally:
            reader.close()

    def _raw(self, reader: BagReader, left: Counter[str]) -> Iterator[tuple[Connection, bytes]]:
        """(connection, data) of the sensors' messages; counts those that the bag lost.

        ``left`` is how many messages of each sensor are still to come.
        """
        messages = self._turns.messages(reader)
        strays = self._turns.strays()
        while True:
            try:
                connection, logged, data = next(messages)
            except StopIteration:
                break
            # On a damaged chunk the reader raises whatever it stumbles over, or skips it.
            except Exception as error:
                if left == Counter(self._messages):
                    reason = ' '.join(str(error).split()) or type(error).__name__
                    raise InputError(f'{self._path}: no message can be read ({reason})') from error
                break
            if connection.topic in self._turns.restamped:
                data = stamped(data, logged, is_ros1(connection))
            stray = self._turns.stray(strays, connection, logged, data)
            if stray is None:
                yield connection, data
            else:
                left[stray] -= 1
                self._drops[stray, 'stamp_leap'] += 1
        self._drops.update({(name, 'damaged'): n for name, n in left.items() if n > 0})

    def _converters(self) -> dict[str, Converter]:
        makers: dict[str, Maker] = {'imu': imu_from_message, 'gnss': fix_from_message}
        makers |= dict.fromkeys(self._choice.lidars, scan_from_message)

        def bind(sensor: str) -> Converter:
            return lambda message: makers[sensor](message, sensor, self._offsets[sensor])

        return {sensor: bind(sensor) for sensor in self._choice.topics}
