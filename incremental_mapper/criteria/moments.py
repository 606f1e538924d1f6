"""Homogeneous moments Σ p̃ p̃ᵀ of points, p̃ = (p, 1), as ten numbers.

The ten are the upper triangle of the 4×4 matrix: xx, xy, xz, x, yy, yz, y, zz, z, 1. A motion T of
the points makes T M Tᵀ of their moments, which is linear in the ten numbers.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array

NUMBERS = 10
COUNT = 9
"""Where among the ten numbers the number of points stands."""
BLOCK = 2000
"""Points whose products are made together, so that they stay in the processor's cache."""
_ROW, _COLUMN = np.triu_indices(4)
_OFF_DIAGONAL = (_ROW != _COLUMN).astype(np.float64)


def products(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """The ten numbers (N, 10) of each of the points (3, N) alone."""
    count = points.shape[1]
    numbers = np.empty((count, NUMBERS))
    some = np.empty((NUMBERS, min(count, BLOCK)))
    some[COUNT] = 1.0
    for start in range(0, count, BLOCK):
        block = points[:, start : start + BLOCK]
        part = some[:, : block.shape[1]]
        np.multiply(block[0], block, out=part[:3])
        np.multiply(block[1], block[1:], out=part[4:6])
        np.multiply(block[2], block[2], out=part[7])
        part[3], part[6], part[8] = block
        numbers[start : start + BLOCK] = part.T
    return numbers


def sum_products(
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    weights: NDArray[np.float64],
    numbers: NDArray[np.float64],
    count: int,
) -> NDArray[np.float64]:
    """Sums (count, 10): row rows[i] gets weights[i] times row columns[i] of ``numbers`` (N, 10)."""
    matrix = coo_array((weights, (rows, columns)), shape=(count, len(numbers)))
    sums: NDArray[np.float64] = matrix @ numbers
    return sums


def transfers(motions: NDArray[np.float64]) -> NDArray[np.float64]:
    """What the motions (..., 4, 4) do to the ten numbers: matrices (..., 10, 10)."""
    direct = motions[..., _ROW[:, None], _ROW] * motions[..., _COLUMN[:, None], _COLUMN]
    crossed = motions[..., _ROW[:, None], _COLUMN] * motions[..., _COLUMN[:, None], _ROW]
    matrices: NDArray[np.float64] = direct + _OFF_DIAGONAL * crossed
    return matrices


def covariances(numbers: NDArray[np.float64]) -> NDArray[np.float64]:
    """Covariances (6, ...) in m^2 of moments (10, ...): xx, xy, xz, yy, yz, zz."""
    scaled = numbers / np.maximum(numbers[COUNT], 1.0)
    x, y, z = scaled[3], scaled[6], scaled[8]
    spread: NDArray[np.float64] = scaled[[0, 1, 2, 4, 5, 7]]
    spread[:3] -= x * scaled[[3, 6, 8]]
    spread[3:5] -= y * scaled[[6, 8]]
    spread[5] -= z * z
    return spread
