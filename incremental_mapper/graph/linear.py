"""Factors as rows of a linear least-squares problem, in plain arrays.

A window's problem has a few dozen unknowns. At that size dense algebra is several times cheaper
than GTSAM's elimination tree, and a factor that many candidates share is linearised only once.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dposv

Array = NDArray[np.float64]


VELOCITY = ord('v')
"""Letter of velocities, as it stands in the highest byte of a key."""


def dimension(key: int) -> int:
    """Tangent dimension of a variable: 6 for a pose or a bias, 3 for a velocity."""
    return 3 if key >> 56 == VELOCITY else 6


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """A whitened factor at some values: its squared error is ‖matrix · δ − rhs‖².

    ``matrix`` is (m, n) and ``rhs`` (m,); δ stacks the tangent steps of ``keys``.
    """

    keys: tuple[int, ...]
    matrix: Array
    rhs: Array

    @property
    def finite(self) -> bool:
        """Whether every number is."""
        return bool(np.isfinite(self.matrix).all() and np.isfinite(self.rhs).all())


def linearize(factor: gtsam.NonlinearFactor, values: gtsam.Values) -> Rows:
    """Linearise a factor at ``values``; raises RuntimeError where a variable is missing."""
    linear = factor.linearize(values)
    return Rows(tuple(linear.keys()), *linear.jacobian())


class Layout:
    """Where each variable's tangent step stands in a stacked vector."""

    __slots__ = ('keys', 'places', 'size')

    def __init__(self, keys: Iterable[int]) -> None:
        self.places: dict[int, slice] = {}
        self.size = 0
        for key in keys:
            if key not in self.places:
                width = dimension(key)
                self.places[key] = slice(self.size, self.size + width)
                self.size += width
        self.keys = tuple(self.places)

    def columns(self, keys: Iterable[int]) -> NDArray[np.intp]:
        """Positions of the variables' steps, one after the other."""
        found: list[int] = []
        for key in keys:
            place = self.places[key]
            found.extend(range(place.start, place.stop))
        return np.array(found, dtype=np.intp)

    def vector_values(self, step: Array) -> gtsam.VectorValues:
        """A stacked step (size,) as GTSAM's container."""
        vectors = gtsam.VectorValues()
        for key, place in self.places.items():
            vectors.insert(key, step[place])
        return vectors


def solve_scaled(information: Array, right: Array) -> Array | None:
    """Solve symmetric positive definite equations for ``right`` (n,) or (n, k).

    None where they are not definite or not finite. Units differ by many orders of magnitude
    between positions and biases, so the matrix is scaled to a unit diagonal first: that is what
    Cholesky's accuracy depends on.
    """
    diagonal = np.diagonal(information)
    if not np.all((diagonal > 0.0) & np.isfinite(diagonal)):
        return None
    scale = 1.0 / np.sqrt(diagonal)
    rows = scale if right.ndim == 1 else scale[:, None]
    _, solution, failed = dposv(information * scale[:, None] * scale, right * rows)
    if failed or not np.isfinite(solution).all():
        return None
    step: Array = solution * rows
    return step
