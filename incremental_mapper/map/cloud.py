"""The accumulated map: scans at their poses, thinned to one voxel grid, and its PLY file."""

import os
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.voxels import voxel_means

CHUNK = 1_000_000
"""Points that are gathered before they are thinned."""
TILE = 64.0
"""Side, in metres, of the squares that a large map is thinned by, one after the other."""
MOST_THREADS = 4
"""Chunks that are thinned side by side; bounds the memory that they take."""

Placed: TypeAlias = tuple[NDArray[np.float32], NDArray[np.float64]]
"""A scan: points (N, 3) in base_link and T_map_base (4, 4)."""


def accumulate(scans: Iterable[Placed], voxel_size: float) -> NDArray[np.float32]:
    """Map points (N, 3) in metres of scans (points in base_link, T_map_base (4, 4)).

    The points are relative to nothing but the map's origin; as single precision they are exact
    to a millimetre within 8 km of it. They do not depend on the number of cores.
    """
    kept = np.zeros((3, 0), dtype=np.float32)
    waiting: list[NDArray[np.float32]] = []
    running: deque[Future[NDArray[np.float32]]] = deque()
    threads = min(os.cpu_count() or 1, MOST_THREADS)
    # NumPy lets go of Python's lock while it works on so many points.
    with ThreadPoolExecutor(threads, thread_name_prefix='map') as pool:
        for chunk in _chunks(scans):
            running.append(pool.submit(_place, chunk, voxel_size))
            if len(running) > threads:
                waiting.append(running.popleft().result())
            # All is thinned again only once it has doubled, so a long drive costs no square.
            if sum(rows.shape[1] for rows in waiting) > max(4 * CHUNK, kept.shape[1]):
                kept, waiting = _thin([kept, *waiting], voxel_size), []
        waiting += [future.result() for future in running]
    return np.ascontiguousarray(_thin([kept, *waiting], voxel_size).T)


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


def _place(scans: Iterable[Placed], voxel_size: float) -> NDArray[np.float32]:
    """Thinned rows (3, M) of scans in the map."""
    # Only the position is large: turned in single precision, a point is off by micrometres.
    placed = [
        (pose[:3, :3].astype(np.float32) @ points.T + pose[:3, 3:]).astype(np.float32)
        for points, pose in scans
    ]
    return _thin(placed, voxel_size)


def _thin(parts: list[NDArray[np.float32]], voxel_size: float) -> NDArray[np.float32]:
    """One mean point per voxel, rows (3, M), of ``parts``, rows (3, N) each."""
    rows = np.concatenate(parts, axis=1)
    count = rows.shape[1]
    if count == 0:
        return rows
    if count <= 4 * CHUNK:
        corner = np.floor(rows.mean(axis=1, dtype=np.float64) / voxel_size) * voxel_size
        return _sampled(rows, corner, voxel_size)
    # Tiles hold whole voxels and are sampled one after the other, which takes less memory.
    side = max(round(TILE / voxel_size), 1) * voxel_size
    tiles = np.floor(rows[:2] / side).astype(np.int64)
    order = np.lexsort(tiles[::-1])
    rows, tiles = rows[:, order], tiles[:, order]
    edges = np.flatnonzero(np.any(np.diff(tiles, axis=1) != 0, axis=0)) + 1
    thinned = []
    for low, high in zip([0, *edges], [*edges, count], strict=True):
        corner = np.append(tiles[:, low] * side, 0.0)
        thinned.append(_sampled(rows[:, low:high], corner, voxel_size))
    return np.concatenate(thinned, axis=1)


def _sampled(
    rows: NDArray[np.float32], corner: NDArray[np.float64], voxel_size: float
) -> NDArray[np.float32]:
    """Mean points (3, M) of the voxels of a grid through ``corner`` (3,), metres."""
    means = voxel_means(rows - corner[:, None], voxel_size)
    means += corner[:, None]
    return means.astype(np.float32)


def write_ply(path: Path, points: NDArray[np.floating]) -> None:
    """Write points (N, 3) as a binary PLY with float vertices."""
    header = (
        'ply\nformat binary_little_endian 1.0\n'
        'comment frame map, metres\n'
        f'element vertex {len(points)}\n'
        'property float x\nproperty float y\nproperty float z\nend_header\n'
    )
    with path.open('wb') as file:
        file.write(header.encode('ascii'))
        file.write(np.ascontiguousarray(points, dtype='<f4').tobytes())
