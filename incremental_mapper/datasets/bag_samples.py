"""A sample of a bag's messages, found by time, so that the rest of the bag is not read."""

import struct
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from incremental_mapper.datasets.bag_recovery import BagReader
from incremental_mapper.datasets.message_conversion import header_stamp
from incremental_mapper.datasets.record_times import record_times
from incremental_mapper.datasets.sampling import (
    SampleMaker,
    SamplePlan,
    SensorKind,
    SensorSample,
    Stamps,
    clouds_of_each,
    spans,
    spread,
)
from incremental_mapper.errors import MeasurementError
from incremental_mapper.measurements import NANOSECONDS, Measurement


def sample_bag(
    reader: BagReader,
    plan: SamplePlan,
    facts: Mapping[str, Mapping[str, Any]],
    sensor_of: Callable[[str, Any], str | None],
    convert: Mapping[str, Callable[[Any], Measurement]],
    offsets: Mapping[str, int],
) -> tuple[SensorSample, ...]:
    """Read a sample of the sensors' messages.

    Args:
        reader: an open bag.
        plan: how much.
        facts: ``kind``, ``count``, ``topic``, ``frame`` and ``origin`` of each sensor.
        sensor_of: tells whose a message is by topic and message.
        convert: makes a measurement of a message, by sensor.
        offsets: nanoseconds that are added to the stamps, by sensor.

    Returns:
        A sample of each sensor, in the order of ``facts``.
    """
    topics = {str(one['topic']) for one in facts.values()}
    recorded = record_times(reader, topics)
    fixes = [str(one['topic']) for one in facts.values() if one['kind'] is SensorKind.GNSS]
    anchors = recorded.get(fixes[0]) if fixes else None
    bounds = spans(reader.start_time, reader.end_time, plan, anchors)
    clouds = clouds_of_each(bounds, plan)
    makers = {
        name: SampleMaker(clouds, **_facts(name, one, recorded)) for name, one in facts.items()
    }
    alone = {
        str(one['topic']): name
        for name, one in facts.items()
        if one['kind'] is SensorKind.LIDAR and 'recorded' in _facts(name, one, recorded)
    }

    def take(block: int, topic: str, kind: str, received: int, data: bytes) -> None:
        lidar = alone.get(topic)
        if lidar is not None and not makers[lidar].wants(block):
            stamp = _stamp(data, reader.is2)
            if stamp is not None:
                makers[lidar].add(block, received, stamp + offsets[lidar], _never)
            return
        try:
            # On damaged data the decoder raises whatever it stumbles over.
            message: Any = reader.deserialize(data, kind)
            sensor = sensor_of(topic, message)
        except Exception:
            return
        if sensor is None:
            return
        try:
            stamp = header_stamp(message) + offsets[sensor]
        except MeasurementError as error:
            makers[sensor].drop(error.reason)
            return
        names = [str(item.name) for item in getattr(message, 'fields', ())]
        makers[sensor].add(block, received, stamp, lambda: convert[sensor](message), names)

    for block, (start, stop) in enumerate(bounds):
        for message in _messages(reader, topics, start, stop):
            take(block, *message)
    if anchors is not None and plan.fixes:
        inside = np.zeros(len(anchors), dtype=bool)
        for start, stop in bounds:
            inside |= (anchors >= start) & (anchors < stop)
        for number, time in enumerate(spread(anchors[~inside], plan.fixes)):
            for message in _messages(reader, {fixes[0]}, time, time + 1):
                take(len(bounds) + number, *message)
    return tuple(maker.sample() for maker in makers.values())


def read_span(reader: BagReader, topic: str, start: int, stop: int) -> Iterator[Any]:
    """Read the messages of a topic that were recorded from ``start`` until ``stop``, ns."""
    for _, kind, _, data in _messages(reader, {topic}, start, stop):
        try:
            # On damaged data the decoder raises whatever it stumbles over.
            message = reader.deserialize(data, kind)
        except Exception:
            continue
        yield message


def _facts(name: str, facts: Mapping[str, Any], recorded: Mapping[str, Stamps]) -> dict[str, Any]:
    found = {'sensor': name, 'logged': True, **facts}
    times = recorded.get(str(facts['topic']))
    # Of a topic that several LiDARs share nothing tells whose a time is.
    if times is not None and len(times) == facts['count']:
        found['recorded'] = times
    return found


def _messages(
    reader: BagReader, topics: set[str], start: int, stop: int
) -> Iterator[tuple[str, str, int, bytes]]:
    """(topic, type, time of recording, data) of a span, as far as it can be read."""
    connections = [c for c in reader.connections if c.topic in topics]
    if not connections:
        return
    messages = reader.messages(connections=connections, start=start, stop=stop)
    while True:
        # Damage is told of when the whole bag is read.
        try:
            connection, received, data = next(messages)
        except StopIteration:
            return
        except Exception:
            return
        yield str(connection.topic), str(connection.msgtype), int(received), data


def _stamp(data: bytes, is2: bool) -> int | None:
    """The header stamp of a message that begins with a header; to decode a cloud costs more."""
    order, start = ('<' if not is2 or data[1] & 1 else '>'), 4
    try:
        seconds, nanoseconds = struct.unpack_from(order + 'iI', data, start)
    except struct.error:
        return None
    stamp = int(seconds) * NANOSECONDS + int(nanoseconds)
    return stamp if stamp > 0 else None


def _never() -> Measurement:
    raise AssertionError('a cloud of which only the time is wanted')
