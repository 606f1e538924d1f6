"""Keeps the points of a drive's scans in memory, or in a file that needs no cleaning up."""

import os
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.config import MapSettings, MapStore
from incremental_mapper.errors import OutputError

Points = NDArray[np.float32]


class StoredPoints(Protocol):
    """Points (N, 3) float32 that may have to be fetched."""

    @property
    def nbytes(self) -> int:
        """Bytes that the points take, wherever they are."""

    def load(self) -> Points:
        """The points; raises OutputError where they can no longer be read."""


class PointStore(Protocol):
    """Keeps points for as long as somebody holds what ``put`` returned."""

    def put(self, points: Points) -> StoredPoints:
        """Keep points (N, 3); raises OutputError where there is no room."""


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


@dataclass(frozen=True, slots=True, eq=False)
class _OnDisk:
    store: 'DiskStore'
    offset: int
    count: int

    @property
    def nbytes(self) -> int:
        return self.count * 12

    def load(self) -> Points:
        return self.store.read(self.offset, self.nbytes)


class DiskStore:
    """Appends points to a temporary file in ``folder``, by default the system's.

    The file has no name where the system allows that, so nothing is left behind however the
    program ends.
    """

    def __init__(self, folder: Path | None = None) -> None:
        try:
            self._file = tempfile.TemporaryFile(  # noqa: SIM115 (lives as long as its points)
                prefix='incremental_mapper_', dir=folder, buffering=0
            )
        except OSError as error:
            where = folder or tempfile.gettempdir()
            raise OutputError(f'{where}: cannot hold the map ({error.strerror})') from error
        self._end = 0

    def put(self, points: Points) -> StoredPoints:
        """See PointStore."""
        data = np.ascontiguousarray(points, dtype=np.float32).tobytes()
        offset, written = self._end, 0
        try:
            while written < len(data):
                written += os.pwrite(self._file.fileno(), data[written:], offset + written)
        except OSError as error:
            raise OutputError(f'the map cannot be kept on disk ({error.strerror})') from error
        self._end += len(data)
        return _OnDisk(self, offset, len(points))

    def read(self, offset: int, size: int) -> Points:
        """The points (N, 3) that ``size`` bytes from ``offset`` on hold."""
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
        return np.frombuffer(b''.join(parts), dtype=np.float32).reshape(-1, 3)


def make_store(settings: MapSettings) -> PointStore:
    """Make the store that the settings name.

    Raises:
        OutputError: its folder cannot be used.
    """
    if settings.store is MapStore.MEMORY:
        return MemoryStore()
    return DiskStore(Path(settings.store_folder) if settings.store_folder else None)
