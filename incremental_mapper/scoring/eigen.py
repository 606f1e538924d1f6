"""Smallest eigenvalues of many symmetric 3×3 matrices, in closed form.

The trigonometric formula finds the eigenvalue, the adjugate of A − λI its eigenvector, and the
Rayleigh quotient of that vector the eigenvalue again: what is wrong with the vector counts only
squared there, so the result is as good as LAPACK's. Where the two smallest eigenvalues are so
close that the adjugate vanishes, Jacobi's rotations find them. The error stays below 1e-14 times
the largest eigenvalue.
"""

from dataclasses import dataclass
from math import acos, cos, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.compiled import kernel

CLOSE = 1e-4
"""(λ1 − λ0)(λ2 − λ0), over the variance of the eigenvalues, below which Jacobi takes over."""
SWEEPS = 12
"""Rounds of rotations at the most; half as many make any matrix diagonal."""
THIRD = 2.0 * pi / 3.0
"""A third of a turn."""
TINY = 2.3e-308
"""About the smallest normal number: what divides by more than this does not overflow to NaN."""


@dataclass(frozen=True, slots=True, eq=False)
class Smallest:
    """Smallest and middle eigenvalue (N,), never below zero, and the first's unit vector (3, N)."""

    values: NDArray[np.float64]
    middle: NDArray[np.float64]
    vectors: NDArray[np.float64]


def smallest_eigen(matrices: NDArray[np.float64]) -> Smallest:
    """Smallest eigenpair and middle eigenvalue of the matrices (6, N): xx, xy, xz, yy, yz, zz.

    The middle one is less exact where it equals the largest: to 1e-7 of that. A matrix with
    NaN has the eigenvalue NaN.
    """
    return Smallest(*_smallest(np.ascontiguousarray(matrices, dtype=np.float64)))


def full_matrices(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Symmetric matrices (N, 3, 3) of their six numbers (6, N)."""
    full: NDArray[np.float64] = matrices[[0, 1, 2, 1, 3, 4, 2, 4, 5]].T.reshape(-1, 3, 3)
    return full


@kernel
def _by_rotations(
    xx: float, xy: float, xz: float, yy: float, yz: float, zz: float
) -> tuple[float, float, float, float, float]:
    """Smallest and middle eigenvalue, and the first's unit vector, of one matrix."""
    a, axes = np.empty((3, 3)), np.zeros((3, 3))
    # Products of very small numbers would be zero.
    scale = max(abs(xx), abs(yy), abs(zz), abs(xy), abs(xz), abs(yz))
    scale = 1.0 if scale == 0.0 else scale
    a[0, 0], a[1, 1], a[2, 2] = xx / scale, yy / scale, zz / scale
    a[0, 1] = a[1, 0] = xy / scale
    a[0, 2] = a[2, 0] = xz / scale
    a[1, 2] = a[2, 1] = yz / scale
    axes[0, 0] = axes[1, 1] = axes[2, 2] = 1.0
    for _ in range(SWEEPS):
        off = a[0, 1] * a[0, 1] + a[0, 2] * a[0, 2] + a[1, 2] * a[1, 2]
        if off <= 1e-36 * (a[0, 0] * a[0, 0] + a[1, 1] * a[1, 1] + a[2, 2] * a[2, 2]):
            break
        for p in range(2):
            for q in range(p + 1, 3):
                if a[p, q] == 0.0:
                    continue
                # The smaller of the two angles that make a[p, q] zero, by its tangent.
                ratio = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
                tangent = 1.0 / (abs(ratio) + sqrt(ratio * ratio + 1.0))
                tangent = -tangent if ratio < 0.0 else tangent
                cosine = 1.0 / sqrt(tangent * tangent + 1.0)
                sine = tangent * cosine
                for k in range(3):
                    one, other = a[k, p], a[k, q]
                    a[k, p], a[k, q] = cosine * one - sine * other, sine * one + cosine * other
                for k in range(3):
                    one, other = a[p, k], a[q, k]
                    a[p, k], a[q, k] = cosine * one - sine * other, sine * one + cosine * other
                    one, other = axes[k, p], axes[k, q]
                    axes[k, p] = cosine * one - sine * other
                    axes[k, q] = sine * one + cosine * other
                a[p, q] = a[q, p] = 0.0
    least = 0
    for k in range(1, 3):
        if a[k, k] < a[least, least]:
            least = k
    second = min(a[(least + 1) % 3, (least + 1) % 3], a[(least + 2) % 3, (least + 2) % 3])
    first, second = scale * a[least, least], scale * second
    return first, second, axes[0, least], axes[1, least], axes[2, least]


@kernel
def _smallest(
    matrices: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Smallest and middle eigenvalue (N,) and the first's vector (3, N) of matrices (6, N)."""
    count = matrices.shape[1]
    values, middle, vectors = np.empty(count), np.empty(count), np.empty((3, count))
    for i in range(count):
        xx, xy, xz = matrices[0, i], matrices[1, i], matrices[2, i]
        yy, yz, zz = matrices[3, i], matrices[4, i], matrices[5, i]
        mean = (xx + yy + zz) / 3.0
        # Without its mean the matrix is exact where the eigenvalues are nearly the same; there
        # the rounding of the mean counts too.
        xx, yy, zz = xx - mean, yy - mean, zz - mean
        rest = (xx + yy + zz) / 3.0
        xx, yy, zz, mean = xx - rest, yy - rest, zz - rest, mean + rest
        variance = (xx * xx + yy * yy + zz * zz + 2.0 * (xy * xy + xz * xz + yz * yz)) / 6.0
        spread = sqrt(variance)
        determinant = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
        cosine = 0.5 * determinant / max(variance * spread, TINY)
        angle = acos(min(max(cosine, -1.0), 1.0)) / 3.0
        least = 2.0 * spread * cos(angle + THIRD)
        # The adjugate of A − λI is (λ1 − λ)(λ2 − λ) v vᵀ; its longest column is the safest.
        dx, dy, dz = xx - least, yy - least, zz - least
        ax, ay, az = dy * dz - yz * yz, dx * dz - xz * xz, dx * dy - xy * xy
        axy, axz, ayz = xz * yz - xy * dz, xy * yz - xz * dy, xy * xz - dx * yz
        if ax >= max(ay, az):
            u, v, w = ax, axy, axz
        elif ay >= az:
            u, v, w = axy, ay, ayz
        else:
            u, v, w = axz, ayz, az
        squared = u * u + v * v + w * w
        if ax + ay + az <= CLOSE * variance or squared <= 0.0:
            least, second, u, v, w = _by_rotations(xx, xy, xz, yy, yz, zz)
            least, second = least + mean, second + mean
        else:
            turned = u * (dx * u + 2.0 * (xy * v + xz * w)) + v * (dy * v + 2.0 * yz * w)
            length = sqrt(squared)
            least += mean + (turned + dz * w * w) / squared
            second = 2.0 * mean - least - 2.0 * spread * cos(angle)
            u, v, w = u / length, v / length, w / length
        # NaN is not below zero and stays.
        values[i] = 0.0 if least < 0.0 else least
        middle[i] = 0.0 if second < 0.0 else second
        vectors[0, i], vectors[1, i], vectors[2, i] = u, v, w
    return values, middle, vectors
