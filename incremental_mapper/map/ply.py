"""``map.ply``: the points of a map with their intensity; ``map_scans.ply``: which scan saw each.

They are two files because readers of PLY that know floats alone, as small_gicp's does, refuse other
columns, and some misread more than four.

By hand, because plyfile's licence (GPL) is not ours, small_gicp's reader ends the process where a
file is damaged, and a long map is read and written in pieces.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.errors import InputError
from incremental_mapper.map.cloud import CLOUD_FIELDS
from incremental_mapper.measurements import NANOSECONDS

Records: TypeAlias = NDArray[np.void]
"""Points with named columns: ``x``, ``y``, ``z``, and of the others those that a file has."""

SOURCE_FIELDS = (('time', '<f8'), ('lidar', 'u1'), ('window', '<i4'))
"""Columns that tell where a point comes from, and their types."""
CHUNK = 500_000
"""Points that are in memory at a time where a file is read in pieces."""
SCANS = 'map_scans.ply'
"""Beside the file of the points: a number for each point, and the scans that the numbers mean."""
NUMBER = np.dtype([('scan', '<i4')])
SCAN = np.dtype(list(SOURCE_FIELDS))
NAMES = {'<f4': 'float', '<f8': 'double', 'u1': 'uchar', '<i4': 'int'}
"""PLY's names of types."""


@dataclass(frozen=True, slots=True, eq=False)
class ScanTable:
    """The scans of a map: stamps (S,) ns, numbers of their LiDARs and windows (S,), and names."""

    stamps: NDArray[np.int64]
    lidars: NDArray[np.uint8]
    windows: NDArray[np.int32]
    names: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class MapCloud:
    """A map thinned to voxels.

    Attributes:
        points: (N, 3), metres in the map, or (N, 4) with intensity.
        first: The scan (N,) that saw each voxel first, as a place in ``scans``.
        scans: What is known of the scans; None where nothing is.
    """

    points: NDArray[np.float32]
    first: NDArray[np.int32]
    scans: ScanTable | None = None

    @classmethod
    def bare(cls, points: NDArray[np.float32]) -> Self:
        """Points of which nobody knows where they come from."""
        return cls(points, np.zeros(len(points), dtype=np.int32))

    def __len__(self) -> int:
        return len(self.points)

    @property
    def lidars(self) -> tuple[str, ...]:
        """Names of the LiDARs, in the order of their numbers."""
        return () if self.scans is None else self.scans.names


def write_ply(path: Path, cloud: MapCloud) -> None:
    """Write the points of a map as a binary PLY with float vertices.

    Args:
        path: the file to write; what it held is lost.
        cloud: the map.

    Raises:
        OSError: the file cannot be written.
    """
    columns = np.dtype([(name, '<f4') for name in CLOUD_FIELDS[: cloud.points.shape[1]]])
    with path.open('wb') as file:
        file.write(ply_header([('vertex', len(cloud), columns)]))
        file.write(np.ascontiguousarray(cloud.points, dtype='<f4').data)  # no copy: an hour is 1 GB


def write_scans(path: Path, cloud: MapCloud) -> None:
    """Write which scan saw each voxel first, as a binary PLY of points and scans.

    Args:
        path: the file to write; what it held is lost.
        cloud: the map.

    Raises:
        OSError: the file cannot be written.
    """
    scans = np.zeros(0, dtype=SCAN)
    if cloud.scans is not None:
        scans = np.empty(len(cloud.scans.stamps), dtype=SCAN)
        scans['time'] = cloud.scans.stamps / NANOSECONDS
        scans['lidar'], scans['window'] = cloud.scans.lidars, cloud.scans.windows
    elements = [('scan', len(scans), SCAN), ('point', len(cloud), NUMBER)]
    with path.open('wb') as file:
        file.write(ply_header(elements, cloud.lidars))
        file.write(scans.tobytes())
        file.write(np.ascontiguousarray(cloud.first, dtype='<i4').data)


def ply_header(
    elements: Sequence[tuple[str, int, np.dtype[np.void]]], lidars: tuple[str, ...] = ()
) -> bytes:
    """The head of a binary PLY.

    Args:
        elements: Name, number and columns of what follows.
        lidars: Names that the numbers of a column ``lidar`` stand for.
    """
    lines = ['ply', 'format binary_little_endian 1.0', 'comment frame map, metres']
    lines += [f'comment lidar {number} {name}' for number, name in enumerate(lidars)]
    for element, count, dtype in elements:
        lines.append(f'element {element} {count}')
        for name in dtype.names or ():
            lines.append(f'property {NAMES[dtype[name].str.lstrip("|")]} {name}')
    return '\n'.join([*lines, 'end_header', '']).encode()


