"""Mean points of voxels, for many points at a time: a hash table, compiled."""

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
    cells, sums = np.empty((most, 3), dtype=np.int32), np.zeros((most, 4))
    used = 0
    for points, transform in placed:
        rows, columns = transform[:3].copy(), np.ascontiguousarray(points, dtype=np.float32)
        limits = max_range * max_range, 1.0 / voxel_size
        used = _add(columns, rows, corner, limits, table, cells, sums, used)
    means = sums[:used, :3] / sums[:used, 3:]
    means += corner
    return means.astype(np.float32)


@kernel
def _add(
    points: NDArray[np.float32],
    transform: NDArray[np.float64],
    corner: NDArray[np.float64],
    limits: tuple[float, float],
    table: NDArray[np.int32],
    cells: NDArray[np.int32],
    sums: NDArray[np.float64],
    used: int,
) -> int:
    """Add ``points`` (N, 3) to the sums and counts (M, 4) of their ``cells`` (M, 3).

    ``limits`` are the square of the range and one over the size of a voxel.
    ``table`` says where a cell stands, -1 for nowhere; ``used`` of the cells are taken, and how
    many there are afterwards is returned.
    """
    mask = np.uint64(len(table) - 1)
    t, (furthest, scale) = transform, limits
    for i in range(len(points)):
        u, v, w = float(points[i, 0]), float(points[i, 1]), float(points[i, 2])
        x = t[0, 0] * u + t[0, 1] * v + t[0, 2] * w + (t[0, 3] - corner[0])
        y = t[1, 0] * u + t[1, 1] * v + t[1, 2] * w + (t[1, 3] - corner[1])
        z = t[2, 0] * u + t[2, 1] * v + t[2, 2] * w + (t[2, 3] - corner[2])
        a, b, c = x * scale, y * scale, z * scale
        within = u * u + v * v + w * w <= furthest
        if not (within and abs(a) + abs(b) + abs(c) < FURTHEST):  # NaN is not
            continue
        p, q, r = np.int32(floor(a)), np.int32(floor(b)), np.int32(floor(c))
        # Neighbours end up far from each other: odd factors, and the upper bits count.
        mixed = np.uint64(p) * np.uint64(0x9E3779B97F4A7C15)
        mixed ^= np.uint64(q) * np.uint64(0xC2B2AE3D27D4EB4F)
        mixed ^= np.uint64(r) * np.uint64(0x165667B19E3779F9)
        slot = (mixed ^ (mixed >> np.uint64(29))) & mask
        while True:
            place = table[slot]
            if place < 0:
                place = used
                table[slot] = place
                cells[place, 0], cells[place, 1], cells[place, 2] = p, q, r
                used += 1
                break
            if cells[place, 0] == p and cells[place, 1] == q and cells[place, 2] == r:
                break
            slot = (slot + np.uint64(1)) & mask
        sums[place, 0] += x
        sums[place, 1] += y
        sums[place, 2] += z
        sums[place, 3] += 1.0
    return used
