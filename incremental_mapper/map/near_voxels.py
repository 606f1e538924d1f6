"""The voxels of a grid that are around a place in the plane: those that are far off cost nothing.

Voxels stay where they came, and those of a drive that came one after the other lie together: a box
about each stretch of them tells what need not be looked at.
"""

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.compiled import kernel

STRETCH = 4096
"""Voxels, in their order, of which one box tells where they are."""
RINGS = 4096
"""Rings of equal area around a place, in which voxels are counted to find the nearest."""


def means_near(
    cells: NDArray[np.int32],
    boxes: NDArray[np.int32],
    middle: NDArray[np.float64],
    limit: float,
    most: int,
    corner: NDArray[np.float64],
    size: float,
    columns: int,
) -> NDArray[np.float32]:
    """Mean points of the voxels around a place.

    Args:
        cells: the voxels (N, 8) of a grid: place, sum of intensities, sums of points, number.
        boxes: extents (B, 4) of the stretches that are full, see ``enclose``.
        middle: x, y of the place, voxels from the grid's corner.
        limit: voxels in the plane beyond which others are left out; infinity for no limit.
        most: upper limit of their number; where there are more, the nearest are taken.
        corner: where the grid's corner lies, (3,), metres.
        size: side of a voxel, metres.
        columns: 4 where points have intensities, else 3.

    Returns:
        Points (M, columns), metres, in the order in which the voxels came.
    """
    if not np.isfinite(limit):
        limit = _furthest(cells, boxes, middle)
    rings = _count_rings(cells, boxes, middle, limit)
    within = np.cumsum(rings)
    kept = int(np.searchsorted(within, most, side='right'))  # whole rings only
    count = int(within[kept - 1]) if kept > 0 else 0
    around = middle, limit, kept
    found: NDArray[np.float32] = _means_near(
        cells, cells.view(np.float32), boxes, around, count, corner, size, columns
    )
    return found


@kernel
def enclose(cells: NDArray[np.int32], boxes: NDArray[np.int32], first: int, after: int) -> None:
    """Fill boxes (B, 4), smallest and largest x, then y, of stretches ``first`` to ``after``."""
    for box in range(first, after):
        start = box * STRETCH
        boxes[box, 0] = boxes[box, 1] = cells[start, 0]
        boxes[box, 2] = boxes[box, 3] = cells[start, 1]
        for i in range(start, start + STRETCH):
            boxes[box, 0] = min(boxes[box, 0], cells[i, 0])
            boxes[box, 1] = max(boxes[box, 1], cells[i, 0])
            boxes[box, 2] = min(boxes[box, 2], cells[i, 1])
            boxes[box, 3] = max(boxes[box, 3], cells[i, 1])


@kernel
def _square(cell: NDArray[np.int32], middle: NDArray[np.float64]) -> float:
    """Square of the distance of a voxel from ``middle`` in the plane, voxels."""
    x, y = cell[0] + 0.5 - middle[0], cell[1] + 0.5 - middle[1]
    return float(x * x + y * y)


@kernel
def _far_off(boxes: NDArray[np.int32], box: int, middle: NDArray[np.float64], limit: float) -> bool:
    """Whether nothing in a box is within ``limit`` voxels; no box, no answer."""
    if box >= len(boxes):
        return False
    x = max(boxes[box, 0] - middle[0], middle[0] - boxes[box, 1] - 1.0, 0.0)
    y = max(boxes[box, 2] - middle[1], middle[1] - boxes[box, 3] - 1.0, 0.0)
    return bool(x * x + y * y > limit * limit)


@kernel
def _furthest(
    cells: NDArray[np.int32], boxes: NDArray[np.int32], middle: NDArray[np.float64]
) -> float:
    """Distance, in voxels, within which all voxels are."""
    square = 1.0
    for box in range(len(boxes)):
        x = max(abs(boxes[box, 0] - middle[0]), abs(boxes[box, 1] + 1.0 - middle[0]))
        y = max(abs(boxes[box, 2] - middle[1]), abs(boxes[box, 3] + 1.0 - middle[1]))
        square = max(square, x * x + y * y)
    for i in range(len(boxes) * STRETCH, len(cells)):
        square = max(square, _square(cells[i], middle))
    return float(np.sqrt(square))


@kernel
def _count_rings(
    cells: NDArray[np.int32],
    boxes: NDArray[np.int32],
    middle: NDArray[np.float64],
    limit: float,
) -> NDArray[np.int64]:
    """Voxels (RINGS,) in each ring of equal area up to ``limit`` voxels from ``middle``."""
    rings = np.zeros(RINGS, dtype=np.int64)
    scale = RINGS / (limit * limit)
    for start in range(0, len(cells), STRETCH):
        if _far_off(boxes, start // STRETCH, middle, limit):
            continue
        for i in range(start, min(start + STRETCH, len(cells))):
            square = _square(cells[i], middle)
            if square <= limit * limit:
                rings[min(int(square * scale), RINGS - 1)] += 1
    return rings


@kernel
def _means_near(
    cells: NDArray[np.int32],
    sums: NDArray[np.float32],
    boxes: NDArray[np.int32],
    around: tuple[NDArray[np.float64], float, int],
    count: int,
    corner: NDArray[np.float64],
    size: float,
    columns: int,
) -> NDArray[np.float32]:
    """Mean points (count, 3 or 4) of the voxels in the innermost rings, as ``points`` of a grid.

    ``around`` are the middle, the limit and the number of rings, see _count_rings.
    """
    middle, limit, kept = around
    scale = RINGS / (limit * limit)
    means = np.empty((count, columns), dtype=np.float32)
    row = 0
    for start in range(0, len(cells), STRETCH):
        if _far_off(boxes, start // STRETCH, middle, limit):
            continue
        for i in range(start, min(start + STRETCH, len(cells))):
            square = _square(cells[i], middle)
            if square <= limit * limit and min(int(square * scale), RINGS - 1) < kept:
                for k in range(3):
                    means[row, k] = corner[k] + size * cells[i, k] + sums[i, 4 + k] / sums[i, 7]
                if columns == 4:
                    means[row, 3] = sums[i, 3] / sums[i, 7]
                row += 1
    return means
