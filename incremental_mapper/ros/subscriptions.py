"""Subscriptions: every callback converts, checks and hands on, nothing more."""

import time
from collections import Counter
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node
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
from incremental_mapper.errors import ConfigError, MeasurementError
from incremental_mapper.measurements import NANOSECONDS, Drops, Measurement
from incremental_mapper.ros.arrivals import Arrived
from incremental_mapper.ros.clock_log import ClockLog
from incremental_mapper.ros.lag import Lag
from incremental_mapper.ros.reception import Losses, Reception, stray_overrides

IMU, GNSS = 'imu', 'gnss'
MOST_LAYOUTS = 5
"""Layouts of a LiDAR's clouds that are told of."""


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
    """A sensor's stream and how it is received."""

    name: str
    stream: _Stream
    reception: Reception


class Inputs:
    """All subscriptions of a node; used in the executor's thread only, ``drops`` apart.

    ``hand_on`` takes the measurements, each with the frame_id of its message, in the order in
    which the messages reached the middleware, and with the stamps and numbers of their messages:
    the worker puts them right. While ``paused`` they are counted and left out.
    ``heard`` is when the newest message of each sensor was taken, seconds on the steady clock;
    ``examples`` says what was wrong with the first of each sensor and reason.
    """

    def __init__(
        self, node: Node, config: Config, hand_on: Callable[[Measurement, str], None]
    ) -> None:
        self.paused = False
        self.received: Counter[str] = Counter()
        self.heard: dict[str, float] = {}
        self.examples: dict[tuple[str, str], str] = {}
        self.topics: dict[str, str] = {}
        self.types: dict[str, str] = {}
        self._node = node
        self._logger = node.get_logger()
        self._hand_on = hand_on
        self._drops: Drops = Counter()
        self._newest: dict[str, int] = {}
        self._fields: dict[str, set[tuple[tuple[str, int], ...]]] = {}
        self._counted: Counter[str] = Counter()
        self._since = time.monotonic()
        self.moment = 0.0
        """When the middleware received what is handed on, seconds of the system's clock."""
        self.lag = Lag()
        self._offsets: dict[str, int] = {}
        sensors = {**config.lidars, IMU: config.imu, GNSS: config.gnss}
        self._clocks = ClockLog(tuple(name for name, item in sensors.items() if item.time_offset))
        self._subscribed: list[_Subscribed] = []
        try:
            for name, lidar in config.lidars.items():
                self._subscribe(name, lidar, f'points_{name}', CLOUDS)
            self._subscribe(IMU, config.imu, 'imu', SAMPLES)
            self._subscribe(GNSS, config.gnss, 'fix', FIXES)
        except ConfigError:
            self.close()
            raise
        overrides = node.get_parameters_by_prefix('qos_overrides')
        for stray in stray_overrides(overrides, set(self.topics.values())):
            self._logger.warning(
                f'nothing goes by {stray}: inputs are {", ".join(self.topics.values())}, with '
                'history, depth, reliability and durability'
            )
        self.restart(config)

    def drops(self) -> Drops:
        """What could not be used, by sensor and reason; any thread may ask."""
        # Copying a dictionary is one step under the interpreter's lock.
        return Counter(dict(self._drops))

    def look(self) -> None:
        """See who publishes; to be called a few times a second."""
        for place in self._subscribed:
            place.reception.look()

    def close(self) -> None:
        """To be called before the node is destroyed."""
        for place in self._subscribed:
            place.reception.close()

    def losses(self) -> dict[str, Losses]:
        """What was sent and never taken, by sensor."""
        return {place.name: place.reception.losses() for place in self._subscribed}

    def reliabilities(self) -> dict[str, str]:
        """How each sensor's topic is received, in a word."""
        return {place.name: place.reception.reliability for place in self._subscribed}

    def of_transport(self) -> tuple[Finding, ...]:
        """What is wrong with how the sensors' messages come here."""
        return tuple(
            found for place in self._subscribed for found in place.reception.findings(place.name)
        )

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

    def findings(self, followed: Collection[str] = ()) -> tuple[Finding, ...]:
        """What the sensors' clocks show against the times of receipt since the last call.

        Args:
            followed: sensors whose clocks stepped and are put right already.
        """
        return self._clocks.findings(self._offsets, followed)

    def restart(self, config: Config) -> None:
        """Forget the stamps of the map before; ``config`` are the settings of the new one."""
        self._newest = {}
        self._clocks.restart()
        sensors = {**config.lidars, IMU: config.imu, GNSS: config.gnss}
        self._offsets = {name: offset_nanoseconds(sensor) for name, sensor in sensors.items()}

    def _subscribe(self, name: str, sensor: Sensor, topic: str, stream: _Stream) -> None:
        reception = Reception(
            self._node, stream.kind, sensor.topic or topic, stream.depth, self._take_in
        )
        self._subscribed.append(_Subscribed(name, stream, reception))
        self.topics[name] = reception.topic
        self.types[name] = f'sensor_msgs/msg/{stream.kind.__name__}'

    def _look_at_fields(self, name: str, message: Any) -> None:
        """Tell what a LiDAR's clouds hold, at the first one and where that changes."""
        fields = tuple((field.name, field.datatype) for field in message.fields)
        known = self._fields.setdefault(name, set())
        if name not in self._newest:
            topic = self.topics[name]
            self._logger.info(f'{name}: first message on {topic}: {describe_times(message)}')
        elif fields not in known and len(known) < MOST_LAYOUTS:
            names = ', '.join(word for word, _ in fields)
            self._logger.warning(
                f'{name}: clouds with other fields than before ({names}): {describe_times(message)}'
            )
        if len(known) < MOST_LAYOUTS:
            known.add(fields)

    def _take_in(self) -> None:
        """Take in all messages that wait, on every topic.

        The executor brings one message a round, and a round costs more than a message: what waits
        is taken at once, before the middleware overwrites it. Topic by topic it would be out of
        order by as long as this thread was kept from running.
        """
        batch: list[tuple[_Subscribed, Arrived]] = [
            (place, arrived) for place in self._subscribed for arrived in place.reception.take()
        ]
        # Middleware that does not know when it received leaves the order as it is.
        batch.sort(key=lambda item: item[1].about.get('received_timestamp') or 0)
        for place, arrived in batch:
            self._on_message(place, arrived.message, arrived.received)

    def _on_message(self, place: _Subscribed, message: Any, received: int) -> None:
        name = place.name
        self.received[name] += 1
        self.heard[name] = time.monotonic()
        if self.paused:
            self._drops[name, 'paused'] += 1
            return
        try:
            measurement = place.stream.make(message, name)
        except MeasurementError as error:
            self.examples.setdefault((name, error.reason), str(error))
            self._drops[name, error.reason] += 1
            return
        if isinstance(message, PointCloud2):
            self._look_at_fields(name, message)
        elif name not in self._newest:
            self._logger.info(f'{name}: first message on {self.topics[name]}')
        self._newest[name] = max(measurement.stamp, self._newest.get(name, 0))
        self._clocks.take(name, measurement.stamp, received)
        self.moment = received / NANOSECONDS
        if name != IMU:
            self.lag.took(measurement.stamp + self._offsets.get(name, 0), self.moment)
        self._hand_on(measurement, str(message.header.frame_id))
