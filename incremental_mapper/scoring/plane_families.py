"""Planar neighbourhoods and their three mutually orthogonal families (paper, MOM)."""

from dataclasses import dataclass
from math import cos, sqrt

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.compiled import kernel
from incremental_mapper.scoring.eigen import smallest_eigen

MAX_AXES = 100
"""Normals that are tried as an axis; more do not change which direction wins."""


@dataclass(frozen=True, slots=True, eq=False)
class Families:
    """Axes (3, 3), one unit vector a row, and the family (K,) of every normal, -1 for none."""

    axes: NDArray[np.float64]
    labels: NDArray[np.int64]


def orthogonal_families(normals: NDArray[np.float64], max_angle: float) -> Families:
    """Sort unit normals (3, K) into three mutually orthogonal families.

    The first axis has the most normals within ``max_angle`` radians of it; the second is the
    one across it for which the second and third family together have the most.
    """
    count = normals.shape[1]
    if count == 0:
        return Families(np.eye(3), np.zeros(0, dtype=np.int64))
    limit = cos(max_angle)
    normals = np.ascontiguousarray(normals)
    trial = normals.take(spread_positions(count, MAX_AXES), axis=1)
    # A normal and its opposite are the same axis, so the mean is taken of n nᵀ.
    first = smallest_eigen(_most_alike(trial, normals, limit)).vectors[:, 0].copy()
    axes = _axes(first, _some_across(first), trial, normals, limit)
    return Families(axes, _labels(axes, normals, limit))


def spread_positions(count: int, wanted: int) -> NDArray[np.int64]:
    """Evenly spread positions, the same ones every time.

    Args:
        count: Number of positions 0..count-1 to choose from.
        wanted: How many are wanted.

    Returns:
        At most ``wanted`` of them, ascending; all where there are no more.
    """
    if count <= wanted:
        return np.arange(count)
    if wanted < 2:
        return np.zeros(wanted, dtype=np.int64)
    positions = (np.arange(wanted) * ((count - 1) / (wanted - 1))).astype(np.int64)
    positions[-1] = count - 1
    return positions


def _some_across(axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """A unit vector (3,) across the unit vector (3,)."""
    x, y, z = axis.tolist()
    sign = 1.0 if z >= 0.0 else -1.0
    scale = -1.0 / (sign + z)
    return np.array([1.0 + sign * x * x * scale, sign * x * y * scale, -sign * x])


@kernel
def _votes(x: float, y: float, z: float, normals: NDArray[np.float64], limit: float) -> int:
    """How many normals (3, K) have a cosine above the limit with an axis."""
    count = 0
    for k in range(normals.shape[1]):
        count += abs(x * normals[0, k] + y * normals[1, k] + z * normals[2, k]) > limit
    return count


@kernel
def _most_alike(
    trial: NDArray[np.float64], normals: NDArray[np.float64], limit: float
) -> NDArray[np.float64]:
    """−Σ n nᵀ (6, 1) of the normals (3, K) that are alike that of ``trial`` (3, A) with the most.

    The matrix is xx, xy, xz, yy, yz, zz; its smallest eigenvalue has the normals' mean direction.
    """
    best, most = 0, -1
    for a in range(trial.shape[1]):
        votes = _votes(trial[0, a], trial[1, a], trial[2, a], normals, limit)
        if votes > most:
            best, most = a, votes
    x, y, z = trial[0, best], trial[1, best], trial[2, best]
    total = np.zeros((6, 1))
    for k in range(normals.shape[1]):
        u, v, w = normals[0, k], normals[1, k], normals[2, k]
        if abs(x * u + y * v + z * w) > limit:
            total[0, 0] -= u * u
            total[1, 0] -= u * v
            total[2, 0] -= u * w
            total[3, 0] -= v * v
            total[4, 0] -= v * w
            total[5, 0] -= w * w
    return total


@kernel
def _axes(
    first: NDArray[np.float64],
    spare: NDArray[np.float64],
    trial: NDArray[np.float64],
    normals: NDArray[np.float64],
    limit: float,
) -> NDArray[np.float64]:
    """The three axes (3, 3): the first, and the two across it that most normals (3, K) vote for.

    A second axis is what of one of ``trial`` (3, A) is across the first, or ``spare`` (3,) where
    none of them is.
    """
    x, y, z = first[0], first[1], first[2]
    axes, most = np.empty((3, 3)), -1
    for k in range(3):
        axes[0, k], axes[1, k] = first[k], spare[k]
    for a in range(trial.shape[1]):
        along = x * trial[0, a] + y * trial[1, a] + z * trial[2, a]
        u, v, w = trial[0, a] - along * x, trial[1, a] - along * y, trial[2, a] - along * z
        length = sqrt(u * u + v * v + w * w)
        if length > limit:
            u, v, w = u / length, v / length, w / length
            votes = _votes(u, v, w, normals, limit)
            votes += _votes(y * w - z * v, z * u - x * w, x * v - y * u, normals, limit)
            if votes > most:
                most = votes
                axes[1, 0], axes[1, 1], axes[1, 2] = u, v, w
    u, v, w = axes[1, 0], axes[1, 1], axes[1, 2]
    axes[2, 0], axes[2, 1], axes[2, 2] = y * w - z * v, z * u - x * w, x * v - y * u
    return axes


@kernel
def _labels(
    axes: NDArray[np.float64], normals: NDArray[np.float64], limit: float
) -> NDArray[np.int64]:
    """The axis (K,) that is most alike each of the normals (3, K), -1 where none is alike."""
    labels = np.empty(normals.shape[1], dtype=np.int64)
    for k in range(normals.shape[1]):
        labels[k], most = -1, limit
        for axis in range(3):
            cosine = abs(
                axes[axis, 0] * normals[0, k]
                + axes[axis, 1] * normals[1, k]
                + axes[axis, 2] * normals[2, k]
            )
            if cosine > most:
                labels[k], most = axis, cosine
    return labels
