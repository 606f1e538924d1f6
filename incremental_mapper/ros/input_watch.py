"""Watches what comes in by topic: whose clouds they are, and what was wrong with messages."""

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence

import numpy as np
from rclpy.node import Node

from incremental_mapper.checks.finding import Finding
from incremental_mapper.checks.live_inputs import (
    foreign_frame,
    map_frame,
    nobody_publishes,
    other_type,
)
from incremental_mapper.checks.sweeps import (
    partial_sweeps,
    sector_clouds,
    several_frames,
    take_turns,
    two_lidars_one_frame,
)
from incremental_mapper.config import LidarSensor
from incremental_mapper.datasets.first_look import LOOKED_AT
from incremental_mapper.datasets.one_frame import FOREIGN, FrameNames, OneFrame
from incremental_mapper.datasets.remarks import Remarks
from incremental_mapper.datasets.topics import MAP_FRAMES
from incremental_mapper.datasets.vendor_types import made_by
from incremental_mapper.measurements import NANOSECONDS, Drops, LidarScan, Measurement, Points

RENAMED = 2 * NANOSECONDS
"""Nanoseconds without a cloud of a LiDAR's own frame_id after which another one is its new name."""
LOOKS = 3
"""Looks at the topics, one a period of the diagnostics, that show the same before it is said."""


