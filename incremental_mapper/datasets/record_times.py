"""When each message of a bag was recorded, from the bag's index alone."""

from collections.abc import Collection, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from incremental_mapper.datasets.bag_recovery import BagReader

Stamps = NDArray[np.int64]

_INDEX_HEAD = 15
"""Bytes of an MCAP message index before its entries: opcode, length, channel, their length."""
_INDEX_ENTRY = 16


def record_times(reader: BagReader, topics: Collection[str]) -> dict[str, Stamps]:
    """Read when the messages of some topics were recorded; no message is read.

    Args:
        reader: an open bag.
        topics: their names.

    Returns:
        Nanoseconds, ascending, by topic; a topic is missing where the bag has no index of it.
    """
    found: dict[str, list[Stamps]] = {}
    for part in _parts(reader):
        for topic, stamps in _of_part(part, set(topics)):
            found.setdefault(topic, []).append(stamps)
    times = {topic: np.sort(np.concatenate(parts)) for topic, parts in found.items()}
    leaps = reader.leaps
    return times if leaps is None else {t: leaps.recorded(own) for t, own in times.items()}


def _parts(reader: BagReader) -> Iterator[Any]:
    """The files of a bag, as the bag library reads each."""
    for owner in reader.readers:
        storage = getattr(owner, 'storage', owner)
        yield from storage.storages if isinstance(storage, DirectoryReader) else [storage]


def _of_part(part: Any, topics: set[str]) -> Iterator[tuple[str, Stamps]]:
    wanted = {c.id: str(c.topic) for c in part.connections if c.topic in topics}
    if isinstance(part, Reader1):
        for number, topic in wanted.items():
            yield topic, np.array([entry.time for entry in part.indexes[number]], dtype=np.int64)
    elif isinstance(part, McapReader):
        yield from _of_mcap(part, wanted)
    elif isinstance(part, Sqlite3Reader) and part.dbconn is not None:
        for number, topic in wanted.items():
            query = 'SELECT timestamp FROM messages WHERE topic_id = ?'
            rows = [row[0] for row in part.dbconn.execute(query, (number,))]
            yield topic, np.array(rows, dtype=np.int64)


def _of_mcap(part: McapReader, wanted: dict[int, str]) -> Iterator[tuple[str, Stamps]]:
    """From the message indexes that stand behind each chunk."""
    assert part.bio is not None
    for chunk in part.chunks:
        for number, place in chunk.message_index_offsets.items():
            size = _INDEX_ENTRY * chunk.channel_count.get(number, 0)
            if number not in wanted or not size:
                continue
            part.bio.seek(place + _INDEX_HEAD)
            entries = np.frombuffer(part.bio.read(size), dtype='<u8')
            yield wanted[number], entries[: len(entries) // 2 * 2 : 2].astype(np.int64)
