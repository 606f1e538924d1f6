"""Thinning the points of one scan to a voxel grid.

Coordinates are kept in rows, (3, N), as the front end keeps them.
"""

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.compiled import kernel

SLOTS = 2
"""A hash table has at least so many slots for each point."""
OUTERMOST = 4e18
"""Number of the last voxel in every direction."""


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
    count = rows.shape[1]
    if count == 0:
        return np.zeros(rows.shape)
    dense = np.ascontiguousarray(rows)
    return _means(dense, dense.dtype.type(1.0 / voxel_size))


@kernel
def _means(rows: NDArray[np.floating], inverse: float) -> NDArray[np.float64]:
    """See voxel_means; ``inverse`` is 1 / voxel_size in the precision of the rows."""
    channels, count = rows.shape
    size = 2
    while size < SLOTS * count:
        size *= 2
    table = np.full(size, -1, dtype=np.int32)  # the voxel in each slot
    cells = np.empty((count, 3), dtype=np.int64)
    sums = np.empty((count, channels + 1))  # of each voxel; the number of its columns comes last
    last = np.empty(count, dtype=np.int32)
    own = np.empty(count, dtype=np.int32)  # the voxel of each column
    voxels = 0
    for i in range(count):
        # What is absurdly far off shares the outermost voxel.
        x = np.int64(min(max(np.floor(rows[0, i] * inverse), -OUTERMOST), OUTERMOST))
        y = np.int64(min(max(np.floor(rows[1, i] * inverse), -OUTERMOST), OUTERMOST))
        z = np.int64(min(max(np.floor(rows[2, i] * inverse), -OUTERMOST), OUTERMOST))
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
            voxel = np.int32(voxels)
            voxels += 1
            table[slot] = voxel
            cells[voxel, 0], cells[voxel, 1], cells[voxel, 2] = x, y, z
            sums[voxel] = 0.0
        for k in range(channels):
            sums[voxel, k] += rows[k, i]
        sums[voxel, channels] += 1.0
        last[voxel], own[i] = i, voxel
    means = np.empty((channels, voxels))
    column = 0
    for i in range(count):
        if last[own[i]] == i:
            for k in range(channels):
                means[k, column] = sums[own[i], k] / sums[own[i], channels]
            column += 1
    return means
