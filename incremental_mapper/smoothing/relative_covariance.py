"""How well a whole graph knows the pose of one variable seen from another, however far away.

GTSAM's ``Marginals`` break down on long chains that hardly anything anchors, or need priors that
state far too small covariances; here undetermined variables are held by next to nothing, and the
scaled normal equations are solved by sparse LU. That takes some 30 ms for a pose of 5000 variables,
once for all the pairs that it is in: an hour of driving has thousands of pairs of a few hundred
poses. Factors are linearised a part at a time, since their Jacobians take several times what they
come to in the normal equations.
"""

from collections.abc import Collection, Iterable
from itertools import islice
from typing import TYPE_CHECKING

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix, diags, identity

from incremental_mapper.smoothing.batch import make_graph
from incremental_mapper.smoothing.linear_system import DIMENSIONS, REGULARISING_SIGMA
from incremental_mapper.variables import cluster_of, kind_of

if TYPE_CHECKING:
    from scipy.sparse.linalg import SuperLU

PART = 2000
"""Factors that are linearised together."""


class RelativeCovariances:
    """The information of a whole graph at some values, factorised."""

    def __init__(
        self,
        factors: Iterable[gtsam.NonlinearFactor],
        values: gtsam.Values,
        poses: Collection[int],
    ) -> None:
        """Linearise and factorise; costs about one step of a solve.

        Args:
            factors: All factors.
            values: All variables, at or near the optimum.
            poses: Keys of the poses that may be asked for.
        """
        self._values = values
        keys = sorted((int(key) for key in values.keys()), key=lambda key: (cluster_of(key), key))  # noqa: SIM118
        self._places: dict[int, int] = {}
        self._size = 0
        for key in keys:
            self._places[key] = self._size
            self._size += DIMENSIONS[kind_of(key)]
        self._own = {key: np.arange(6) + 6 * number for number, key in enumerate(poses)}
        self._rows = np.concatenate([np.zeros(0, dtype=np.int64), *map(self._span, self._own)])
        self._columns: dict[int, NDArray[np.float64]] = {}
        self._solver, self._scale = self._factorised(factors)

    def relative(self, first: int, second: int) -> NDArray[np.float64]:
        """Covariance of the pose of one variable in the frame of another.

        Args:
            first: Key of one of the poses.
            second: Key of another.

        Returns:
            Covariance (6, 6) of T_first_second in the frame of the second, rotation first.
        """
        rows = np.concatenate([self._own[first], self._own[second]])
        joint = np.hstack([self._column(key)[rows] for key in (first, second)])
        T_second_first = self._values.atPose3(second).between(self._values.atPose3(first))
        moved = np.hstack([-T_second_first.AdjointMap(), np.eye(6)])
        covariance: NDArray[np.float64] = moved @ joint @ moved.T
        return 0.5 * (covariance + covariance.T)

    def position(self, key: int) -> float:
        """How well the place of a pose is known in the map, by its least certain direction.

        Args:
            key: Key of one of the poses.

        Returns:
            Standard deviation, metres.
        """
        covariance = self._column(key)[self._own[key]][3:, 3:]  # behind the rotation
        return float(np.sqrt(np.linalg.eigvalsh(0.5 * (covariance + covariance.T))[-1]))

    def _span(self, key: int) -> NDArray[np.int64]:
        """The places of a variable among all of them."""
        start = self._places[key]
        return np.arange(start, start + DIMENSIONS[kind_of(key)])

    def _column(self, key: int) -> NDArray[np.float64]:
        """Covariance (6 P, 6) of all poses that may be asked for with one of them."""
        if key not in self._columns:
            places = self._span(key)
            sides = np.zeros((self._size, 6))
            sides[places, np.arange(6)] = self._scale[places]
            solved = self._solver.solve(sides)[self._rows]
            self._columns[key] = solved * self._scale[self._rows, None]
        return self._columns[key]

    def _factorised(
        self, factors: Iterable[gtsam.NonlinearFactor]
    ) -> tuple['SuperLU', NDArray[np.float64]]:
        from scipy.sparse.linalg import splu

        hessian = identity(self._size, format='csr') / REGULARISING_SIGMA**2
        rest = iter(factors)
        while part := list(islice(rest, PART)):
            jacobian = self._jacobian(make_graph(part).linearize(self._values))
            hessian = hessian + jacobian.T @ jacobian
        scale: NDArray[np.float64] = 1.0 / np.sqrt(hessian.diagonal())
        scaled = (diags(scale) @ hessian @ diags(scale)).tocsc()
        solver = splu(
            scaled,
            permc_spec='MMD_AT_PLUS_A',
            diag_pivot_thresh=0.0,
            options={'SymmetricMode': True},
        )
        return solver, scale

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
