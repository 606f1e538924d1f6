"""One linear least-squares problem over a few dozen unknowns: its layout, its rows, its best step.

At that size dense algebra is several times cheaper than GTSAM's elimination tree, and a call of a
library costs more than the work: the step itself is compiled.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import sqrt

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dpotrs

from incremental_mapper.compiled import kernel
from incremental_mapper.variables import LETTER, POSE, VELOCITY, cluster_of, pose_key

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

REGULARISING_SIGMA = 1e3
"""Standard deviation, metres or radians and so on, of what holds undetermined variables."""

DIMENSIONS = {'x': 6, 'v': 3, 'b': 6}
"""Numbers of a tangent step, by the kind of the variable: pose, velocity, bias."""
_SIZES = {ord(letter): size for letter, size in DIMENSIONS.items()}


@dataclass(frozen=True, slots=True)
class VelocityPlace:
    """A velocity that stands in a layout beside its pose, and where.

    ``place`` is that of its step, ``turn`` that of the rotation of its pose.
    """

    key: int
    pose_key: int
    place: slice
    turn: slice


class Layout:
    """Where each variable's tangent step stands in a stacked vector; it never changes."""

    __slots__ = ('_columns', '_poses', '_velocities', 'places', 'size')

    def __init__(self, keys: Iterable[int]) -> None:
        places: dict[int, slice] = {}
        end = 0
        for key in keys:
            if key not in places:
                start, end = end, end + _SIZES[key >> LETTER]
                places[key] = slice(start, end)
        self.places, self.size = places, end
        self._poses: tuple[tuple[int, slice], ...] | None = None
        self._velocities: tuple[VelocityPlace, ...] | None = None
        self._columns: dict[tuple[int, ...], Indices] = {}

    @property
    def keys(self) -> tuple[int, ...]:
        """The variables in their order."""
        return tuple(self.places)

    @property
    def poses(self) -> tuple[tuple[int, slice], ...]:
        """The poses among the variables, and where they stand."""
        if self._poses is None:
            self._poses = tuple(
                (key, place) for key, place in self.places.items() if key >> LETTER == POSE
            )
        return self._poses

    @property
    def velocities(self) -> tuple[VelocityPlace, ...]:
        """The velocities whose poses are among the variables too."""
        if self._velocities is None:
            found = []
            for key, place in self.places.items():
                if key >> LETTER == VELOCITY:
                    pose = pose_key(cluster_of(key))
                    at = self.places.get(pose)
                    if at is not None:
                        turn = slice(at.start, at.start + 3)
                        found.append(VelocityPlace(key, pose, place, turn))
            self._velocities = tuple(found)
        return self._velocities

    def followed_by(self, keys: Iterable[int]) -> 'Layout':
        """The same with those of the ``keys`` behind that it lacks."""
        places = self.places
        return layout_of((*places, *dict.fromkeys(key for key in keys if key not in places)))

    def columns(self, keys: Iterable[int]) -> Indices:
        """Positions of the variables' steps, one after the other; not to be changed."""
        asked = tuple(keys)
        known = self._columns.get(asked)
        if known is None:
            found: list[int] = []
            for key in asked:
                place = self.places[key]
                found.extend(range(place.start, place.stop))
            known = self._columns[asked] = np.array(found, dtype=np.intp)
        return known

    def vector_values(self, step: Array) -> gtsam.VectorValues:
        """A stacked step (size,) as GTSAM's container."""
        vectors = gtsam.VectorValues()
        for key, place in self.places.items():
            vectors.insert(key, step[place])
        return vectors


@lru_cache(maxsize=64)
def layout_of(keys: tuple[int, ...]) -> Layout:
    """The layout of these variables, made once: windows ask for the same ones again and again."""
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


class PriorRows:
    """The rows ``root`` (m, n) of a prior; their right-hand sides change with every step."""

    def __init__(self, root: Array) -> None:
        self.root = root

    @cached_property
    def information(self) -> Array:
        """rootᵀ · root (n, n), computed once for all systems with this prior."""
        information: Array = self.root.T @ self.root
        return information


