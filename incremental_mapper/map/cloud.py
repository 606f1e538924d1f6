"""The accumulated map: scans at their poses, thinned to one voxel grid, and its PLY file."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import small_gicp
from numpy.typing import NDArray

from incremental_mapper.geometry import transform_points

CHUNK = 2_000_000
"""Points that are gathered before they are thinned; bounds the memory of a long drive."""
TILE = 64.0
"""Side, in metres, of the squares that a large map is thinned by, one after the other."""


def accumulate(
    scans: Iterable[tuple[NDArray[np.float32], NDArray[np.float64]]], voxel_size: float
) -> NDArray[np.float32]:
    """Map points (N, 3) in metres of scans (points in base_link, T_map_base (4, 4)).

    The points are relative to nothing but the map's origin; as single precision they are exact
    to a millimetre within 8 km of it.
    """
    kept = np.zeros((0, 3), dtype=np.float32)
    waiting: list[NDArray[np.float32]] = []
    size = 0
    for points, pose in scans:
        waiting.append(transform_points(pose, points.astype(np.float64)).astype(np.float32))
        size += len(points)
        # Everything is thinned again only once it has doubled, so a long drive costs no square.
        if size > max(CHUNK, len(kept)):
            kept, waiting, size = _thin([kept, *waiting], voxel_size), [], 0
    return _thin([kept, *waiting], voxel_size)


def _thin(parts: list[NDArray[np.float32]], voxel_size: float) -> NDArray[np.float32]:
    points = np.concatenate(parts)
    if len(points) == 0:
        return points
    if len(points) <= 4 * CHUNK:
        corner = np.floor(points.mean(axis=0, dtype=np.float64) / voxel_size) * voxel_size
        return _sampled(points, corner, voxel_size)
    # Tiles hold whole voxels, and each is sampled around its own corner: the sampler works in
    # double precision on a grid of 21 bits an axis, which a whole drive would not fit into.
    side = max(round(TILE / voxel_size), 1) * voxel_size
    tiles = np.floor(points[:, :2] / side).astype(np.int64)
    order = np.lexsort((tiles[:, 1], tiles[:, 0]))
    points, tiles = points[order], tiles[order]
    edges = np.flatnonzero(np.any(np.diff(tiles, axis=0) != 0, axis=1)) + 1
    thinned = []
    for low, high in zip([0, *edges], [*edges, len(points)], strict=True):
        corner = np.append(tiles[low] * side, 0.0)
        thinned.append(_sampled(points[low:high], corner, voxel_size))
    return np.concatenate(thinned)


def _sampled(
    points: NDArray[np.float32], corner: NDArray[np.float64], voxel_size: float
) -> NDArray[np.float32]:
    sampled = small_gicp.voxelgrid_sampling(points - corner, voxel_size).points()
    placed: NDArray[np.float32] = (sampled[:, :3] + corner).astype(np.float32)
    return placed


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
