"""Bags that were not finished well: what is in them is read, and what was wrong is said.

The readers take the places of the bag library's own. They read sound files just as those do, and
nothing is ever written beside a recording.
"""

import shutil
import sqlite3
import tempfile
from collections import Counter
from collections.abc import Callable, Generator, Iterable
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from incremental_mapper.checks.finding import Finding
from incremental_mapper.checks.recording_files import (
    CutFile,
    UnclosedFile,
    truncated_bag,
    unclosed_bag,
    unknown_storage,
    wrong_metadata,
)
from incremental_mapper.datasets.clock_leaps import ClockLeaps, Logged
from incremental_mapper.datasets.livox import LIVOX_TYPES, livox_cloud
from incremental_mapper.measurements import NANOSECONDS

_HEADER_BYTES = 9
"""Opcode and length of an MCAP record."""
_FOOTER = 0x02
_DATA_END = 0x0F
_BEGINNINGS = {'mcap': b'\x89MCAP', 'sqlite3': b'SQLite format 3'}
"""First bytes of files, by storage identifier."""
_UNFINISHED = ('-wal', '-journal')
"""What SQLite keeps beside a database that was not closed."""


@dataclass(slots=True)
class _Damage:
    """What the files of a bag turned out to be when they were opened."""

    cut: list[CutFile] = field(default_factory=list)
    unclosed: list[UnclosedFile] = field(default_factory=list)
    identifiers: list[str] = field(default_factory=list)
    metadata: list[Finding] = field(default_factory=list)

    def clear(self) -> None:
        for part in (self.cut, self.unclosed, self.identifiers, self.metadata):
            part.clear()


class BagReader(AnyReader):
    """The bag library's reader; once it is open, ``findings`` say what was mended.

    Where ``leaps`` are set, messages, their record times and those of the bag are by the clock
    after them.
    """

    leaps: ClockLeaps | None = None

    def __init__(self, paths: list[Path], **options: Any) -> None:
        """See ``AnyReader``."""
        super().__init__(paths, **options)
        self._damage = _Damage()
        plugins = _ByEnding(self._damage)
        for reader in self.readers:
            storage = getattr(reader, 'storage', None)
            if isinstance(storage, DirectoryReader):
                storage.STORAGE_PLUGINS = plugins  # type: ignore[assignment]
            elif storage is not None:
                reader.storage = plugins.of_file(Path(str(reader.path)))  # type: ignore[union-attr]

    def open(self) -> None:
        """Open the bag; times that its metadata tell wrongly are taken from its files."""
        self._damage.clear()
        super().open()
        for reader in self.readers:
            storage = getattr(reader, 'storage', None)
            if isinstance(storage, DirectoryReader):
                self._damage.metadata.extend(_mend_metadata(storage))

    def deserialize(self, rawdata: bytes, typ: str) -> object:
        """Decode a message; of a Livox ``CustomMsg`` a cloud is made, whether or not it is known.

        Raises MeasurementError, or whatever the library stumbles over, where it is damaged.
        """
        if typ in LIVOX_TYPES:
            return livox_cloud(rawdata, ros1=not self.is2)
        return super().deserialize(rawdata, typ)

    def messages(
        self,
        connections: Iterable[Any] = (),
        start: int | None = None,
        stop: int | None = None,
    ) -> Generator[Logged, None, None]:
        """Messages of some connections, of all without any, from ``start`` until ``stop``, ns."""
        leaps, chosen = self.leaps, list(connections)
        if leaps is None:
            yield from super().messages(chosen, start, stop)
            return
        for begin, end in leaps.spans(start, stop):
            for message in super().messages(chosen, begin, end):
                yield leaps.moved(message, is_ros1(message[0]))

    @property
    def start_time(self) -> int:
        """Record time (ns) of the first message."""
        return super().start_time + (0 if self.leaps is None else self.leaps.recorded_by)

    @property
    def findings(self) -> list[Finding]:
        """What was wrong with the files."""
        damage = self._damage
        return [
            *truncated_bag(damage.cut),
            *unclosed_bag(damage.unclosed),
            *unknown_storage(damage.identifiers),
            *damage.metadata,
        ]


def is_ros1(connection: Any) -> bool:
    """Whether a connection is one of a ROS 1 bag, whose messages begin otherwise."""
    return hasattr(connection.owner, 'indexes')


class _SalvagingMcap(McapReader):
    """Reads an MCAP file without its end: the whole records before the damage."""

    def __init__(self, path: Path, damage: _Damage) -> None:
        super().__init__(path)
        self._name = path.name
        self._damage = damage

    def _open(self) -> None:
        try:
            super()._open()
        # Of a damaged file the library raises whatever its parser stumbles over.
        except Exception:
            if not self.data_start:
                raise
            self._forget()
            self._salvage()

    def _forget(self) -> None:
        for kept in (self.schemas, self.channels, self.chunks, self.connections):
            kept.clear()
        self.statistics = None

    def _salvage(self) -> None:
        """Take what stands before the damage for the data of the file."""
        assert self.bio is not None
        size = self.bio.seek(0, 2)
        self.data_end = self._last_whole_record(size)
        self.meta_scan()
        found = self.statistics
        if found is None or not found.message_count:
            raise ValueError('the file is cut off before its first chunk of messages ends')
        self.connections = [
            connection._replace(msgcount=found.channel_message_counts.get(connection.id, 0))
            for connection in self.connections
        ]
        self.metadata = self.metadata._replace(
            duration=found.end_time - found.start_time + 1,
            start_time=found.start_time,
            end_time=found.end_time + 1,
            message_count=found.message_count,
        )
        seconds = (found.end_time - found.start_time) / NANOSECONDS
        lost = size - self.data_end
        self._damage.cut.append(CutFile(self._name, found.message_count, seconds, lost, size))

    def _last_whole_record(self, size: int) -> int:
        """Where the last record ends that is whole."""
        assert self.bio is not None
        place = self.data_start
        while place + _HEADER_BYTES <= size:
            self.bio.seek(place)
            head = self.bio.read(_HEADER_BYTES)
            end = place + _HEADER_BYTES + int.from_bytes(head[1:], 'little')
            if end > size or head[0] in (0, _FOOTER, _DATA_END):
                break
            place = end
        return place


