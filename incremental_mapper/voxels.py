"""Thinning the points of one scan to a voxel grid.

Coordinates are kept in rows, (3, N), as the front end keeps them.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.compiled import kernel

SLOTS = 2
"""A hash table has at least so many slots for each point."""
ROOM = 8192
"""Voxels that there is room for at first; where there are more, it is doubled."""
OUTERMOST = 4e18
"""Number of the last voxel in every direction."""
_AS_THEY_ARE = np.zeros((0, 4))


def thin(points: NDArray[np.float64], voxel_size: float) -> NDArray[np.float64]:
    """Keep one mean point per voxel.

    Args:
        points: (N, 3), metres.
        voxel_size: side of a voxel, metres.

    Returns:
        Points (M, 3), metres, in the order of the voxels' last points.
    """
    return np.ascontiguousarray(voxel_means(points.T, voxel_size).T)


def voxel_means(rows: NDArray[np.floating], voxel_size: float) -> NDArray[np.float64]:
    """Average points, and what else is known of them, voxel by voxel.

    Args:
        rows: (C, N); the first three rows are x, y, z in metres, the others are averaged along.
        voxel_size: side of a voxel, metres.

    Returns:
        Means (C, M) over the columns that fall into the same voxel, in the order of the voxels'
        last columns.
    """
    if rows.shape[1] == 0:
        return np.zeros(rows.shape)
    dense = np.ascontiguousarray(rows)
    inverse = dense.dtype.type(1.0 / voxel_size)
    return _means(dense[:3], dense[3:], _AS_THEY_ARE.astype(dense.dtype), 0.0, 0.0, inverse)


def means_within(
    points: NDArray[np.float32],
    further: NDArray[np.float32],
    matrix: NDArray[np.float32],
    ranges: tuple[float, float],
    voxel_size: float,
) -> NDArray[np.float64]:
    """Move the points within range and average them, and what else is known of them, by voxels.

    Args:
        points: (N, 3), metres.
        further: (K, N), what is averaged along.
        matrix: T_target_source (4, 4), from the frame of the points to that of the voxels.
        ranges: the least and the largest distance from the origin of the points, metres.
        voxel_size: side of a voxel, metres.

    Returns:
        As ``voxel_means`` (3 + K, M).
    """
    nearest, furthest = float(ranges[0]) ** 2, float(ranges[1]) ** 2
    dense = np.ascontiguousarray(points)
    return _means(dense.T, further, matrix, nearest, furthest, np.float32(1.0 / voxel_size))


@kernel
def _longer(values: NDArray[Any]) -> NDArray[Any]:
    """An array with twice the room, that begins alike."""
    longer = np.empty((2 * len(values), *values.shape[1:]), dtype=values.dtype)
    longer[: len(values)] = values
    return longer


@kernel
def _means(
    rows: NDArray[np.floating],
    further: NDArray[np.floating],
    matrix: NDArray[np.floating],
    nearest: float,
    furthest: float,
    inverse: np.floating,
) -> NDArray[np.float64]:
    """See means_within: rows (3, N), squares of ranges, 1 / voxel_size in the rows' precision.

    Without a matrix all points stay, and where they are.
    """
    count, channels = rows.shape[1], 3 + len(further)
    size = 2
    while size < SLOTS * count:
        size *= 2
    table = np.full(size, -1, dtype=np.int32)  # the voxel in each slot
    cells = np.empty((min(ROOM, count), 3), dtype=np.int64)
    sums = np.empty((len(cells), channels + 1))  # of each voxel; last the number of its columns
    last = np.empty(len(cells), dtype=np.int32)
    own = np.empty(count, dtype=np.int32)  # the voxel of each column, -1 without
    seen, voxels = 0, 0
    while True:
        seen, voxels = _sum_up(
            rows, further, matrix, nearest, furthest, inverse,
            table, cells, sums, last, own, seen, voxels,
        )  # fmt: skip
        if seen == count:
            break
        cells, sums, last = _longer(cells), _longer(sums), _longer(last)
    means = np.empty((channels, voxels))
    column = 0
    for i in range(count):
        if own[i] >= 0 and last[own[i]] == i:
            for k in range(channels):
                means[k, column] = sums[own[i], k] / sums[own[i], channels]
            column += 1
    return means


@kernel
def _sum_up(
    rows: NDArray[np.floating],
    further: NDArray[np.floating],
    matrix: NDArray[np.floating],
    nearest: float,
    furthest: float,
    inverse: np.floating,
    table: NDArray[np.int32],
    cells: NDArray[np.int64],
    sums: NDArray[np.float64],
    last: NDArray[np.int32],
    own: NDArray[np.int32],
    seen: int,
    voxels: int,
) -> tuple[int, int]:
    """Go on at column ``seen`` while there is room for voxels: how many columns and voxels then."""
    channels, size = 3 + len(further), len(table)
    moves = len(matrix) > 0
    for i in range(seen, rows.shape[1]):
        px, py, pz = rows[0, i], rows[1, i], rows[2, i]
        if moves:
            if not nearest <= px * px + py * py + pz * pz <= furthest:
                own[i] = -1
                continue
            tx = matrix[0, 0] * px + matrix[0, 1] * py + matrix[0, 2] * pz + matrix[0, 3]
            ty = matrix[1, 0] * px + matrix[1, 1] * py + matrix[1, 2] * pz + matrix[1, 3]
            tz = matrix[2, 0] * px + matrix[2, 1] * py + matrix[2, 2] * pz + matrix[2, 3]
            px, py, pz = tx, ty, tz
        # What is absurdly far off shares the outermost voxel.
        x = np.int64(min(max(np.floor(px * inverse), -OUTERMOST), OUTERMOST))
        y = np.int64(min(max(np.floor(py * inverse), -OUTERMOST), OUTERMOST))
        z = np.int64(min(max(np.floor(pz * inverse), -OUTERMOST), OUTERMOST))
        # Large primes, as others hash voxels too (Teschner and others, VMV 2003).
        mixed = np.uint64(x) * np.uint64(73856093)
        mixed ^= np.uint64(y) * np.uint64(19349669)
        mixed ^= np.uint64(z) * np.uint64(83492791)
        slot = np.int64(mixed & np.uint64(size - 1))
        voxel = table[slot]
        while voxel >= 0 and (cells[voxel, 0] != x or cells[voxel, 1] != y or cells[voxel, 2] != z):
            slot = (slot + 1) & (size - 1)
            voxel = table[slot]
        if voxel < 0:
            if voxels == len(cells):
                return i, voxels
            voxel = np.int32(voxels)
            voxels += 1
            table[slot] = voxel
            cells[voxel, 0], cells[voxel, 1], cells[voxel, 2] = x, y, z
            sums[voxel] = 0.0
        sums[voxel, 0] += px
        sums[voxel, 1] += py
        sums[voxel, 2] += pz
        for k in range(len(further)):
            sums[voxel, 3 + k] += further[k, i]
        sums[voxel, channels] += 1.0
        last[voxel], own[i] = i, voxel
    return rows.shape[1], voxels