@dataclass(frozen=True, slots=True, eq=False)
class Rest:
    """Right-hand sides of the marginal prior, of the regularising one and of the factors."""

    prior: Array
    regularising: Array
    factors: Array


class System:
    """Marginal prior, factors, a regularising prior on new variables; and how far all moved.

    The prior's variables are the first ``known`` ones of the ``layout``. ``rows`` (r, n) are the
    whitened factors. ``total`` (n,) is the step from the prior's values so far.
    """

    __slots__ = ('_error', '_prior', '_prior_error', 'layout', 'rest', 'rows', 'total')

    def __init__(
        self, prior: PriorRows, layout: Layout, rows: Array, rest: Rest, total: Array
    ) -> None:
        self._prior = prior
        self.layout = layout
        self.rows = rows
        self.rest = rest
        self.total = total
        self._error: float | None = None
        self._prior_error: float | None = None

    @property
    def known(self) -> int:
        """Size of the prior's variables."""
        return int(self._prior.root.shape[1])

    @property
    def prior_error(self) -> float:
        """What both priors say against the step so far."""
        if self._prior_error is None:
            rest = self.rest
            squares = rest.prior @ rest.prior + rest.regularising @ rest.regularising
            self._prior_error = float(squares)
        return self._prior_error

    @property
    def error(self) -> float:
        """Σ‖h(x)−z‖²_Σ of the factors, as far as they are linear."""
        if self._error is None:
            self._error = float(self.rest.factors @ self.rest.factors)
        return self._error

    @property
    def cost(self) -> float:
        """Both together."""
        return self.prior_error + self.error

    def best(self) -> tuple[Array, 'System'] | None:
        """The best step from here and the system there, None where it would not be finite."""
        prior, rest = self._prior, self.rest
        found = best_step(
            (prior.root, rest.prior, prior.information),
            (1.0 / REGULARISING_SIGMA, rest.regularising),
            (self.rows, rest.factors),
        )
        if found is None:
            return None
        step, *left = found
        return step, self._there(step, Rest(*left))

    def moved(self, step: Array) -> 'System':
        """The same system seen from a place that is ``step`` (n,) away."""
        return self._there(step, self._after(step))

    def _after(self, step: Array) -> Rest:
        rest = self.rest
        return Rest(
            rest.prior - self._prior.root @ step[: self.known],
            rest.regularising - step[self.known :] / REGULARISING_SIGMA,
            rest.factors - self.rows @ step,
        )

    def _there(self, step: Array, rest: Rest) -> 'System':
        return System(self._prior, self.layout, self.rows, rest, self.total + step)

    def relinearized(self, rows: Array, rhs: Array) -> 'System':
        """The same system with the factors linearised elsewhere: ``rows`` (r, n), ``rhs`` (r,)."""
        rest = Rest(self.rest.prior, self.rest.regularising, rhs)
        return System(self._prior, self.layout, rows, rest, self.total)

    def stacked(self) -> tuple[Array, Array]:
        """All of it as ‖root · δ − rhs‖²: ``root`` (m, n) and ``rhs`` (m,).

        Rows that are not finite are left out.
        """
        known, rest, size = self.known, self.rest, self.layout.size
        held, new = len(rest.prior), np.arange(size - known)
        root = np.zeros((held + len(new) + len(self.rows), size))
        root[:held, :known] = self._prior.root
        root[held + new, known + new] = 1.0 / REGULARISING_SIGMA
        root[held + len(new) :] = self.rows
        rhs = np.concatenate([rest.prior, rest.regularising, rest.factors])
        finite = np.isfinite(rhs) & np.isfinite(root).all(axis=1)
        return (root, rhs) if finite.all() else (root[finite], rhs[finite])


