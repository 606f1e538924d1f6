"""Factors as rows of a linear least-squares problem, in plain arrays.

A window's problem has a few dozen unknowns. At that size dense algebra is several times cheaper
than GTSAM's elimination tree.
"""

from collections.abc import Iterable
from functools import lru_cache

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dpotrs

from incremental_mapper.graph.values import kind_of

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

DIMENSIONS = {'x': 6, 'v': 3, 'b': 6}
"""Numbers of a tangent step, by the kind of the variable: pose, velocity, bias."""


class Layout:
    """Where each variable's tangent step stands in a stacked vector."""

    __slots__ = ('places', 'size')

    def __init__(self, keys: Iterable[int]) -> None:
        self.places: dict[int, slice] = {}
        self.size = 0
        self.append(keys)

    def append(self, keys: Iterable[int]) -> None:
        """Add those of the ``keys`` that are not there yet."""
        places, end = self.places, self.size
        for key in keys:
            if key not in places:
                start, end = end, end + DIMENSIONS[kind_of(key)]
                places[key] = slice(start, end)
        self.size = end

    @property
    def keys(self) -> tuple[int, ...]:
        """The variables in their order."""
        return tuple(self.places)

    def followed_by(self, keys: Iterable[int]) -> 'Layout':
        """The same with those of the ``keys`` behind that it lacks."""
        longer = Layout(())
        longer.places, longer.size = dict(self.places), self.size
        longer.append(keys)
        return longer

    def columns(self, keys: Iterable[int]) -> Indices:
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


@lru_cache(maxsize=64)
def layout_of(keys: tuple[int, ...]) -> Layout:
    """The layout of these variables; others may hold the same one, so nothing may be appended."""
    return Layout(keys)


def solve_scaled(information: Array, right: Array) -> Array | None:
    """Solve symmetric positive definite equations for ``right`` (n,) or (n, k).

    None where they are not definite or not finite. Units differ by many orders of magnitude
    between positions and biases, so the matrix is scaled to a unit diagonal first.
    """
    diagonal = np.diagonal(information)
    if not (diagonal.min(initial=np.inf) > 0.0 and np.isfinite(diagonal).all()):
        return None
    scale = 1.0 / np.sqrt(diagonal)
    factor, failed = dpotrf(information * scale * scale[:, None], overwrite_a=1, clean=0)
    if failed:
        return None
    if right.ndim > 1:
        scale = scale[:, None]
    solution, _ = dpotrs(factor, right * scale)
    solution *= scale
    return solution if np.isfinite(solution).all() else None
