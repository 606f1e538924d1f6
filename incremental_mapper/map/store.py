"""Keeps the points of a drive's scans in memory, or in a file that needs no cleaning up.

A disk that is full costs no map: what it cannot take stays in memory, and where that becomes too
much, points are left out and counted.
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


class StoredPoints(Protocol):
    """Points (N, C) float32 that may have to be fetched; x, y, z come first."""

    @property
    def nbytes(self) -> int:
        """Bytes that the points take, wherever they are."""

    def load(self) -> Points:
        """The points; raises OutputError where they can no longer be read."""


class PointStore(Protocol):
    """Keeps points for as long as somebody holds what ``put`` returned."""

    def put(self, points: Points) -> StoredPoints:
        """Keep points (N, C)."""

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What went wrong in keeping them."""


@dataclass(frozen=True, slots=True, eq=False)
class _InMemory:
    points: Points

    @property
    def nbytes(self) -> int:
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


@dataclass(frozen=True, slots=True, eq=False)
class _OnDisk:
    store: 'DiskStore'
    offset: int
    shape: tuple[int, int]

    @property
    def nbytes(self) -> int:
        return 4 * self.shape[0] * self.shape[1]

    def load(self) -> Points:
        return self.store.read(self.offset, self.nbytes).reshape(self.shape)


class DiskStore:
    """Appends points to a temporary file in ``folder``, by default the system's.

    The file has no name where the system allows that, so nothing is left behind however the
    program ends.
    """

    def __init__(self, folder: Path | None = None, most_in_memory: int = MOST_IN_MEMORY) -> None:
        try:
            self._file = tempfile.TemporaryFile(  # noqa: SIM115 (lives as long as its points)
                prefix='incremental_mapper_', dir=folder, buffering=0
            )
        except OSError as error:
            where = folder or tempfile.gettempdir()
            raise OutputError(f'{where}: cannot hold the map ({error.strerror})') from error
        self._where = folder or Path(tempfile.gettempdir())
        self._most_in_memory = most_in_memory
        self._end = 0
        self._in_memory = self._left_out = 0
        self._reason = ''

    def put(self, points: Points) -> StoredPoints:
        """See PointStore."""
        data = np.ascontiguousarray(points, dtype=np.float32).tobytes()
        offset, written = self._end, 0
        try:
            while written < len(data):
                written += os.pwrite(self._file.fileno(), data[written:], offset + written)
        except OSError as error:
            self._reason = error.strerror or str(error)
            return self._put_elsewhere(points)
        self._end += len(data)
        return _OnDisk(self, offset, (points.shape[0], points.shape[1]))

    @property
    def findings(self) -> tuple[Finding, ...]:
        """See PointStore."""
        if not self._reason:
            return ()
        kept = f'{self._in_memory / 1e6:.0f} MB of the scans stay in memory'
        lost = f'; the points of {self._left_out} scans are left out of the map'
        return (
            Finding(
                'store_full',
                Severity.WARNING,
                '',
                f'{self._where} takes no more points of the map ({self._reason}): {kept}'
                f'{lost if self._left_out else ""}',
                'make room there, or name another folder in map.store_folder',
            ),
        )

    def _put_elsewhere(self, points: Points) -> StoredPoints:
        """Keep in memory what the disk cannot take, or nothing; there may be room again later."""
        if self._in_memory + points.nbytes <= self._most_in_memory:
            self._in_memory += points.nbytes
            return _InMemory(points)
        self._left_out += 1
        return _InMemory(points[:0].copy())

    def read(self, offset: int, size: int) -> Points:
        """The numbers that ``size`` bytes from ``offset`` on hold."""
        parts: list[bytes] = []
        while size > 0:
            try:
                part = os.pread(self._file.fileno(), size, offset)
            except OSError as error:
                raise OutputError(f'the map cannot be read back ({error.strerror})') from error
            if not part:
                raise OutputError('the map cannot be read back (its file is shorter than it was)')
            parts.append(part)
            offset, size = offset + len(part), size - len(part)
        return np.frombuffer(b''.join(parts), dtype=np.float32)


def make_store(settings: MapSettings) -> PointStore:
    """Make the store that the settings name.

    Raises:
        OutputError: its folder cannot be used.
    """
    if settings.store is MapStore.MEMORY:
        return MemoryStore()
    return DiskStore(Path(settings.store_folder) if settings.store_folder else None)
