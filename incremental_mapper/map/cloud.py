"""The accumulated map: scans at their poses, thinned to one voxel grid, and its PLY file.

Points are (N, 3), x, y, z, or (N, 4) with the intensity. A map has intensities where any of its
scans has them; a voxel that only scans without them saw has 0.
"""

import os
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
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

Placed: TypeAlias = tuple[NDArray[np.float32], NDArray[np.float64]]
"""A scan: points (N, 3 or 4) in base_link and T_map_base (4, 4)."""


def accumulate(
    scans: Iterable[Placed], voxel_size: float, max_range: float = np.inf
) -> NDArray[np.float32]:
    """Make the map of scans at their poses.

    Args:
        scans: points (N, 3 or 4) in base_link, metres, and T_map_base (4, 4) of each.
        voxel_size: side of a voxel, metres.
        max_range: points further than this many metres from their base_link are left out.

    Returns:
        One mean point a voxel, (M, 3 or 4), metres in the map; single precision is exact to a
        millimetre within 8 km of its origin. They do not depend on the number of cores.

    Raises:
        OutputError: points that are kept on disk can no longer be read.
    """
    kept = np.zeros((0, 3), dtype=np.float32)
    waiting: list[NDArray[np.float32]] = []
    running: deque[Future[NDArray[np.float32]]] = deque()
    threads = min(os.cpu_count() or 1, MOST_THREADS)
    # Compiled code runs without Python's lock.
    with ThreadPoolExecutor(threads, thread_name_prefix='map') as pool:
        for chunk in _chunks(scans):
            running.append(pool.submit(_place, chunk, voxel_size, max_range))
            if len(running) > threads:
                waiting.append(running.popleft().result())
            # All is thinned again only once it has doubled, so a long drive costs no square.
            if sum(map(len, waiting)) > max(2 * CHUNK, len(kept)):
                kept, waiting = _thin([kept, *waiting], voxel_size), []
        waiting += [future.result() for future in running]
    return with_known_light(_thin([kept, *waiting], voxel_size))


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


def _place(scans: Sequence[Placed], voxel_size: float, max_range: float) -> NDArray[np.float32]:
    """Thinned points (M, 3 or 4) of scans in the map."""
    corner = np.floor(scans[0][1][:3, 3] / voxel_size) * voxel_size
    most = sum(len(points) for points, _ in scans)
    return mean_points(scans, most, corner, voxel_size, max_range)


def _thin(parts: list[NDArray[np.float32]], voxel_size: float) -> NDArray[np.float32]:
    """One mean point per voxel, (M, 3 or 4), of ``parts``, (N, 3 or 4) each."""
    points = joined(parts)
    if len(points) <= 2 * CHUNK:
        return mean_points([(points, np.eye(4))], len(points), np.zeros(3), voxel_size)
    # Tiles hold whole voxels and are thinned one after the other, which takes less memory.
    side = max(round(TILE / voxel_size), 1) * voxel_size
    tiles = np.floor(points[:, :2] / side).astype(np.int32)
    order = np.lexsort(tiles.T)
    points, tiles = points[order], tiles[order]
    edges = np.flatnonzero(np.any(np.diff(tiles, axis=0) != 0, axis=1)) + 1
    thinned = []
    for low, high in zip([0, *edges], [*edges, len(points)], strict=True):
        part = [(points[low:high], np.eye(4))]
        corner = np.append(tiles[low] * side, 0.0)
        thinned.append(mean_points(part, int(high - low), corner, voxel_size))
    return np.concatenate(thinned)


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


def write_ply(path: Path, points: NDArray[np.floating]) -> None:
    """Write points as a binary PLY with float vertices.

    Args:
        path: the file to write; what it held is lost.
        points: (N, 3), metres in the map, or (N, 4) with intensity.

    Raises:
        OSError: the file cannot be written.
    """
    header = (
        'ply\nformat binary_little_endian 1.0\n'
        'comment frame map, metres\n'
        f'element vertex {len(points)}\n'
        + ''.join(f'property float {name}\n' for name in CLOUD_FIELDS[: points.shape[1]])
        + 'end_header\n'
    )
    with path.open('wb') as file:
        file.write(header.encode('ascii'))
        file.write(np.ascontiguousarray(points, dtype='<f4').tobytes())
