"""Subscriptions: every callback converts, checks and hands on, nothing more."""

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu, NavSatFix, PointCloud2

from incremental_mapper.config import Config, Sensor
from incremental_mapper.datasets.messages import (
    describe_times,
    fix_from_message,
    imu_from_message,
    scan_from_message,
)
from incremental_mapper.datasets.selection import offset_nanoseconds
from incremental_mapper.errors import MeasurementError
from incremental_mapper.measurements import Drops, Measurement
from incremental_mapper.trajectory import NANOSECONDS

IMU, GNSS = 'imu', 'gnss'


@dataclass(frozen=True, slots=True)
class _Stream:
    """A kind of message, what makes measurements of it, and how many may wait."""

    kind: type
    make: Callable[[Any, str, int], Measurement]
    depth: int


CLOUDS = _Stream(PointCloud2, scan_from_message, 50)
SAMPLES = _Stream(Imu, imu_from_message, 2000)
FIXES = _Stream(NavSatFix, fix_from_message, 50)


class Inputs:
    """All subscriptions of a node; used in the executor's thread only, ``drops`` apart.

    ``hand_on`` takes the measurements; while ``paused`` they are counted and left out.
    """

    def __init__(self, node: Node, config: Config, hand_on: Callable[[Measurement], None]) -> None:
        self.paused = False
        self.received: Counter[str] = Counter()
        self.lost: Counter[str] = Counter()  # by the middleware, before any callback
        self.topics: dict[str, str] = {}
        self._logger = node.get_logger()
        self._hand_on = hand_on
        self._drops: Drops = Counter()
        self._newest: dict[str, int] = {}
        self._counted: Counter[str] = Counter()
        self._since = time.monotonic()
        self._subscriptions = [
            self._subscribe(node, name, lidar, f'points_{name}', CLOUDS)
            for name, lidar in config.lidars.items()
        ]
        self._subscriptions += [
            self._subscribe(node, IMU, config.imu, 'imu', SAMPLES),
            self._subscribe(node, GNSS, config.gnss, 'fix', FIXES),
        ]

    def close(self, node: Node) -> None:
        """Take in nothing more."""
        for subscription in self._subscriptions:
            node.destroy_subscription(subscription)
        self._subscriptions = []

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
        newest = max(self._newest.values(), default=0)
        return {name: (newest - stamp) / NANOSECONDS for name, stamp in self._newest.items()}

    def restart(self) -> None:
        """Forget the stamps of the map before."""
        self._newest = {}

    def _subscribe(self, node: Node, name: str, sensor: Sensor, topic: str, stream: _Stream) -> Any:
        offset = offset_nanoseconds(sensor)
        # Best effort takes messages of reliable and of best-effort publishers.
        qos = QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=stream.depth,
            reliability=ReliabilityPolicy.BEST_EFFORT,
        )

        def take_in(message: Any) -> None:
            self._on_message(name, lambda: stream.make(message, name, offset), message)

        def on_message(message: Any) -> None:
            take_in(message)
            # The executor brings one message a round, and a round costs more than a message.
            # What waits behind it is taken at once, before the middleware overwrites it.
            with subscription.handle:
                for _ in range(stream.depth):
                    waiting = subscription.handle.take_message(stream.kind, False)
                    if waiting is None:
                        break
                    take_in(waiting[0])

        def on_lost(status: Any) -> None:
            self.lost[name] += status.total_count_change

        # No publisher is incompatible with best effort, and every event that the executor waits
        # for costs time with every message, so none but this one.
        events = SubscriptionEventCallbacks(message_lost=on_lost, use_default_callbacks=False)
        subscription = node.create_subscription(
            stream.kind, sensor.topic or topic, on_message, qos, event_callbacks=events
        )
        self.topics[name] = subscription.topic_name
        return subscription

    def _on_message(self, name: str, make: Callable[[], Measurement], message: Any) -> None:
        self.received[name] += 1
        if self.paused:
            self._drops[name, 'paused'] += 1
            return
        try:
            measurement = make()
        except MeasurementError as error:
            if (name, error.reason) not in self._drops:
                self._logger.warning(f'{name}: {error} (said once; /diagnostics counts)')
            self._drops[name, error.reason] += 1
            return
        if name not in self._newest:
            said = f': {describe_times(message)}' if isinstance(message, PointCloud2) else ''
            self._logger.info(f'{name}: first message on {self.topics[name]}{said}')
        self._newest[name] = max(measurement.stamp, self._newest.get(name, 0))
        self._hand_on(measurement)
