"""Mean points of voxels, for many points at a time: a hash table, compiled.

``voxels`` does it for one scan in the LiDARs' processes, which start the sooner without a compiler.
"""

from collections.abc import Iterable
from math import floor

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.compiled import kernel

FURTHEST = 2.0e9
"""Voxels from the corner beyond which 32 bits do not tell them apart."""


def mean_points(
    placed: Iterable[tuple[NDArray[np.float32], NDArray[np.float64]]],
    most: int,
    corner: NDArray[np.float64],
    voxel_size: float,
    max_range: float = np.inf,
) -> NDArray[np.float32]:
    """One mean point per voxel, (M, 3), of points (N, 3) that their transforms (4, 4) place.

    Voxels are those of a grid through ``corner`` (3,), metres, and come in the order of their
    first points. There are ``most`` points in all, or fewer. Points that are not finite, or are
    more than ``max_range`` metres from where their scan has its origin, are left out.
    """
    # At least half of the slots stay free, so that few are asked for one point.
    table = np.full(1 << (2 * max(most, 1) - 1).bit_length(), -1, dtype=np.int32)
    # A voxel's numbers lie side by side: what takes time is fetching them from memory.
    cells = np.empty((most, 8), dtype=np.int32)
    sums = cells.view(np.float32)
    limits, used = (max_range * max_range, voxel_size), 0
    for points, transform in placed:
        rows, columns = transform[:3].copy(), np.ascontiguousarray(points, dtype=np.float32)
        used = _add(columns, rows, corner, limits, table, cells, sums, used)
    return _means(cells[:used], sums[:used], corner, voxel_size)


@kernel
def _means(
    cells: NDArray[np.int32],
    sums: NDArray[np.float32],
    corner: NDArray[np.float64],
    size: float,
) -> NDArray[np.float32]:
    """Mean points (M, 3) of voxels, see _add."""
    means = np.empty((len(cells), 3), dtype=np.float32)
    for i in range(len(cells)):
        for k in range(3):
            means[i, k] = corner[k] + size * cells[i, k] + sums[i, 4 + k] / sums[i, 7]
    return means


@kernel
def _add(
    points: NDArray[np.float32],
    transform: NDArray[np.float64],
    corner: NDArray[np.float64],
    limits: tuple[float, float],
    table: NDArray[np.int32],
    cells: NDArray[np.int32],
    sums: NDArray[np.float32],
    used: int,
) -> int:
    """Add ``points`` (N, 3) to the sums of their voxels.

    ``limits`` are the square of the range, and the size of a voxel. ``cells`` (M, 8) begin with
    the place of a voxel in the grid; ``sums`` (M, 8), the same memory, end with the sum of its
    points, from its own corner, and their number. ``table`` says where a voxel stands, -1 for
    nowhere; ``used`` of them are taken, and how many there are afterwards is returned.
    """
    mask = np.uint64(len(table) - 1)
    t, (furthest, size) = transform, limits
    scale = 1.0 / size
    for i in range(len(points)):
        u, v, w = float(points[i, 0]), float(points[i, 1]), float(points[i, 2])
        x = t[0, 0] * u + t[0, 1] * v + t[0, 2] * w + (t[0, 3] - corner[0])
        y = t[1, 0] * u + t[1, 1] * v + t[1, 2] * w + (t[1, 3] - corner[1])
        z = t[2, 0] * u + t[2, 1] * v + t[2, 2] * w + (t[2, 3] - corner[2])
        a, b, c = floor(x * scale), floor(y * scale), floor(z * scale)
        within = u * u + v * v + w * w <= furthest
        if not (within and abs(a) + abs(b) + abs(c) < FURTHEST):  # NaN is not
            continue
        p, q, r = np.int32(a), np.int32(b), np.int32(c)
        # Neighbours end up far from each other: odd factors, and the upper bits count.
        mixed = np.uint64(p) * np.uint64(0x9E3779B97F4A7C15)
        mixed += np.uint64(q) * np.uint64(0xC2B2AE3D27D4EB4F)
        mixed += np.uint64(r) * np.uint64(0x165667B19E3779F9)
        mixed = (mixed ^ (mixed >> np.uint64(32))) * np.uint64(0x9E3779B97F4A7C15)
        slot = (mixed >> np.uint64(32)) & mask
        while True:
            place = table[slot]
            if place < 0:
                place = used
                table[slot] = place
                cells[place, 0], cells[place, 1], cells[place, 2] = p, q, r
                for k in range(4, 8):
                    sums[place, k] = 0.0
                used += 1
                break
            if cells[place, 0] == p and cells[place, 1] == q and cells[place, 2] == r:
                break
            slot = (slot + np.uint64(1)) & mask
        sums[place, 4] += x - a * size
        sums[place, 5] += y - b * size
        sums[place, 6] += z - c * size
        sums[place, 7] += 1.0
    return used
