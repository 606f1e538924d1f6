"""Thinning the points of one scan to a voxel grid.

By hand in NumPy, not with ``map.voxel_grid``: the LiDARs' processes thin their scans too, and would
start most of a second later with a compiler. Coordinates are kept in rows, (3, N), where that is
quicker.
"""

import numpy as np
from numpy.typing import NDArray

TABLE_BITS = 2
"""A hash table has so many more bits than the count of its numbers: more than 4 slots each."""
GOLDEN = 0x9E3779B97F4A7C15
"""2^64 divided by the golden ratio; its upper half is 2^32 divided by it."""


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
    last = _last_mates(np.floor(rows[:3] * rows.dtype.type(1.0 / voxel_size)))
    kept = np.flatnonzero(last == np.arange(count))
    means = np.empty((len(rows), len(kept)))
    for row, mean in zip(rows, means, strict=True):
        mean[:] = np.bincount(last, weights=row, minlength=count).take(kept)
    means /= np.bincount(last, minlength=count).take(kept)
    return means


def _last_mates(cells: NDArray[np.floating]) -> NDArray[np.intp]:
    """For every column of ``cells`` (3, N), the last column that is equal to it, (N,)."""
    cells = cells - cells.min(axis=1, keepdims=True)
    sizes = cells.max(axis=1).astype(np.float64) + 1.0
    voxels = sizes.prod()
    if voxels < 2.0**53:  # a float counts exactly up to there
        kind = np.uint32 if voxels < 2.0**32 else np.uint64
        numbers, y, z = cells.astype(kind)
        numbers *= kind(sizes[1])
        numbers += y
        numbers *= kind(sizes[2])
        numbers += z
        return _last_equals(numbers)
    order = np.lexsort(cells[::-1])
    cells = cells[:, order]
    ends = np.append((cells[:, 1:] != cells[:, :-1]).any(axis=0), True)
    last = np.empty_like(order)
    last[order] = order[ends][np.cumsum(ends) - ends]
    return last


def _last_equals(numbers: NDArray[np.uint32] | NDArray[np.uint64]) -> NDArray[np.intp]:
    """For each of ``numbers`` (N,), the index of the last one that is equal to it, (N,).

    A hash table, several times as large as there are numbers: faster than sorting them.
    """
    count, width = len(numbers), numbers.dtype.itemsize * 8
    bits = count.bit_length() + TABLE_BITS
    # Multiplying by the golden ratio spreads neighbours over the upper bits.
    slots = numbers * numbers.dtype.type(GOLDEN >> (64 - width))
    slots >>= numbers.dtype.type(width - bits)
    places = slots.astype(np.intp)
    table = np.empty(1 << bits, dtype=np.int32)
    table[places] = np.arange(count, dtype=np.int32)  # the last of a slot stays
    last = table.take(places).astype(np.intp)
    # Where other numbers have taken the slot, the remaining ones try again among themselves.
    lost = np.flatnonzero(numbers.take(last) != numbers)
    while len(lost) > 0:
        table[places[lost]] = lost
        last[lost] = table[places[lost]]
        lost = lost[numbers[last[lost]] != numbers[lost]]
    return last