@dataclass(frozen=True)
class MapFile:
    """A ``map.ply`` whose points are read when they are asked for.

    Where ``map_scans.ply`` lies beside it, they know their scans. Every attribute raises InputError
    where a file is damaged, or is no map.
    """

    path: Path

    @property
    def count(self) -> int:
        """How many points it holds."""
        return self._points.count

    @property
    def dtype(self) -> np.dtype[np.void]:
        """The columns of ``records``."""
        columns = [(name, '<f4') for name in self._points.columns]
        return np.dtype(columns + list(SOURCE_FIELDS if self._scans is not None else ()))

    @property
    def lidars(self) -> tuple[str, ...]:
        """Names of the LiDARs, in the order of their numbers."""
        return () if self._scans is None else self._scans.lidars

    def records(self, size: int | None = None) -> Iterator[Records]:
        """The points with all that is known of them, ``size`` (``CHUNK``) at a time.

        ``time`` is the stamp of a scan in seconds: a double tells moments 0.2 µs apart.
        """
        size = size or CHUNK
        scans, dtype = self._scans, self.dtype
        if scans is None:
            yield from self._own(size)
            return
        with scans.path.open('rb') as numbers:
            numbers.seek(scans.start)
            for points in self._own(size):
                records: Records = np.empty(len(points), dtype=dtype)
                seen = np.fromfile(numbers, dtype='<i4', count=len(points))
                if not 0 <= seen.min() <= seen.max() < len(scans.table):
                    raise _damaged(scans.path)
                own = scans.table[seen]
                for name in dtype.names or ():
                    records[name] = (points if name in self._points.columns else own)[name]
                yield records

    def _own(self, size: int) -> Iterator[Records]:
        """The points with the columns of this file alone, ``size`` at a time."""
        head = self._points
        columns = np.dtype([(name, '<f4') for name in head.columns])
        with self.path.open('rb') as file:
            file.seek(head.start)
            for first in range(0, head.count, size):
                yield np.fromfile(file, dtype=columns, count=min(size, head.count - first))

    def first(self) -> NDArray[np.int32] | None:
        """The scan (N,) that saw each voxel first, as a place among the scans.

        None where nothing is known of the scans.
        """
        scans = self._scans
        if scans is None:
            return None
        numbers = np.fromfile(scans.path, dtype='<i4', count=self.count, offset=scans.start)
        if len(numbers) and not 0 <= numbers.min() <= numbers.max() < len(scans.table):
            raise _damaged(scans.path)
        return numbers

    def columns(self, names: tuple[str, ...], dtype: Any) -> NDArray[Any]:
        """Some columns of all points.

        Args:
            names: Which.
            dtype: The type of the numbers.

        Returns:
            (N, C), in the order of ``names``.
        """
        made = np.empty((self.count, len(names)), dtype=dtype)
        start = 0
        own = set(names) <= set(self._points.columns)
        for records in self._own(CHUNK) if own else self.records():
            for place, name in enumerate(names):
                made[start : start + len(records), place] = records[name]
            start += len(records)
        return made

    @cached_property
    def _points(self) -> '_Points':
        text, start, size = _read_head(self.path)
        count = re.search(r'^element vertex (\d+)$', text, flags=re.MULTILINE)
        fields = re.findall(r'^property (.+) (\w+)$', text, flags=re.MULTILINE)
        names = tuple(name for _, name in fields)
        known = names[:3] == CLOUD_FIELDS[:3] and all(kind == 'float' for kind, _ in fields)
        if count is None or not known or size != start + 4 * len(names) * int(count[1]):
            raise _damaged(self.path)
        return _Points(start, int(count[1]), names)

    @cached_property
    def _scans(self) -> '_Scans | None':
        path = self.path.with_name(SCANS)
        if not path.is_file():  # a run of an earlier version
            return None
        text, start, size = _read_head(path)
        pattern = r'^element scan (\d+)$[\s\S]*^element point (\d+)$'
        found = re.search(pattern, text, flags=re.MULTILINE)
        scans, points = (int(found[1]), int(found[2])) if found else (0, -1)
        begin = start + scans * SCAN.itemsize
        if points != self.count or size != begin + points * NUMBER.itemsize:
            raise _damaged(path)
        if points and not scans:
            return None
        with path.open('rb') as file:
            file.seek(start)
            table = np.fromfile(file, dtype=SCAN, count=scans)
        names = re.findall(r'^comment lidar \d+ (.+)$', text, flags=re.MULTILINE)
        return _Scans(path, begin, table, tuple(names))


@dataclass(frozen=True, slots=True)
class _Points:
    """Where points begin in their file, how many there are, and their columns."""

    start: int
    count: int
    columns: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Scans:
    """The file of scans, where its numbers begin, the scans, and the names of the LiDARs."""

    path: Path
    start: int
    table: Records
    lidars: tuple[str, ...]


def _read_head(path: Path) -> tuple[str, int, int]:
    """The head of a PLY, where it ends, and the size of the file."""
    with path.open('rb') as file:
        head, end, _ = file.read(1 << 16).partition(b'end_header\n')
    if not end:
        raise _damaged(path)
    return head.decode(errors='replace'), len(head) + len(end), path.stat().st_size


def _damaged(path: Path) -> InputError:
    return InputError(f'{path}: is damaged, or is no map that "incremental_mapper map" wrote')