class _RecoveringSqlite(Sqlite3Reader):
    """Reads a database that its recorder did not close: SQLite's own recovery on a copy."""

    def __init__(self, path: Path, damage: _Damage) -> None:
        super().__init__(path)
        self._damage = damage
        self._original = path
        self._folder: tempfile.TemporaryDirectory[str] | None = None

    def open(self) -> None:
        left = [p for p in map(self._beside, _UNFINISHED) if p.is_file() and p.stat().st_size]
        if left:
            self._recover(left)
        try:
            super().open()
        except BaseException:
            self._clean()
            raise

    def close(self) -> None:
        try:
            super().close()
        finally:
            self._clean()

    def _beside(self, ending: str) -> Path:
        return self._original.with_name(self._original.name + ending)

    def _recover(self, left: list[Path]) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix='incremental_mapper_')
        copy = Path(self._folder.name) / self._original.name
        try:
            for file in (self._original, *left):
                shutil.copyfile(file, copy.with_name(file.name))
            with closing(sqlite3.connect(copy)) as database:
                database.execute('PRAGMA wal_checkpoint(TRUNCATE)').fetchall()
                database.execute('PRAGMA journal_mode=DELETE').fetchall()
        except (OSError, sqlite3.Error) as error:
            self._clean()
            raise ValueError(
                f'the recorder did not close it ({left[0].name} is there), and it cannot be '
                f'recovered in a copy ({error}); '
                f'sqlite3 {self._original} "PRAGMA wal_checkpoint(TRUNCATE);" does it in place'
            ) from error
        self.path = copy
        size = sum(file.stat().st_size for file in left)
        names = tuple(file.name for file in left)
        self._damage.unclosed.append(UnclosedFile(self._original.name, names, size))

    def _clean(self) -> None:
        self.path = self._original
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None


class _ByEnding(dict[str, Callable[[Path], Any]]):
    """Storage readers by identifier; by the file's ending where that is not what the file is.

    A dictionary because the library looks the identifier up in one.
    """

    def __init__(self, damage: _Damage) -> None:
        super().__init__()
        self._damage = damage

    def __contains__(self, identifier: object) -> bool:
        return True

    def __missing__(self, identifier: str) -> Callable[[Path], Any]:
        def known(path: Path) -> Any:
            if identifier not in _BEGINNINGS or _begins_otherwise(path, identifier):
                self._damage.identifiers.append(identifier)
                return self.of_file(path)
            return (_SalvagingMcap if identifier == 'mcap' else _RecoveringSqlite)(
                path, self._damage
            )

        return known

    def of_file(self, path: Path) -> Any:
        """A reader for a file by its ending."""
        if path.suffix == '.mcap':
            return _SalvagingMcap(path, self._damage)
        if path.suffix == '.db3':
            return _RecoveringSqlite(path, self._damage)
        raise ValueError(f'{path.name} ends neither in .mcap nor in .db3')


def _begins_otherwise(path: Path, identifier: str) -> bool:
    """Whether a file begins like one of another format."""
    with path.open('rb') as file:
        begin = file.read(max(map(len, _BEGINNINGS.values())))
    return any(begin.startswith(other) for name, other in _BEGINNINGS.items() if name != identifier)


def _mend_metadata(storage: DirectoryReader) -> list[Finding]:
    """Replace span and counts of ``metadata.yaml`` by those of the files where they differ."""
    parts = [part.metadata for part in storage.storages if part.metadata.message_count]
    if not parts:
        return []
    start = min(part.start_time for part in parts)
    end = max(part.end_time for part in parts)
    told = storage.metadata
    counts: Counter[tuple[str, str]] = Counter()
    for part in storage.storages:
        for connection in part.connections:
            counts[connection.topic, connection.msgtype] += connection.msgcount
    findings = wrong_metadata(
        ((told.end_time - told.start_time) / NANOSECONDS, told.message_count),
        ((end - start) / NANOSECONDS, sum(counts.values())),
        times=start < told.start_time or end > told.end_time,
        counts=any(counts[c.topic, c.msgtype] > c.msgcount for c in storage.connections),
    )
    if findings:
        storage.connections[:] = [
            c._replace(msgcount=max(c.msgcount, counts[c.topic, c.msgtype]))
            for c in storage.connections
        ]
        storage.metadata = told._replace(
            start_time=min(start, told.start_time), end_time=max(end, told.end_time)
        )
    return findings
