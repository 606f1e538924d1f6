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
    trial = normals[spread_positions(len(normals), MAX_AXES)]
    near = np.abs(trial @ normals.T) > limit
    first = _mean_axis(normals[near[int(near.sum(axis=1).argmax())]])
    across = trial - (trial @ first)[:, None] * first
    length = np.linalg.norm(across, axis=1)
    across = across[length > np.cos(max_angle)] / length[length > np.cos(max_angle)][:, None]
    if len(across) == 0:
        across = _any_across(first)[None, :]
    third = np.cross(first, across)
    both = np.abs(np.vstack([across, third]) @ normals.T) > limit
    votes = both.sum(axis=1).reshape(2, -1).sum(axis=0)
    best = int(votes.argmax())
    axes = np.stack([first, across[best], third[best]])
    match = np.abs(normals @ axes.T)
    labels = match.argmax(axis=1)
    labels[match.max(axis=1) <= limit] = -1
    return Families(axes, labels.astype(np.int64))


def _mean_axis(normals: NDArray[np.float64]) -> NDArray[np.float64]:
    # A normal and its opposite are the same axis, so the mean is taken of n nᵀ.
    axis: NDArray[np.float64] = np.linalg.eigh(normals.T @ normals)[1][:, -1]
    return axis


def _any_across(axis: NDArray[np.float64]) -> NDArray[np.float64]:
    across: NDArray[np.float64] = np.cross(axis, np.eye(3)[int(np.abs(axis).argmin())])
    return across / float(np.linalg.norm(across))


def spread_positions(count: int, wanted: int) -> NDArray[np.int64]:
    """Evenly spread positions in 0..count-1, at most ``wanted``; deterministic."""
    if count <= wanted:
        return np.arange(count)
    return np.linspace(0, count - 1, wanted).astype(np.int64)
