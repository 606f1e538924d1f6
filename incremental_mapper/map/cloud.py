"""The accumulated map: scans at their poses, thinned to one voxel grid.

Points are (N, 3), x, y, z, or (N, 4) with the intensity. A map has intensities where any of its
scans has them; a voxel that only scans without them saw has 0.
"""

import os
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.map.voxel_grid import mean_points

CHUNK = 2_000_000
"""Points that are gathered before they are thinned."""
TILE = 64.0
"""Side, in metres, of the squares that a large map is thinned by, one after the other."""
CLOUD_FIELDS = ('x', 'y', 'z', 'intensity')
"""What the columns of a cloud are called, in files and messages."""
MOST_THREADS = 4
"""Chunks that are thinned side by side; bounds the memory that they take."""

Placed: TypeAlias = tuple[NDArray[np.float32], NDArray[np.float64], int]
"""A scan: points (N, 3 or 4) in base_link, T_map_base (4, 4), and the number of the scan."""
Thinned: TypeAlias = tuple[NDArray[np.float32], NDArray[np.int32]]
"""Points (M, 3 or 4) in the map, and the number of the scan that saw each voxel first (M,)."""


def accumulate(scans: Iterable[Placed], voxel_size: float, max_range: float = np.inf) -> Thinned:
    """Make the map of scans at their poses.

    Args:
        scans: points (N, 3 or 4) in base_link, metres, T_map_base (4, 4), and the number of each.
        voxel_size: side of a voxel, metres.
        max_range: points further than this many metres from their base_link are left out.

    Returns:
        One mean point a voxel, (M, 3 or 4), metres in the map; single precision is exact to a
        millimetre within 8 km of its origin. They do not depend on the number of cores. With them
        the numbers (M,) of the scans that saw a voxel first, in the order of ``scans``.

    Raises:
        OutputError: points that are kept on disk can no longer be read.
    """
    kept: Thinned = (np.zeros((0, 3), dtype=np.float32), np.zeros(0, dtype=np.int32))
    waiting: list[Thinned] = []
    running: deque[Future[Thinned]] = deque()
    threads = min(os.cpu_count() or 1, MOST_THREADS)
    # Compiled code runs without Python's lock.
    with ThreadPoolExecutor(threads, thread_name_prefix='map') as pool:
        for chunk in _chunks(scans):
            running.append(pool.submit(_place, chunk, voxel_size, max_range))
            if len(running) > threads:
                waiting.append(running.popleft().result())
            # All is thinned again only once it has doubled, so a long drive costs no square.
            if sum(len(points) for points, _ in waiting) > max(2 * CHUNK, len(kept[0])):
                kept, waiting = _thin([kept, *waiting], voxel_size), []
        waiting += [future.result() for future in running]
    points, numbers = _thin([kept, *waiting], voxel_size)
    return with_known_light(points), numbers


def _chunks(scans: Iterable[Placed]) -> Iterator[list[Placed]]:
    """The scans in lists of about CHUNK points."""
    chunk: list[Placed] = []
    size = 0
    for scan in scans:
        chunk.append(scan)
        size += len(scan[0])
        if size > CHUNK:
            yield chunk
            chunk, size = [], 0
    if chunk:
        yield chunk


def _place(scans: Sequence[Placed], voxel_size: float, max_range: float) -> Thinned:
    """Thinned points of scans in the map."""
    corner = np.floor(scans[0][1][:3, 3] / voxel_size) * voxel_size
    most = sum(len(points) for points, _, _ in scans)
    marked = (
        (points, pose, np.full(len(points), number, dtype=np.int32))
        for points, pose, number in scans
    )
    return mean_points(marked, most, corner, voxel_size, max_range)


def _thin(parts: Sequence[Thinned], voxel_size: float) -> Thinned:
    """One mean point per voxel of ``parts``."""
    points = joined([part for part, _ in parts])
    marks = np.concatenate([marks for _, marks in parts])
    if len(points) <= 2 * CHUNK:
        return mean_points([(points, np.eye(4), marks)], len(points), np.zeros(3), voxel_size)
    # Tiles hold whole voxels and are thinned one after the other, which takes less memory.
    side = max(round(TILE / voxel_size), 1) * voxel_size
    tiles = np.floor(points[:, :2] / side).astype(np.int32)
    order = np.lexsort(tiles.T)
    points, tiles, marks = points[order], tiles[order], marks[order]
    edges = np.flatnonzero(np.any(np.diff(tiles, axis=0) != 0, axis=1)) + 1
    thinned = []
    for low, high in zip([0, *edges], [*edges, len(points)], strict=True):
        part = [(points[low:high], np.eye(4), marks[low:high])]
        corner = np.append(tiles[low] * side, 0.0)
        thinned.append(mean_points(part, int(high - low), corner, voxel_size))
    return np.concatenate([part for part, _ in thinned]), np.concatenate([m for _, m in thinned])


def joined(parts: Sequence[NDArray[np.floating]]) -> NDArray[Any]:
    """Points of several clouds, with intensity where any of them has it.

    Args:
        parts: (N, 3 or 4) each, at least one.

    Returns:
        All of them, (M, 3 or 4); the intensity of those that have none is NaN.
    """
    most = max(part.shape[1] for part in parts)
    return np.concatenate([_widened(part, most) for part in parts])


def _widened(points: NDArray[np.floating], columns: int) -> NDArray[np.floating]:
    missing = columns - points.shape[1]
    return np.pad(points, ((0, 0), (0, missing)), constant_values=np.nan) if missing else points


def with_known_light(points: NDArray[Any]) -> NDArray[Any]:
    """Points (N, 3 or 4) for a file or a message: an intensity that nobody knows becomes 0.

    Args:
        points: They are changed, and handed back.
    """
    if points.shape[1] == 4:
        light = points[:, 3]
        light[np.isnan(light)] = 0.0
    return points
