"""``map.ply``: the points of a map with their intensity, and when and by what each was seen.

By hand, because plyfile's licence (GPL) is not ours, small_gicp's reader ends the process where a
file is damaged, and a long map is read and written in pieces.
"""

import re
from collections.abc import Iterator
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
"""Points that are in memory at a time where a file is read or written in pieces."""
TYPES = {
    'float': '<f4', 'float32': '<f4', 'double': '<f8', 'float64': '<f8', 'uchar': 'u1',
    'uint8': 'u1', 'char': 'i1', 'int8': 'i1', 'ushort': '<u2', 'uint16': '<u2', 'short': '<i2',
    'int16': '<i2', 'uint': '<u4', 'uint32': '<u4', 'int': '<i4', 'int32': '<i4',
}  # fmt: skip
"""PLY's names of types, the old and the new ones, in numpy's."""
NAMES = {'<f4': 'float', '<f8': 'double', 'u1': 'uchar', '<i4': 'int'}


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

    @property
    def dtype(self) -> np.dtype[np.void]:
        """The columns of ``records``."""
        columns: list[tuple[str, str]] = [
            (name, '<f4') for name in CLOUD_FIELDS[: self.points.shape[1]]
        ]
        return np.dtype(columns + list(SOURCE_FIELDS if self.scans is not None else ()))

    def records(self, size: int | None = None) -> Iterator[Records]:
        """The points with all that is known of them, ``size`` (``CHUNK``) at a time.

        ``time`` is the stamp of a scan in seconds: a double tells moments 0.2 µs apart.
        """
        size = size or CHUNK
        for start in range(0, len(self), size):
            part = self.points[start : start + size]
            records: Records = np.empty(len(part), dtype=self.dtype)
            for name, column in zip(CLOUD_FIELDS, part.T, strict=False):
                records[name] = column
            if self.scans is not None:
                first = self.first[start : start + size]
                records['time'] = (self.scans.stamps / NANOSECONDS)[first]
                records['lidar'] = self.scans.lidars[first]
                records['window'] = self.scans.windows[first]
            yield records


def write_ply(path: Path, cloud: MapCloud) -> None:
    """Write a map as a binary PLY.

    Args:
        path: the file to write; what it held is lost.
        cloud: the map.

    Raises:
        OSError: the file cannot be written.
    """
    with path.open('wb') as file:
        file.write(ply_header(cloud.dtype, len(cloud), cloud.lidars))
        for records in cloud.records():
            file.write(records.tobytes())


def ply_header(dtype: np.dtype[np.void], count: int, lidars: tuple[str, ...] = ()) -> bytes:
    """The head of a binary PLY of points.

    Args:
        dtype: Columns of the points.
        count: How many points follow.
        lidars: Names that the numbers of the column ``lidar`` stand for.
    """
    fields = [(name, dtype[name].str.lstrip('|')) for name in dtype.names or ()]
    lines = ['ply', 'format binary_little_endian 1.0', 'comment frame map, metres']
    lines += [f'comment lidar {number} {name}' for number, name in enumerate(lidars)]
    if 'time' in dict(fields):
        lines.append('comment time, lidar and window are those of the scan that saw a voxel first')
    lines += [f'element vertex {count}']
    lines += [f'property {NAMES[kind]} {name}' for name, kind in fields]
    return '\n'.join([*lines, 'end_header', '']).encode()


@dataclass(frozen=True)
class MapFile:
    """A ``map.ply`` whose points are read when they are asked for.

    Every attribute raises InputError where the file is damaged, or is no map.
    """

    path: Path

    @property
    def count(self) -> int:
        """How many points it holds."""
        return self._head[1]

    @property
    def dtype(self) -> np.dtype[np.void]:
        """The columns of its points."""
        return self._head[2]

    @property
    def lidars(self) -> tuple[str, ...]:
        """Names of the LiDARs, in the order of their numbers."""
        return self._head[3]

    def records(self, size: int | None = None) -> Iterator[Records]:
        """The points with all their columns, ``size`` (``CHUNK``) at a time."""
        size = size or CHUNK
        start, count, dtype, _ = self._head
        with self.path.open('rb') as file:
            file.seek(start)
            for first in range(0, count, size):
                yield np.fromfile(file, dtype=dtype, count=min(size, count - first))

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
        for records in self.records():
            for place, name in enumerate(names):
                made[start : start + len(records), place] = records[name]
            start += len(records)
        return made

    @cached_property
    def _head(self) -> tuple[int, int, np.dtype[np.void], tuple[str, ...]]:
        """Where the points begin, their number, their columns, and the names of the LiDARs."""
        with self.path.open('rb') as file:
            head, end, _ = file.read(1 << 16).partition(b'end_header\n')
        size = self.path.stat().st_size
        text = head.decode(errors='replace')
        count = re.search(r'^element vertex (\d+)$', text, flags=re.MULTILINE)
        fields = re.findall(r'^property (\w+) (\w+)$', text, flags=re.MULTILINE)
        names = re.findall(r'^comment lidar \d+ (.+)$', text, flags=re.MULTILINE)
        try:
            dtype: np.dtype[np.void] = np.dtype([(name, TYPES[kind]) for kind, name in fields])
        except (KeyError, ValueError):
            dtype = np.dtype([])
        start = len(head) + len(end)
        known = set(CLOUD_FIELDS[:3]) <= set(dtype.names or ())
        if not end or count is None or not known or size != start + int(count[1]) * dtype.itemsize:
            raise InputError(
                f'{self.path}: is damaged, or is no map that "incremental_mapper map" wrote'
            )
        return start, int(count[1]), dtype, tuple(names)
