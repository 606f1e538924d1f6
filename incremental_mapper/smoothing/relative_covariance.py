"""How well a whole graph knows the pose of one variable seen from another, however far away.

GTSAM's ``Marginals`` break down on long chains that hardly anything anchors, or need priors that
state far too small covariances; here undetermined variables are held by next to nothing, and the
scaled normal equations are factorised, H = L D Lᵀ. With L Y = E, where E picks out a pose, its
covariance is Yᵀ D⁻¹ Y, and Y has entries in those rows alone that L leads to from the pose. In the
order of a nested dissection these are some hundred, however long the drive is; in the orders that
keep L sparsest they are a third of all rows of a chain, and the pairs of an hour took minutes.
Factors are linearised a part at a time, since their Jacobians take several times what they come to
in the normal equations.
"""

from collections.abc import Iterable
from itertools import islice
from typing import Any, NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix, diags, identity

from incremental_mapper.compiled import kernel
from incremental_mapper.smoothing.batch import make_graph
from incremental_mapper.smoothing.linear_system import DIMENSIONS, REGULARISING_SIGMA
from incremental_mapper.variables import kind_of

PART = 2000
"""Factors that are linearised together."""


class _Rows(NamedTuple):
    """The rows of Y that are not zero, and what is in them (R, 6)."""

    places: NDArray[np.int64]
    entries: NDArray[np.float64]


class RelativeCovariances:
    """The information of a whole graph at some values, factorised."""

    def __init__(self, factors: Iterable[gtsam.NonlinearFactor], values: gtsam.Values) -> None:
        """Linearise and factorise; costs about one step of a solve.

        Args:
            factors: All factors.
            values: All variables, at or near the optimum.

        Raises:
            RuntimeError: The system is singular.
        """
        self._values = values
        known = list(factors)
        self._places: dict[int, int] = {}
        self._size = 0
        for key in _dissected(known, values):
            self._places[key] = self._size
            self._size += DIMENSIONS[kind_of(key)]
        self._rows: dict[int, _Rows] = {}
        self._factorise(known)

    def relative(self, first: int, second: int) -> NDArray[np.float64]:
        """Covariance of the pose of one variable in the frame of another.

        Args:
            first: Key of a pose.
            second: Key of another.

        Returns:
            Covariance (6, 6) of T_first_second in the frame of the second, rotation first.
        """
        T_second_first = self._values.atPose3(second).between(self._values.atPose3(first))
        one, other = self._rows_of(first), self._rows_of(second)
        places = np.union1d(one.places, other.places)
        # The difference is taken before it is squared: what both do not know cancels here.
        apart = np.zeros((len(places), 6))
        apart[np.searchsorted(places, one.places)] -= one.entries @ T_second_first.AdjointMap().T
        apart[np.searchsorted(places, other.places)] += other.entries
        return self._squared(_Rows(places, apart))

    def position(self, key: int) -> float:
        """How well the place of a pose is known in the map, by its least certain direction.

        Args:
            key: Its key.

        Returns:
            Standard deviation, metres.
        """
        covariance = self._squared(self._rows_of(key))[3:, 3:]  # behind the rotation
        return float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))

    def _span(self, key: int) -> NDArray[np.int64]:
        """The places of a variable among all of them."""
        start = self._places[key]
        return np.arange(start, start + DIMENSIONS[kind_of(key)])

    def _rows_of(self, key: int) -> _Rows:
        """Y of a pose."""
        if key not in self._rows:
            span = self._span(key)
            places, entries = _solved(
                self._order[span], self._scale[span], self._starts, self._below, self._lower
            )
            self._rows[key] = _Rows(places, entries)
        return self._rows[key]

    def _squared(self, rows: _Rows) -> NDArray[np.float64]:
        """Yᵀ D⁻¹ Y (6, 6)."""
        covariance = rows.entries.T @ (rows.entries / self._pivots[rows.places, None])
        return np.asarray(0.5 * (covariance + covariance.T), dtype=np.float64)

    def _factorise(self, factors: Iterable[gtsam.NonlinearFactor]) -> None:
        from scipy.sparse.linalg import splu

        hessian = identity(self._size, format='csr') / REGULARISING_SIGMA**2
        rest = iter(factors)
        while part := list(islice(rest, PART)):
            jacobian = self._jacobian(make_graph(part).linearize(self._values))
            hessian = hessian + jacobian.T @ jacobian
        self._scale: NDArray[np.float64] = 1.0 / np.sqrt(hessian.diagonal())
        scaled = (diags(self._scale) @ hessian @ diags(self._scale)).tocsc()
        solver = splu(
            scaled, permc_spec='NATURAL', diag_pivot_thresh=0.0, options={'SymmetricMode': True}
        )
        # A pivot is left out where it is nothing: then there is no L D Lᵀ.
        if not np.array_equal(solver.perm_r, solver.perm_c):
            raise RuntimeError('the system is singular')
        lower: Any = solver.L.tocsc()
        self._order = np.asarray(solver.perm_c, dtype=np.int64)
        self._pivots: NDArray[np.float64] = solver.U.diagonal()
        self._starts, self._below, self._lower = lower.indptr, lower.indices, lower.data

    def _jacobian(self, linear: gtsam.GaussianFactorGraph) -> csr_matrix:
        rows, columns, entries, height = [], [], [], 0
        for index in range(linear.size()):
            factor = linear.at(index)
            if factor is None:
                continue
            block = factor.jacobian()[0]
            own = np.concatenate([self._span(key) for key in factor.keys()])  # noqa: SIM118
            rows.append(np.repeat(np.arange(height, height + len(block)), len(own)))
            columns.append(np.tile(own, len(block)))
            entries.append(block.ravel())
            height += len(block)
        return csr_matrix(
            (np.concatenate(entries), (np.concatenate(rows), np.concatenate(columns))),
            shape=(height, self._size),
        )


