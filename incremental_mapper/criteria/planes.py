"""Planar neighbourhoods and their three mutually orthogonal families (paper, MOM)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MAX_AXES = 100
"""Normals that are tried as an axis; more do not change which direction wins."""


@dataclass(frozen=True, slots=True, eq=False)
class Families:
    """Axes (3, 3), one unit vector a row, and the family (K,) of every normal, -1 for none."""

    axes: NDArray[np.float64]
    labels: NDArray[np.int64]


def orthogonal_families(normals: NDArray[np.float64], max_angle: float) -> Families:
    """Sort unit normals (K, 3) into three mutually orthogonal families.

    The first axis has the most normals within ``max_angle`` radians of it; the second is the
    one across it for which the second and third family together have the most.
    """
    if len(normals) == 0:
        return Families(np.eye(3), np.zeros(0, dtype=np.int64))
    limit = float(np.cos(max_angle))
    rows = np.ascontiguousarray(normals.T)
    trial = normals[spread_positions(len(normals), MAX_AXES)]
    near = _alike(trial, rows, limit)
    first = _mean_axis(rows.compress(near[int(_counts(near).argmax())], axis=1))
    # Below pi/4, what is near the first axis is near nothing that is across it.
    others = rows
    if max_angle < np.pi / 4.0:
        others = rows.compress(np.abs(first @ rows) <= limit, axis=1)
    # What is across the first axis is told by two numbers, and a quarter turn swaps these.
    basis = _basis_across(first)
    across = basis @ trial.T
    length = np.sqrt(across[0] * across[0] + across[1] * across[1])
    long = length > limit
    across = (across.compress(long, axis=1) / length[long]) if long.any() else np.eye(2)[:, :1]
    flat = basis @ others
    third = np.array([-across[1], across[0]])
    votes = _counts(_alike(across.T, flat, limit)) + _counts(_alike(third.T, flat, limit))
    best = int(votes.argmax())
    axes = np.vstack([first, across[:, best] @ basis, third[:, best] @ basis])
    match = np.abs(axes @ rows)
    labels = match.argmax(axis=0)
    labels[match.max(axis=0) <= limit] = -1
    return Families(axes, labels)


def _alike(
    axes: NDArray[np.float64], normals: NDArray[np.float64], limit: float
) -> NDArray[np.bool_]:
    """Where (A, K) the cosine between ``axes`` (A, D) and ``normals`` (D, K) is above the limit."""
    # For so short a sum einsum is twice as quick as a matrix product.
    cosines = np.einsum('ai,ik->ak', axes, normals)
    alike: NDArray[np.bool_] = np.abs(cosines, out=cosines) > limit
    return alike


def _counts(chosen: NDArray[np.bool_]) -> NDArray[np.int32]:
    """How many (A,) are chosen (A, K) in each row."""
    counts: NDArray[np.int32] = np.add.reduce(chosen, axis=1, dtype=np.int32)
    return counts


def _mean_axis(normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """The direction (3,) of unit vectors (3, K)."""
    # A normal and its opposite are the same axis, so the mean is taken of n nᵀ.
    axis: NDArray[np.float64] = np.linalg.eigh(normals @ normals.T)[1][:, -1]
    return axis


def _basis_across(axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """Two unit vectors (2, 3) across the unit vector (3,) and across each other."""
    x, y, z = axis.tolist()
    sign = 1.0 if z >= 0.0 else -1.0
    scale = -1.0 / (sign + z)
    mixed = x * y * scale
    return np.array(
        [
            [1.0 + sign * x * x * scale, sign * mixed, -sign * x],
            [mixed, sign + y * y * scale, -y],
        ]
    )


def spread_positions(count: int, wanted: int) -> NDArray[np.int64]:
    """Evenly spread positions in 0..count-1, at most ``wanted``; deterministic."""
    if count <= wanted:
        return np.arange(count)
    if wanted < 2:
        return np.zeros(wanted, dtype=np.int64)
    positions = (np.arange(wanted) * ((count - 1) / (wanted - 1))).astype(np.int64)
    positions[-1] = count - 1
    return positions
