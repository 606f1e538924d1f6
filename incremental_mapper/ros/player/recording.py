"""A bag as serialised ROS 2 messages, in the order in which they were logged."""

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import TypeAlias

from rosbags.convert.converter import is_same_wireformat, migrate_bytes
from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag1,
    QosDurability,
    QosHistory,
    TopicInfo,
)
from rosbags.typesys import Stores, get_typestore

from incremental_mapper.datasets.bag_files import Topic, open_bag
from incremental_mapper.errors import InputError

Converter: TypeAlias = Callable[[bytes], bytes | memoryview]


@dataclass(frozen=True, slots=True)
class RecordedTopic(Topic):
    """A topic of a bag; readers that joined late were offered the newest ``kept`` messages."""

    kept: int


class Recording:
    """An open bag; a context manager. Stamps are the times at which messages were logged, ns.

    ``notes`` say what was wrong with its files.
    """

    def __init__(self, path: Path) -> None:
        """Open the bag; raises InputError where it cannot be read."""
        self.path = path
        self._reader = open_bag(path)
        try:
            self._converters = {} if self._reader.is2 else self._ros1_converters()
        # Of a damaged definition the library raises whatever its parser stumbles over.
        except Exception as error:
            self._reader.close()
            raise InputError(f'{path}: its types cannot be read ({_reason(error)})') from error
        self.topics = tuple(_topic(name, info) for name, info in self._reader.topics.items())
        self.notes = tuple(finding.line() for finding in self._reader.findings)
        self.start = self._reader.start_time
        self.end = self._reader.end_time
        """Just after the last message, ns."""

    def __enter__(self) -> 'Recording':
        """Nothing more to open."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the bag."""
        self._reader.close()

    def messages(
        self, names: Collection[str], start: int, stop: int
    ) -> Iterator[tuple[str, int, bytes | None]]:
        """(topic, stamp, CDR) of the topics' messages with ``start`` <= stamp < ``stop``.

        Without CDR come messages of ROS 1 that are damaged.
        Raises InputError where the bag is damaged, after the messages before the damage.
        """
        connections = [c for c in self._reader.connections if c.topic in names]
        if not connections:
            return
        messages = self._reader.messages(connections, start, stop)
        count = 0
        while True:
            try:
                connection, stamp, data = next(messages)
            except StopIteration:
                return
            # On a damaged chunk the library raises whatever it stumbles over.
            except Exception as error:
                raise InputError(
                    f'{self.path}: damaged after {count} messages ({_reason(error)})'
                ) from error
            count += 1
            yield connection.topic, stamp, self._cdr(connection.msgtype, data)

    def _cdr(self, name: str, data: bytes) -> bytes | None:
        if self._reader.is2:
            return bytes(data)
        try:
            return bytes(self._converters[name](data))
        # On damaged data the converter raises whatever it stumbles over.
        except Exception:
            return None

    def _ros1_converters(self) -> dict[str, Converter]:
        """How the bytes of every ROS 1 type become CDR of the ROS 2 type of that name."""
        source = self._reader.typestore
        target = get_typestore(Stores.ROS2_JAZZY)
        own = {n: d for n, d in source.fielddefs.items() if n not in target.fielddefs}
        target.register(own)
        cache: dict[str, object] = {}

        def converter(name: str) -> Converter:
            if is_same_wireformat(source, target, name, name):
                return partial(target.ros1_to_cdr, typename=name)

            def migrate(data: bytes) -> memoryview:
                return migrate_bytes(
                    source, target, name, name, cache, data, src_is2=False, dst_is2=True
                )

            return migrate

        return {name: converter(name) for name in {c.msgtype for c in self._reader.connections}}


def _topic(name: str, info: TopicInfo) -> RecordedTopic:
    kept = sum(_kept(connection) for connection in info.connections)
    return RecordedTopic(name, info.msgtype or 'several types', info.msgcount, kept)


def _kept(connection: Connection) -> int:
    """How many messages a publisher kept for late readers."""
    if isinstance(connection.ext, ConnectionExtRosbag1):
        return 1 if connection.ext.latching else 0
    latched = [
        profile
        for profile in connection.ext.offered_qos_profiles
        if profile.durability == QosDurability.TRANSIENT_LOCAL
    ]
    # Converted bags record no depth.
    if any(profile.history == QosHistory.KEEP_ALL or not profile.depth for profile in latched):
        return connection.msgcount
    return sum(profile.depth for profile in latched)


def _reason(error: Exception) -> str:
    return ' '.join(str(error).split()) or type(error).__name__