def warm_up() -> None:
    """Compile the kernels, or load them from disk."""
    none = np.zeros(1, dtype=np.int64)
    starts, below = np.array([0, 1], dtype=np.int32), np.zeros(1, dtype=np.int32)
    _solved(none, np.ones(1), starts, below, np.ones(1))


def _dissected(factors: list[gtsam.NonlinearFactor], values: gtsam.Values) -> list[int]:
    """All variables, those that hold the parts of the graph together last.

    METIS ends the process where a variable has no neighbour, so it is not shown any such.
    """
    linking = [factor for factor in factors if len(set(factor.keys())) > 1]
    keys: list[int] = []
    if linking:
        order = gtsam.Ordering.MetisNonlinearFactorGraph(make_graph(linking))
        keys = [order.at(place) for place in range(order.size())]
    reached = set(keys)
    alone = [int(key) for key in values.keys() if key not in reached]  # noqa: SIM118
    return [*alone, *keys]


def _solved(
    rows: NDArray[np.int64],
    scales: NDArray[np.float64],
    starts: NDArray[np.int32],
    below: NDArray[np.int32],
    lower: NDArray[np.float64],
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Solve L Y = E for the columns of E that have one entry each.

    Args:
        rows: The rows (K,) of the entries.
        scales: The entries (K,).
        starts: Where each column of L starts in ``below`` and ``lower``, and where the last ends.
        below: Rows of the entries of L.
        lower: The entries; those on the diagonal are 1.

    Returns:
        The rows (R,) of Y that are not zero, ascending, and what is in them (R, K).
    """
    reached = np.empty(len(starts) - 1, dtype=np.int64)
    reached[: len(rows)] = rows
    place = np.full(len(starts) - 1, -1, dtype=np.int64)
    place[rows] = 0
    places = np.sort(reached[: _follow(reached, len(rows), place, starts, below)])
    place[places] = np.arange(len(places))
    found = np.zeros((len(places), len(rows)))
    found[place[rows], np.arange(len(rows))] = scales
    _substitute(places, place, starts, below, lower, found)
    return places, found


@kernel
def _follow(
    reached: NDArray[np.int64],
    count: int,
    place: NDArray[np.int64],
    starts: NDArray[np.int32],
    below: NDArray[np.int32],
) -> int:
    """Add to the first rows of ``reached`` all that L leads to; returns how many there are.

    ``place`` (N,) is negative where a row has not been reached.
    """
    following = 0
    while following < count:
        column = reached[following]
        following += 1
        for entry in range(starts[column], starts[column + 1]):
            row = below[entry]
            if place[row] < 0:
                place[row] = 0
                reached[count] = row
                count += 1
    return count


@kernel
def _substitute(
    places: NDArray[np.int64],
    place: NDArray[np.int64],
    starts: NDArray[np.int32],
    below: NDArray[np.int32],
    lower: NDArray[np.float64],
    found: NDArray[np.float64],
) -> None:
    """Turn E into Y in ``found`` (R, K), whose rows stand at ``place`` (N,) of ``places`` (R,)."""
    for number in range(len(places)):
        column = places[number]
        for entry in range(starts[column], starts[column + 1]):
            row = below[entry]
            if row != column:
                for side in range(found.shape[1]):
                    found[place[row], side] -= lower[entry] * found[number, side]