def best_step(
    prior: tuple[Array, Array, Array],
    regularising: tuple[float, Array],
    factors: tuple[Array, Array],
) -> tuple[Array, Array, Array, Array] | None:
    """The step δ (n,) that is best by ‖root · δ − rhs‖² of three kinds of rows.

    ``prior`` is root (m, k), rhs (m,) and rootᵀ · root (k, k) of the first k variables;
    ``regularising`` is one over the standard deviation of the n − k others, and the rhs (n − k,)
    of each; ``factors`` are rows (r, n) and rhs (r,). What the step leaves of the three rhs comes
    behind it. None where the step would not be finite.

    Normal equations square the condition of the rows, which short IMU spans make large; what
    that costs is made good by solving once more for what the first solution leaves.
    """
    # An array with gaps would be another type to compile for.
    root, prior_rhs, information = map(np.ascontiguousarray, prior)
    rows, factor_rhs = map(np.ascontiguousarray, factors)
    weight, regularising_rhs = regularising
    found, step, *rest = _best(
        root,
        prior_rhs,
        information,
        weight,
        np.ascontiguousarray(regularising_rhs),
        rows,
        factor_rhs,
    )
    return (step, rest[0], rest[1], rest[2]) if found else None


def warm_up() -> None:
    """Compile the kernel, or load it from disk."""
    one, none = np.ones((1, 1)), np.zeros(0)
    best_step((one, np.ones(1), one), (1.0, none), (one, np.ones(1)))


@kernel
def _best(
    root: Array,
    prior_rhs: Array,
    information: Array,
    weight: float,
    regularising_rhs: Array,
    rows: Array,
    factor_rhs: Array,
) -> tuple[bool, Array, Array, Array, Array]:
    """See best_step; whether there is a step comes first."""
    known, size = root.shape[1], rows.shape[1]
    prior, regularising, factors = prior_rhs.copy(), regularising_rhs.copy(), factor_rhs.copy()
    step, slope = np.zeros(size), np.empty(size)
    # Only what is not above the diagonal is used.
    a = np.zeros((size, size))
    for i in range(known):
        for j in range(i + 1):
            a[i, j] = information[i, j]
    for i in range(known, size):
        a[i, i] = weight * weight
    for r in range(len(rows)):
        first = 0
        while first < size and rows[r, first] == 0.0:
            first += 1
        for i in range(first, size):
            value = rows[r, i]
            if value != 0.0:
                for j in range(first, i + 1):
                    a[i, j] += value * rows[r, j]
    # The newest variables are eliminated first: along the chain of clusters little fills in.
    # Row k of the triangle L with Lᵀ · L = a takes the place of row k.
    for k in range(size - 1, -1, -1):
        pivot = a[k, k]
        if not 0.0 < pivot < np.inf:
            return False, step, prior, regularising, factors
        pivot, first = sqrt(pivot), k
        a[k, k] = pivot
        for j in range(k - 1, -1, -1):
            if a[k, j] != 0.0:
                a[k, j] /= pivot
                first = j
        for i in range(first, k):
            value = a[k, i]
            if value != 0.0:
                for j in range(first, i + 1):
                    a[i, j] -= value * a[k, j]
    for _ in range(2):
        for j in range(known):
            slope[j] = 0.0
        for j in range(known, size):
            slope[j] = regularising[j - known] * weight
        for r in range(len(root)):
            for j in range(known):
                slope[j] += prior[r] * root[r, j]
        for r in range(len(rows)):
            for j in range(size):
                slope[j] += factors[r] * rows[r, j]
        for k in range(size - 1, -1, -1):
            slope[k] /= a[k, k]
            for j in range(k):
                slope[j] -= slope[k] * a[k, j]
        for k in range(size):
            for j in range(k):
                slope[k] -= a[k, j] * slope[j]
            slope[k] /= a[k, k]
        for j in range(size):
            step[j] += slope[j]
        for r in range(len(root)):
            for j in range(known):
                prior[r] -= root[r, j] * slope[j]
        for j in range(known, size):
            regularising[j - known] -= weight * slope[j]
        for r in range(len(rows)):
            for j in range(size):
                factors[r] -= rows[r, j] * slope[j]
    for j in range(size):
        if not abs(step[j]) < np.inf:
            return False, step, prior, regularising, factors
    return True, step, prior, regularising, factors
