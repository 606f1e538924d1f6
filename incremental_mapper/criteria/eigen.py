"""Smallest eigenvalues of many symmetric 3×3 matrices, in closed form.

The trigonometric formula finds the eigenvalue, the adjugate of A − λI its eigenvector, and the
Rayleigh quotient of that vector the eigenvalue again: what is wrong with the vector counts only
squared there, so the result is as good as LAPACK's. Where the two smallest eigenvalues are so
close that the adjugate vanishes, LAPACK does it. The error stays below 1e-14 times the largest
eigenvalue.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

CLOSE = 1e-4
"""(λ1 − λ0)(λ2 − λ0), over the variance of the eigenvalues, below which LAPACK takes over."""


@dataclass(frozen=True, slots=True, eq=False)
class Smallest:
    """Smallest and middle eigenvalue (N,), never below zero, and the first's unit vector (3, N)."""

    values: NDArray[np.float64]
    middle: NDArray[np.float64]
    vectors: NDArray[np.float64]


def smallest_eigen(matrices: NDArray[np.float64]) -> Smallest:
    """Smallest eigenpair and middle eigenvalue of the matrices (6, N): xx, xy, xz, yy, yz, zz.

    The middle one is less exact where it equals the largest: to 1e-7 of that.
    """
    xx, xy, xz, yy, yz, zz = matrices
    mean = (xx + yy + zz) / 3.0
    # Without its mean the matrix is exact where the eigenvalues are nearly the same; there the
    # rounding of the mean counts too.
    xx, yy, zz = xx - mean, yy - mean, zz - mean
    rest = (xx + yy + zz) / 3.0
    xx, yy, zz, mean = xx - rest, yy - rest, zz - rest, mean + rest
    variance = (xx * xx + yy * yy + zz * zz + 2.0 * (xy * xy + xz * xz + yz * yz)) / 6.0
    spread = np.sqrt(variance)
    determinant = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    cubed = np.maximum(variance * spread, np.finfo(np.float64).tiny)
    angle = np.arccos(np.minimum(np.maximum(0.5 * determinant / cubed, -1.0), 1.0)) / 3.0
    least = 2.0 * spread * np.cos(angle + 2.0 * np.pi / 3.0)
    largest = 2.0 * spread * np.cos(angle)
    column, weight = _adjugate_column(xx - least, xy, xz, yy - least, yz, zz - least)
    u, v, w = column
    squared = u * u + v * v + w * w
    close = (weight <= CLOSE * variance) | (squared <= 0.0)
    squared[close] = 1.0
    turned = u * (xx * u + 2.0 * (xy * v + xz * w)) + v * (yy * v + 2.0 * yz * w) + zz * w * w
    values = mean + turned / squared
    middle = 2.0 * mean - values - largest
    vectors = column / np.sqrt(squared)
    if close.any():
        found, axes = np.linalg.eigh(full_matrices(matrices[:, close]))
        values[close], middle[close] = found[:, 0], found[:, 1]
        vectors[:, close] = axes[:, :, 0].T
    return Smallest(np.maximum(values, 0.0), np.maximum(middle, 0.0), vectors)


def full_matrices(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Symmetric matrices (N, 3, 3) of their six numbers (6, N)."""
    full: NDArray[np.float64] = matrices[[0, 1, 2, 1, 3, 4, 2, 4, 5]].T.reshape(-1, 3, 3)
    return full


def _adjugate_column(
    xx: NDArray[np.float64],
    xy: NDArray[np.float64],
    xz: NDArray[np.float64],
    yy: NDArray[np.float64],
    yz: NDArray[np.float64],
    zz: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The longest column (3, N) of the adjugate, and the adjugate's trace (N,).

    The adjugate of A − λI is (λ1 − λ)(λ2 − λ) v vᵀ.
    """
    ax, ay, az = yy * zz - yz * yz, xx * zz - xz * xz, xx * yy - xy * xy
    axy, axz, ayz = xz * yz - xy * zz, xy * yz - xz * yy, xy * xz - xx * yz
    first, second = ax >= np.maximum(ay, az), ay >= az
    column = np.empty((3, len(ax)))
    column[0] = np.where(first, ax, np.where(second, axy, axz))
    column[1] = np.where(first, axy, np.where(second, ay, ayz))
    column[2] = np.where(first, axz, np.where(second, ayz, az))
    return column, ax + ay + az