class InputWatch:
    """Gathers what the messages of all topics show; used in the executor's thread.

    A topic's clouds of one frame_id belong to one LiDAR: where several LiDARs have the topic, to
    the one whose name the frame_id contains, else in the order of the settings.
    """

    def __init__(self, topics: Mapping[str, str], lidars: Mapping[str, LidarSensor]) -> None:
        """``topics`` are the full names by sensor, ``lidars`` the settings of the LiDARs."""
        self._cloud_drops: Drops = Counter()
        self._others = OneFrame()
        self._names = FrameNames()
        self._topics = topics
        self._lidars = dict(lidars)
        self._owners: dict[str, dict[str, str | None]] = defaultdict(dict)
        self._counts: dict[str, Counter[str]] = defaultdict(Counter)
        self._newest: dict[str, int] = {}
        self._remarks = Remarks()
        self._clouds: dict[str, list[Points]] = {}
        self._looked: dict[str, set[int]] = defaultdict(set)  # their stamps
        self._alternating: dict[str, Finding] = {}
        self._sectors: list[Finding] = []
        self._heard: set[str] = set()
        self._looks: Counter[Finding] = Counter()
        self._unpublished: tuple[Finding, ...] = ()

    def take(self, measurement: Measurement, frame: str) -> bool:
        """Look at a measurement.

        Args:
            measurement: What a message became.
            frame: Its frame_id.

        Returns:
            Whether it is the sensor's; those of another one on its topic are not.
        """
        self._heard.add(measurement.sensor)
        if isinstance(measurement, LidarScan):
            owner = self._owner(measurement, frame)
            if owner != measurement.sensor:
                if owner is None:
                    self._cloud_drops[measurement.sensor, FOREIGN] += 1
                return False
            self._look_at_cloud(measurement, frame)
        elif not self._others.take(measurement.sensor, frame, measurement.stamp):
            return False
        self._remarks.take(measurement)
        return True

    @property
    def drops(self) -> Drops:
        """What was left out, by sensor and reason."""
        return Counter(dict(self._cloud_drops)) + Counter(dict(self._others.drops))

    @property
    def silent(self) -> list[str]:
        """Sensors that have sent nothing yet."""
        return [sensor for sensor in self._topics if sensor not in self._heard]

    def look_at_topics(
        self,
        wanted: Mapping[str, str],
        keys: Mapping[str, str],
        published: Mapping[str, Sequence[str]],
    ) -> None:
        """Look at what is published, where a sensor has sent nothing yet.

        Args:
            wanted: Type of each sensor's messages.
            keys: The settings that name the sensors' topics.
            published: Types by topic that others than this node publish.
        """
        found: list[Finding] = []
        ours = set(self._topics.values())
        for sensor in self.silent:
            topic, kind = self._topics[sensor], wanted[sensor]
            types = published.get(topic, ())
            if types and kind not in types:
                found.append(other_type(sensor, topic, types, kind))
            if types:
                continue
            others = [name for name, kinds in published.items() if kind in kinds]
            makers = made_by(sensor)
            converters = {
                name: makers[vendor]
                for name, kinds in published.items()
                for vendor in kinds
                if vendor in makers and name not in ours
            }
            others = sorted({*others} - ours)
            standard = kind.rsplit('/', 1)[-1]
            found += nobody_publishes(sensor, keys[sensor], topic, others, converters, standard)
        # Publishers are discovered one after the other.
        self._looks = Counter({item: self._looks[item] + 1 for item in found})
        self._unpublished = tuple(item for item in found if self._looks[item] >= LOOKS)

    def findings(self, keys: Mapping[str, str]) -> tuple[Finding, ...]:
        """What is wrong by now.

        Args:
            keys: The settings that name the sensors' topics.
        """
        return (
            *self._of_frames(keys),
            *self._alternating.values(),
            *self._others.findings(),
            *self._remarks.findings(),
            *self._unpublished,
        )

    def mended(self) -> tuple[Finding, ...]:
        """What was found since the last call that settings put right."""
        found, self._sectors = tuple(self._sectors), []
        return found

    def _owner(self, scan: LidarScan, frame: str) -> str | None:
        """Whose clouds of this frame_id on the sensor's topic are."""
        topic = self._topics[scan.sensor]
        frame = self._names.name(topic, frame)
        owners = self._owners[topic]
        if frame not in owners:
            free = [
                name
                for name in self._lidars
                if self._topics[name] == topic and name not in owners.values()
            ]
            named = [name for name in free if name.lower() in frame.lower()]
            owners[frame] = next(iter(named or free), None)
        owner: str | None = owners[frame]
        if owner is None and scan.stamp - self._newest.get(scan.sensor, 0) > RENAMED:
            owner = scan.sensor
            others = {name: by for name, by in owners.items() if by not in (owner, None)}
            self._owners[topic] = {**others, frame: owner}
        if owner in (None, scan.sensor):
            self._counts[topic][frame] += 1
        if owner == scan.sensor:
            self._newest[scan.sensor] = max(scan.stamp, self._newest.get(scan.sensor, 0))
        return owner

    def _of_frames(self, keys: Mapping[str, str]) -> list[Finding]:
        found = []
        for topic, owners in self._owners.items():
            counts = self._counts[topic]
            own = {by: frame for frame, by in owners.items() if by is not None}
            if len(own) > 1:
                found.append(
                    several_frames(topic, {frame: counts[frame] for frame in own.values()})
                )
            for lidar, frame in own.items():
                if frame.lstrip('/') in MAP_FRAMES:
                    found.append(map_frame(lidar, keys[lidar], topic, frame))
            strangers = [frame for frame, by in owners.items() if by is None and counts[frame]]
            first = next(iter(own), None)
            if first is not None:
                found += [
                    foreign_frame(first, topic, own[first], frame, counts[frame])
                    for frame in strangers
                ]
        return found

    def _look_at_cloud(self, scan: LidarScan, frame: str) -> None:
        """Gather a LiDAR's first clouds, and see whether two take turns under one frame_id."""
        clouds = self._clouds.setdefault(scan.sensor, [])
        if len(clouds) >= LOOKED_AT or scan.stamp in self._looked[scan.sensor]:
            return  # of two with one stamp one is left out: the map is not of both
        self._looked[scan.sensor].add(scan.stamp)
        clouds.append(scan.points)
        if len(clouds) < LOOKED_AT:
            return
        topic = self._topics[scan.sensor]
        share = partial_sweeps(clouds)
        if share is not None and not self._lidars[scan.sensor].sectors:
            self._sectors.append(sector_clouds(scan.sensor, topic, share))
        if take_turns(clouds):
            self._alternating[scan.sensor] = two_lidars_one_frame(scan.sensor, topic, frame)
        self._clouds[scan.sensor] = [np.zeros((0, 3), dtype=np.float32)] * LOOKED_AT


def published_by_others(node: Node) -> dict[str, list[str]]:
    """Types by topic of what other nodes publish."""
    own = node.get_name(), node.get_namespace()
    found: dict[str, list[str]] = {}
    for name, types in node.get_topic_names_and_types():
        by = node.get_publishers_info_by_topic(name)
        if any((it.node_name, it.node_namespace) != own for it in by):
            found[name] = list(types)
    return found
