"""Keeps the points of a drive's scans: in memory up to a bound, in a temporary file beyond it.

The file needs no cleaning up. A disk that is full costs no map: what it cannot take stays in
memory, and where that becomes too much, points are left out and counted.
"""

import os
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.config import MapSettings, MapStore
from incremental_mapper.errors import OutputError

Points = NDArray[np.float32]
MOST_IN_MEMORY = 512 << 20
"""Bytes of points that stay in memory where the disk takes no more: ten minutes of two VLP-16.
Whoever keeps scans on disk has no memory for all of them."""
LARGE_FILES = Path('/var/tmp')
"""The system's folder for temporary files that are large: /tmp is often held in memory."""
MB = 1_000_000


class StoredPoints(Protocol):
    """Points (N, C) float32 that may have to be fetched; x, y, z come first."""

    @property
    def nbytes(self) -> int:
        """Bytes that the points take, wherever they are."""

    @property
    def memory(self) -> int:
        """Bytes of them that are in memory."""

    def load(self) -> Points:
        """The points; raises OutputError where they can no longer be read."""


class PointStore(Protocol):
    """Keeps points for as long as somebody holds what ``put`` returned."""

    def put(self, points: Points) -> StoredPoints:
        """Keep points (N, C)."""

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What went wrong in keeping them."""


class PointFile(Protocol):
    """A file that holds points among other things."""

    def read(self, offset: int, size: int) -> Points:
        """The numbers that ``size`` bytes from ``offset`` on hold; raises OutputError."""


@dataclass(frozen=True, slots=True, eq=False)
class PointsInFile:
    """Points that a file holds: where, and how many of how many columns."""

    file: PointFile
    offset: int
    shape: tuple[int, int]

    @property
    def nbytes(self) -> int:
        """See StoredPoints."""
        return 4 * self.shape[0] * self.shape[1]

    @property
    def memory(self) -> int:
        """See StoredPoints."""
        return 0

    def load(self) -> Points:
        """See StoredPoints."""
        return self.file.read(self.offset, self.nbytes).reshape(self.shape)


@dataclass(frozen=True, slots=True, eq=False)
class _InMemory:
    points: Points

    @property
    def nbytes(self) -> int:
        return self.points.nbytes

    @property
    def memory(self) -> int:
        return self.points.nbytes

    def load(self) -> Points:
        return self.points


class MemoryStore:
    """Keeps points as they are."""

    def put(self, points: Points) -> StoredPoints:
        """See PointStore."""
        return _InMemory(points)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """See PointStore."""
        return ()


class SpillingStore:
    """Keeps the first points in memory, and appends all others to a temporary file.

    The file has no name where the system allows that, so nothing is left behind however the
    program ends.
    """

    def __init__(
        self,
        folder: Path | None = None,
        memory: int = 0,
        reserve: int = 0,
        most_in_memory: int = MOST_IN_MEMORY,
    ) -> None:
        """Be ready.

        Args:
            folder: Where the file lies, made now so that it is known to be possible. None takes
                the system's folder for large temporary files, once there is something to be put
                there.
            memory: Bytes of points that stay in memory.
            reserve: Free bytes of the disk below which ``findings`` tell of it.
            most_in_memory: Bytes that stay in memory besides where the disk takes no more.

        Raises:
            OutputError: There can be no file in ``folder``.
        """
        self._folder, self._reserve = folder, reserve
        self._room, self._most_in_memory = memory, most_in_memory
        self._number: int | None = None
        self._end = 0
        self._in_memory = self._left_out = 0
        self._reason = ''
        self._free: int | None = None
        if folder is not None:
            try:
                self._open()
            except OSError as error:
                raise OutputError(f'{folder}: cannot hold the map ({error.strerror})') from error

    def put(self, points: Points) -> StoredPoints:
        """See PointStore."""
        if points.nbytes <= self._room:
            self._room -= points.nbytes
            return _InMemory(points)
        self._room = 0  # the oldest stay, whatever their size
        try:
            offset = self._append(np.ascontiguousarray(points, dtype=np.float32).tobytes())
        except OSError as error:
            self._reason = error.strerror or str(error)
            return self._put_elsewhere(points)
        return PointsInFile(self, offset, (points.shape[0], points.shape[1]))

    @property
    def findings(self) -> tuple[Finding, ...]:
        """See PointStore."""
        if self._reason:
            return (self._full(),)
        low = disk_low(self._where, self._free, self._reserve)
        return () if low is None else (low,)

    def read(self, offset: int, size: int) -> Points:
        """See PointFile."""
        assert self._number is not None
        return read_points(self._number, offset, size)

    @property
    def _where(self) -> Path:
        return self._folder or large_files()

    def _open(self) -> int:
        if self._number is None:
            self._file = tempfile.TemporaryFile(  # noqa: SIM115 (lives as long as its points)
                prefix='incremental_mapper_', dir=self._where, buffering=0
            )
            self._number = self._file.fileno()
        return self._number

    def _append(self, data: bytes) -> int:
        """Put bytes behind those that there are; returns where they begin."""
        number = self._open()
        append(number, data, self._end)
        offset, self._end = self._end, self._end + len(data)
        if self._reserve:
            self._free = free_bytes(number)
        return offset

    def _full(self) -> Finding:
        kept = f'{self._in_memory / MB:.0f} MB of the scans stay in memory'
        lost = f'; the points of {self._left_out} scans are left out of the map'
        return Finding(
            'store_full',
            Severity.WARNING,
            '',
            f'{self._where} takes no more points of the map ({self._reason}): {kept}'
            f'{lost if self._left_out else ""}',
            'make room there, or name another folder in map.store_folder',
        )

    def _put_elsewhere(self, points: Points) -> StoredPoints:
        """Keep in memory what the disk cannot take, or nothing; there may be room again later."""
        if self._in_memory + points.nbytes <= self._most_in_memory:
            self._in_memory += points.nbytes
            return _InMemory(points)
        self._left_out += 1
        return _InMemory(points[:0].copy())


def append(file: int, data: bytes, offset: int) -> None:
    """Write all of some bytes at a place of a file; raises OSError where there is no room.

    Args:
        file: Number of the open file.
        data: The bytes.
        offset: Where they begin.
    """
    written = 0
    while written < len(data):
        written += os.pwrite(file, data[written:], offset + written)


def read_points(file: int, offset: int, size: int) -> Points:
    """The numbers that a part of a file holds.

    Args:
        file: Number of the open file.
        offset: Where they begin.
        size: How many bytes they take.

    Raises:
        OutputError: They cannot be read.
    """
    parts: list[bytes] = []
    while size > 0:
        try:
            part = os.pread(file, size, offset)
        except OSError as error:
            raise OutputError(f'the map cannot be read back ({error.strerror})') from error
        if not part:
            raise OutputError('the map cannot be read back (its file is shorter than it was)')
        parts.append(part)
        offset, size = offset + len(part), size - len(part)
    return np.frombuffer(b''.join(parts), dtype=np.float32)


def free_bytes(file: int) -> int:
    """Bytes that the disk of an open file has left for this user."""
    disk = os.fstatvfs(file)
    return disk.f_bavail * disk.f_frsize


def disk_low(where: Path, free: int | None, reserve: int) -> Finding | None:
    """Tell, before it is too late, of a disk that fills up.

    Args:
        where: The folder that grows.
        free: Bytes that are left; None where nothing has been written yet.
        reserve: Bytes below which a user is told.
    """
    if free is None or free >= reserve:
        return None
    text = f'the disk of {where} has {free // MB} MB left, less than map.reserve ({reserve // MB})'
    remedy = 'save the map and begin another, make room, or name another folder'
    return Finding('disk_low', Severity.WARNING, '', text, remedy)


def large_files() -> Path:
    """The folder for large temporary files: TMPDIR, else the system's, else that of small ones."""
    given = os.environ.get('TMPDIR')
    if given or not os.access(LARGE_FILES, os.W_OK | os.X_OK):
        return Path(tempfile.gettempdir())
    return LARGE_FILES


def make_store(settings: MapSettings) -> PointStore:
    """Make the store that the settings name.

    Raises:
        OutputError: its folder cannot be used.
    """
    if settings.store is MapStore.MEMORY:
        return MemoryStore()
    folder = Path(settings.store_folder) if settings.store_folder else None
    memory = round(settings.memory * MB) if settings.store is MapStore.SPILL else 0
    return SpillingStore(folder, memory, round(settings.reserve * MB))
