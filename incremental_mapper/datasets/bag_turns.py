"""The order of a bag's messages, and messages whose stamps are out of it."""

import heapq
import struct
from collections.abc import Collection, Iterator, Mapping
from typing import Any

from rosbags.interfaces import Connection

from incremental_mapper.datasets.bag_recovery import BagReader, is_ros1
from incremental_mapper.datasets.headers import peek_header
from incremental_mapper.datasets.stray_stamps import StrayStamps


class Turns:
    """What is known of when the messages of a bag's sensors were recorded."""

    def __init__(
        self,
        sensors: Mapping[str, Mapping[str | None, str]],
        lags: Mapping[str, int],
        restamped: Collection[str],
        shifts: Mapping[str, int],
    ) -> None:
        """Gather what the clocks told.

        Args:
            sensors: Of each topic its sensors by frame; None stands for any frame.
            lags: Usual nanoseconds from stamp to record time, of the sensors where it is known.
            restamped: Sensors whose messages have no stamps of their own.
            shifts: Nanoseconds that are added to the record times of sensors, for their turn.
        """
        self._sensors, self._lags, self._shifts = sensors, lags, shifts
        self.restamped = {
            topic for topic, names in sensors.items() if set(restamped).issuperset(names.values())
        }
        """Topics whose record times stand in for the stamps."""

    def strays(self) -> StrayStamps:
        """What ``stray`` asks, for one reading of the bag."""
        return StrayStamps(self._lags)

    def stray(
        self, strays: StrayStamps, connection: Connection, logged: int, data: bytes
    ) -> str | None:
        """Whose message this is, if its stamp is far from where its sensor's stamps are."""
        sensors = self._sensors[connection.topic]
        if connection.topic in self.restamped or self._lags.keys().isdisjoint(sensors.values()):
            return None
        try:
            stamp, frame = peek_header(data, is_ros1(connection))
        except (struct.error, UnicodeDecodeError):
            return None
        sensor = sensors.get(None) or sensors.get(frame)
        if sensor is None or stamp == 0:
            return None
        logged -= self._shift(connection.topic)
        return sensor if strays.is_stray(sensor, stamp, logged) else None

    def messages(self, reader: BagReader) -> Iterator[tuple[Any, int, bytes]]:
        """Messages as they were logged, or would have been had all sensors had one clock."""
        shifts: dict[int, list[Any]] = {}
        for connection in reader.connections:
            if connection.topic in self._sensors:
                shifts.setdefault(self._shift(connection.topic), []).append(connection)
        parts = [
            _shifted(reader.messages(connections=connections), shift)
            for shift, connections in shifts.items()
        ]
        return parts[0] if len(parts) == 1 else heapq.merge(*parts, key=lambda item: item[1])

    def _shift(self, topic: str) -> int:
        """Nanoseconds that are added to a topic's record times, so that it takes its turn."""
        names = self._sensors[topic].values()
        return max((self._shifts.get(name, 0) for name in names), key=abs)


def _shifted(
    messages: Iterator[tuple[Any, int, bytes]], shift: int
) -> Iterator[tuple[Any, int, bytes]]:
    """Messages with their record times moved (ns)."""
    for connection, logged, data in messages:
        yield connection, logged + shift, data
