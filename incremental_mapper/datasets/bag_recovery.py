"""Bags that were not finished well: what is in them is read, and what was wrong is said.

The readers take the places of the bag library's own. They read sound files just as those do, and
nothing is ever written beside a recording.
"""

import shutil
import sqlite3
import tempfile
from collections import Counter
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from incremental_mapper.measurements import NANOSECONDS

_HEADER_BYTES = 9
"""Opcode and length of an MCAP record."""
_FOOTER = 0x02
_DATA_END = 0x0F
_UNFINISHED = ('-wal', '-journal')
"""What SQLite keeps beside a database that was not closed."""


class BagReader(AnyReader):
    """The bag library's reader; ``notes`` say what was mended once it is open."""

    def __init__(self, paths: list[Path], **options: Any) -> None:
        """See ``AnyReader``."""
        super().__init__(paths, **options)
        self.notes: list[str] = []
        plugins = _ByEnding(self.notes)
        for reader in self.readers:
            storage = getattr(reader, 'storage', None)
            if isinstance(storage, DirectoryReader):
                storage.STORAGE_PLUGINS = plugins  # type: ignore[assignment]
            elif storage is not None:
                reader.storage = plugins.of_file(Path(str(reader.path)))  # type: ignore[union-attr]

    def open(self) -> None:
        """Open the bag; times that its metadata tell wrongly are taken from its files."""
        self.notes.clear()
        super().open()
        for reader in self.readers:
            storage = getattr(reader, 'storage', None)
            if isinstance(storage, DirectoryReader):
                _mend_metadata(storage, self.notes)


class _SalvagingMcap(McapReader):
    """Reads an MCAP file without its end: the whole records before the damage."""

    def __init__(self, path: Path, notes: list[str]) -> None:
        super().__init__(path)
        self._name = path.name
        self._notes = notes

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
        self._notes.append(
            f'{self._name}: is cut off, its end with the index is missing; '
            f'{found.message_count} messages of {seconds:.1f} s are read, the last '
            f'{size - self.data_end} of {size} bytes are lost (truncated_bag); '
            '"mcap recover" makes a whole file of it'
        )

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

    def __init__(self, path: Path, notes: list[str]) -> None:
        super().__init__(path)
        self._notes = notes
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
        self._notes.append(
            f'{self._original.name}: its recorder did not close it; the {size / 1e6:.1f} MB in '
            f'{" and ".join(file.name for file in left)} are read from a temporary copy '
            '(unclosed_bag); '
            f'sqlite3 {self._original.name} "PRAGMA wal_checkpoint(TRUNCATE);" finishes it'
        )

    def _clean(self) -> None:
        self.path = self._original
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None


class _ByEnding(dict[str, Callable[[Path], Any]]):
    """Storage readers by identifier; where metadata names none that is known, by the file's ending.

    A dictionary because the library looks the identifier up in one.
    """

    def __init__(self, notes: list[str]) -> None:
        super().__init__()
        self._notes = notes

    def __contains__(self, identifier: object) -> bool:
        return True

    def __missing__(self, identifier: str) -> Callable[[Path], Any]:
        def known(path: Path) -> Any:
            if identifier not in ('mcap', 'sqlite3'):
                note = (
                    f'metadata.yaml: storage_identifier is {identifier!r}; '
                    f'{path.suffix or "no ending"} of the files tells what they are '
                    '(wrong_metadata)'
                )
                if note not in self._notes:
                    self._notes.append(note)
                return self.of_file(path)
            return (_SalvagingMcap if identifier == 'mcap' else _RecoveringSqlite)(
                path, self._notes
            )

        return known

    def of_file(self, path: Path) -> Any:
        """A reader for a file by its ending."""
        if path.suffix == '.mcap':
            return _SalvagingMcap(path, self._notes)
        if path.suffix == '.db3':
            return _RecoveringSqlite(path, self._notes)
        raise ValueError(f'{path.name} ends neither in .mcap nor in .db3')


def _mend_metadata(storage: DirectoryReader, notes: list[str]) -> None:
    """Replace span and counts of ``metadata.yaml`` by those of the files where they differ."""
    parts = [part.metadata for part in storage.storages if part.metadata.message_count]
    if not parts:
        return
    start = min(part.start_time for part in parts)
    end = max(part.end_time for part in parts)
    told = storage.metadata
    wrong = []
    if start < told.start_time or end > told.end_time:
        wrong.append(
            f'times are of {(told.end_time - told.start_time) / NANOSECONDS:.1f} s, its files have '
            f'{(end - start) / NANOSECONDS:.1f} s'
        )
    counts: Counter[tuple[str, str]] = Counter()
    for part in storage.storages:
        for connection in part.connections:
            counts[connection.topic, connection.msgtype] += connection.msgcount
    if any(counts[c.topic, c.msgtype] > c.msgcount for c in storage.connections):
        wrong.append(
            f'counts are of {told.message_count} messages, its files have {sum(counts.values())}'
        )
        storage.connections[:] = [
            c._replace(msgcount=max(c.msgcount, counts[c.topic, c.msgtype]))
            for c in storage.connections
        ]
    if wrong:
        storage.metadata = told._replace(
            start_time=min(start, told.start_time), end_time=max(end, told.end_time)
        )
        notes.append(
            f'metadata.yaml: {" and ".join(wrong)}; the files are believed (wrong_metadata); '
            '"ros2 bag reindex" writes it anew'
        )
