"""The accumulated map: scans at their poses, thinned to one voxel grid, and its PLY file."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import small_gicp
from numpy.typing import NDArray

from incremental_mapper.geometry import transform_points

CHUNK = 2_000_000
"""Points that are gathered before they are thinned; bounds the memory of a long drive."""


def accumulate(
    scans: Iterable[tuple[NDArray[np.float32], NDArray[np.float64]]], voxel_size: float
) -> NDArray[np.float64]:
    """Map points (N, 3) in metres of scans (points in base_link, T_map_base (4, 4))."""
    kept = np.zeros((0, 3))
    waiting: list[NDArray[np.float64]] = []
    size = 0
    for points, pose in scans:
        moved = transform_points(pose, points.astype(np.float64))
        waiting.append(moved)
        size += len(moved)
        if size > CHUNK:
            kept, waiting, size = _thin([kept, *waiting], voxel_size), [], 0
    return _thin([kept, *waiting], voxel_size)


def _thin(parts: list[NDArray[np.float64]], voxel_size: float) -> NDArray[np.float64]:
    points = np.vstack(parts)
    if len(points) == 0:
        return points
    # The grid of the sampler holds 21 bits an axis; a map around its own start stays inside.
    origin = np.floor(points.mean(axis=0))
    thinned = small_gicp.voxelgrid_sampling(points - origin, voxel_size).points()[:, :3]
    placed: NDArray[np.float64] = thinned + origin
    return placed


def write_ply(path: Path, points: NDArray[np.float64]) -> None:
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
