"""Homogeneous moments Σ p̃ p̃ᵀ of points, p̃ = (p, 1), as ten numbers.

The ten are the upper triangle of the 4×4 matrix: xx, xy, xz, x, yy, yz, y, zz, z, 1.
"""

import numpy as np
from numpy.typing import NDArray

NUMBERS = 10
COUNT = 9
"""Where among the ten numbers the number of points stands."""
_SQUARES, _MEANS = np.array([0, 1, 2, 4, 5, 7]), np.array([3, 6, 8])
_ROW, _COLUMN = np.triu_indices(4)


def sum_products(
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    points: NDArray[np.float64],
    count: int,
) -> NDArray[np.float64]:
    """Moments (10, count) of ``points`` (3, N): point columns[i] counts in the moment rows[i]."""
    near = [own.take(columns) for own in points]
    sums = np.empty((NUMBERS, count))
    # Number by number all that is at work stays in the processor's cache.
    for total, row, column in zip(sums, _ROW, _COLUMN, strict=True):
        numbers = None if row == 3 else near[row] if column == 3 else near[row] * near[column]
        total[:] = np.bincount(rows, weights=numbers, minlength=count)
    return sums


def covariances(numbers: NDArray[np.float64]) -> NDArray[np.float64]:
    """Covariances (6, ...) in m^2 of moments (10, ...): xx, xy, xz, yy, yz, zz."""
    scaled = numbers / np.maximum(numbers[COUNT], 1.0)
    x, y, z = scaled[3], scaled[6], scaled[8]
    spread: NDArray[np.float64] = scaled.take(_SQUARES, axis=0)
    spread[:3] -= x * scaled.take(_MEANS, axis=0)
    spread[3:5] -= y * scaled.take(_MEANS[1:], axis=0)
    spread[5] -= z * z
    return spread
