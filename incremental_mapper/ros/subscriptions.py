"""Subscriptions: every callback converts, checks and hands on, nothing more."""

import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu, NavSatFix, PointCloud2

from incremental_mapper.checks.finding import Finding
from incremental_mapper.config import Config, Sensor
from incremental_mapper.datasets.message_conversion import (
    describe_times,
    fix_from_message,
    imu_from_message,
    scan_from_message,
)
from incremental_mapper.datasets.sensor_settings import offset_nanoseconds
from incremental_mapper.errors import MeasurementError
from incremental_mapper.measurements import NANOSECONDS, Drops, Measurement
from incremental_mapper.ros.clock_log import ClockLog

IMU, GNSS = 'imu', 'gnss'


@dataclass(frozen=True, slots=True)
class _Stream:
    """A kind of message, what makes measurements of it, and how many may wait."""

    kind: type
    make: Callable[[Any, str], Measurement]
    depth: int


CLOUDS = _Stream(PointCloud2, scan_from_message, 100)
SAMPLES = _Stream(Imu, imu_from_message, 2000)
FIXES = _Stream(NavSatFix, fix_from_message, 50)


@dataclass(frozen=True, slots=True, eq=False)
class _Subscribed:
    """A sensor's stream and its subscription."""

    name: str
    stream: _Stream
    subscription: Any


Arrived: TypeAlias = tuple[_Subscribed, Any, Mapping[str, Any]]
"""A message, where it came in, and what the middleware knows of it."""


class Inputs:
    """All subscriptions of a node; used in the executor's thread only, ``drops`` apart.

    ``hand_on`` takes the measurements, each with the frame_id of its message, in the order in
    which the messages reached the middleware, and with the stamps and numbers of their messages:
    the worker puts them right. While ``paused`` they are counted and left out. ``lost`` counts
    what the middleware lost on the way, by the gaps in the numbers that a topic's publisher gives
    its messages.
    """

    def __init__(
        self, node: Node, config: Config, hand_on: Callable[[Measurement, str], None]
    ) -> None:
        self.paused = False
        self.received: Counter[str] = Counter()
        self.lost: Counter[str] = Counter()
        self.topics: dict[str, str] = {}
        self.types: dict[str, str] = {}
        self._node = node
        self._logger = node.get_logger()
        self._hand_on = hand_on
        self._drops: Drops = Counter()
        self._newest: dict[str, int] = {}
        self._numbers: dict[str, int] = {}
        self._counted: Counter[str] = Counter()
        self._since = time.monotonic()
        self._offsets: dict[str, int] = {}
        sensors = {**config.lidars, IMU: config.imu, GNSS: config.gnss}
        self._clocks = ClockLog(tuple(name for name, item in sensors.items() if item.time_offset))
        self._subscribed: list[_Subscribed] = []
        for name, lidar in config.lidars.items():
            self._subscribe(name, lidar, f'points_{name}', CLOUDS)
        self._subscribe(IMU, config.imu, 'imu', SAMPLES)
        self._subscribe(GNSS, config.gnss, 'fix', FIXES)
        self.restart(config)

    def drops(self) -> Drops:
        """What could not be used, by sensor and reason; any thread may ask."""
        # Copying a dictionary is one step under the interpreter's lock.
        return Counter(dict(self._drops))

    def rates(self) -> dict[str, float]:
        """Messages a second of every sensor since the last call."""
        now = time.monotonic()
        passed, self._since = now - self._since, now
        before, self._counted = self._counted, self.received.copy()
        return {
            name: (self.received[name] - before[name]) / passed if passed > 0 else 0.0
            for name in self.topics
        }

    def lateness(self) -> dict[str, float]:
        """Seconds by which each sensor's newest stamp is behind the newest of all."""
        stamps = {name: stamp + self._offsets[name] for name, stamp in self._newest.items()}
        newest = max(stamps.values(), default=0)
        return {name: (newest - stamp) / NANOSECONDS for name, stamp in stamps.items()}

    def findings(self) -> tuple[Finding, ...]:
        """What the sensors' clocks show against the times of receipt since the last call."""
        return self._clocks.findings(self._offsets)

    def restart(self, config: Config) -> None:
        """Forget the stamps of the map before; ``config`` are the settings of the new one."""
        self._newest = {}
        self._clocks.restart()
        sensors = {**config.lidars, IMU: config.imu, GNSS: config.gnss}
        self._offsets = {name: offset_nanoseconds(sensor) for name, sensor in sensors.items()}

    def _subscribe(self, name: str, sensor: Sensor, topic: str, stream: _Stream) -> None:
        # Best effort takes messages of reliable and of best-effort publishers.
        qos = QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=stream.depth,
            reliability=ReliabilityPolicy.BEST_EFFORT,
        )

        def on_message(message: Any, about: Mapping[str, Any]) -> None:
            self._take_in((place, message, about))

        # Every event that the executor waits for costs time with every message. No publisher is
        # incompatible with best effort, and losses show in the numbers of the messages.
        events = SubscriptionEventCallbacks(use_default_callbacks=False)
        subscription = self._node.create_subscription(
            stream.kind, sensor.topic or topic, on_message, qos, event_callbacks=events
        )
        place = _Subscribed(name, stream, subscription)
        self._subscribed.append(place)
        self.topics[name] = subscription.topic_name
        self.types[name] = f'sensor_msgs/msg/{stream.kind.__name__}'

    def _take_in(self, first: Arrived) -> None:
        """Take in a message and all that wait behind it, on every topic.

        The executor brings one message a round, and a round costs more than a message: what waits
        is taken at once, before the middleware overwrites it. Topic by topic it would be out of
        order by as long as this thread was kept from running.
        """
        batch = [first]
        for place in self._subscribed:
            handle = place.subscription.handle
            with handle:
                for _ in range(place.stream.depth):
                    waiting = handle.take_message(place.stream.kind, False)
                    if waiting is None:
                        break
                    batch.append((place, *waiting))
        # Middleware that does not know when it received leaves the order as it is.
        batch.sort(key=lambda arrived: arrived[2].get('received_timestamp') or 0)
        for place, message, about in batch:
            self._count_lost(place.name, about.get('publication_sequence_number') or 0)
            self._on_message(place, message, about.get('received_timestamp') or time.time_ns())

    def _count_lost(self, name: str, number: int) -> None:
        """Count what is missing between a message's number and the one before it."""
        before = self._numbers.get(name, number)
        self._numbers[name] = number
        # Several publishers count each for itself, and a new one begins anew.
        if number > before + 1 and self._node.count_publishers(self.topics[name]) == 1:
            self.lost[name] += number - before - 1

    def _on_message(self, place: _Subscribed, message: Any, received: int) -> None:
        name = place.name
        self.received[name] += 1
        if self.paused:
            self._drops[name, 'paused'] += 1
            return
        try:
            measurement = place.stream.make(message, name)
        except MeasurementError as error:
            if (name, error.reason) not in self._drops:
                self._logger.warning(f'{name}: {error} (said once; /diagnostics counts)')
            self._drops[name, error.reason] += 1
            return
        if name not in self._newest:
            said = f': {describe_times(message)}' if isinstance(message, PointCloud2) else ''
            self._logger.info(f'{name}: first message on {self.topics[name]}{said}')
        self._newest[name] = max(measurement.stamp, self._newest.get(name, 0))
        self._clocks.take(name, measurement.stamp, received)
        self._hand_on(measurement, str(message.header.frame_id))
