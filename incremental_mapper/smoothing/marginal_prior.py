"""The marginal prior: what G(t) says of its newest part, as a Gaussian over the frontier.

The frontier are the variables that new factors may touch. Everything older is marginalised, once
and for good, into a square-root information matrix over the frontier; the newest of those older
variables still move with it by their linear conditional p(eliminated | frontier).
All of it is relative to the newest estimates, so the cost of a window depends on nothing but the
window.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgeqrf, dtrtrs

from incremental_mapper.smoothing.linear_system import Array, Layout, layout_of, solve_scaled
from incremental_mapper.smoothing.tangent import Pivoted, move_pivot, to_base_rows, to_own_rows
from incremental_mapper.variables import cluster_of, kind_of, pose_key


@dataclass(frozen=True, slots=True, eq=False)
class MarginalPrior:
    """A Gaussian over the frontier, and the conditionals of what was eliminated lately.

    What G(t) says of a tangent step δ (n,) of the frontier is ‖root · δ − rhs‖², linear around the
    newest estimates; steps are those about a pivot of ``tangent``. Where the last solve converged,
    the estimates are the mean, and ``rhs`` is zero up to a constant.

    Attributes:
        keys: The frontier's variables.
        root: Square-root information (m, n).
        rhs: Right-hand side (m,).
        pivot: What the frontier's steps are about (3,), metres in the map.
        eliminated: Variables that are no longer in the frontier and still move with it, by GTSAM's
            steps.
        gains: How they move, (f, n): by gains · δ.
        base: The frontier's newest estimates, and those of eliminated variables without their
            pending delta: there are many of them, and few are asked for.
        pending_delta: Tangent step (f,) that the eliminated variables have yet to make.
        clusters: The clusters in it with their stamps (ns).
        held: Variables that stay among the frontier and the eliminated, however old, until
            evidence on them has come; see ``correction``.
        spread: Covariance (h, h) of GTSAM's steps that they have where the frontier is known: they
            move with it by ``gains``, and this is what is left.
        healthy: False where the last window could not be solved and stays at its initial values.
    """

    keys: tuple[int, ...] = ()
    root: Array = field(default_factory=lambda: np.zeros((0, 0)))
    rhs: Array = field(default_factory=lambda: np.zeros(0))
    pivot: Array = field(default_factory=lambda: np.zeros(3))
    eliminated: tuple[int, ...] = ()
    gains: Array = field(default_factory=lambda: np.zeros((0, 0)))
    base: gtsam.Values = field(default_factory=gtsam.Values)
    pending_delta: Array = field(default_factory=lambda: np.zeros(0))
    clusters: Mapping[int, int] = field(default_factory=dict)
    held: tuple[int, ...] = ()
    spread: Array = field(default_factory=lambda: np.zeros((0, 0)))
    healthy: bool = True

    @property
    def values(self) -> gtsam.Values:
        """The newest estimates of all variables."""
        values = gtsam.Values(self.base)
        values.update(self._moved(self.eliminated, self.pending_delta))
        return values

    def holder(self, key: int) -> gtsam.Values:
        """Values that have the newest estimate of one variable, and maybe others' that are not."""
        place = layout_of(self.eliminated).places.get(key)
        return self.base if place is None else self._moved((key,), self.pending_delta[place])

    def following(self, keys: Collection[int]) -> tuple[Array, Array]:
        """How variables move with the frontier, those of the frontier themselves included.

        Args:
            keys: Of the frontier, or eliminated ones.

        Returns:
            Gains (k, n) of GTSAM's steps, and those steps (k,) that they have yet to make.
        """
        inside, outside = layout_of(self.keys).places, layout_of(self.eliminated).places
        unit = self.own_steps()
        gains = [unit[inside[key]] if key in inside else self.gains[outside[key]] for key in keys]
        steps = [
            np.zeros(len(rows)) if key in inside else self.pending_delta[outside[key]]
            for key, rows in zip(keys, gains, strict=True)
        ]
        return np.vstack([unit[:0], *gains]), np.concatenate([np.zeros(0), *steps])

    def own_steps(self) -> Array:
        """The matrix (n, n) that makes GTSAM's steps of the frontier of those about the pivot."""
        layout = layout_of(self.keys)
        matrix = np.eye(layout.size)
        to_own_rows(matrix, layout, Pivoted(self.base, self.pivot), self.keys)
        return matrix

    def _moved(self, keys: tuple[int, ...], step: Array) -> gtsam.Values:
        return self.base.extract(keys).retract(layout_of(keys).vector_values(step))

    def covariance(self, *keys: int) -> Array | None:
        """Joint marginal covariance of frontier variables.

        Args:
            keys: Some of ``self.keys``.

        Returns:
            Covariance (d, d) in the order of ``keys``: along the axes of base_link, poses rotation
            first; of velocities that stand alone, along those of the map. None where it is
            undetermined.
        """
        layout = layout_of(self.keys)
        columns = layout.columns(keys)
        unit = np.zeros((layout.size, len(columns)))
        unit[columns, np.arange(len(columns))] = 1.0
        solution = solve_scaled(self.root.T @ self.root, unit)
        if solution is None:
            return None
        here = Pivoted(self.base, self.pivot)
        to_base_rows(solution, layout, here, keys)
        half = solution[columns].T.copy()
        joint = np.zeros((layout.size, len(columns)))
        joint[columns] = half
        to_base_rows(joint, layout, here, keys)
        return joint[columns]


def marginalise(
    prior: MarginalPrior, keep: Collection[int], oldest: int
) -> tuple[MarginalPrior, gtsam.Values]:
    """Leave only the variables ``keep`` in the frontier, and eliminate the others.

    Args:
        prior: The prior so far.
        keep: Variables that stay in the frontier, and with a velocity its pose; those that it
            does not have are ignored.
        oldest: Stamp (ns) of the oldest clusters whose eliminated variables still move.

    Returns:
        The smaller prior, and the final values of variables that are let go: those of older
        clusters of which nothing is kept.
    """
    layout, wanted_keys = layout_of(prior.keys), with_poses(keep)
    kept = tuple(key for key in prior.keys if key in wanted_keys)
    dropped = tuple(key for key in prior.keys if key not in wanted_keys)
    wanted = {cluster_of(key) for key in kept}
    first, last = layout.columns(dropped), layout.columns(kept)
    reduced, rest = triangle(prior.root[:, np.concatenate([first, last])], prior.rhs)
    count = len(first)
    # Where the last solve did not converge, the dropped ones still have a way to go: the last
    # column.
    solved = np.concatenate([-reduced[:count, count:], rest[:count, None]], axis=1)
    if count:
        solved, _ = dtrtrs(reduced[:count, :count], solved)
    moves = np.concatenate([prior.gains[:, first] @ solved, _own(solved, prior, dropped, kept)])
    spread = prior.spread
    if prior.held and count:
        # What is dropped is not known exactly where the rest is, and the held ones move with it.
        noise, _ = dtrtrs(reduced[:count, :count], np.eye(count))
        noise = prior.following(prior.held)[0][:, first] @ noise
        spread = spread + noise @ noise.T
    gains, pending_delta = moves[:, :-1], moves[:, -1]
    gains[: len(prior.gains)] += prior.gains[:, last]
    pending_delta[: len(prior.pending_delta)] += prior.pending_delta
    eliminated = (*prior.eliminated, *dropped)
    root, left = reduced[count:, count:].copy(), layout_of(kept)
    pivot = pivot_of(left, prior.base, prior.pivot)
    for rows in (root, gains):
        move_pivot(rows, left, pivot - prior.pivot)
    smaller = MarginalPrior(
        keys=kept,
        root=root,
        rhs=rest[count:],
        pivot=pivot,
        eliminated=eliminated,
        gains=gains,
        base=prior.base,
        pending_delta=pending_delta,
        clusters=prior.clusters,
        held=prior.held,
        spread=spread,
        healthy=prior.healthy,
    )
    wanted |= {cluster_of(key) for key in prior.held}
    old = {
        cluster
        for cluster, stamp in prior.clusters.items()
        if stamp < oldest and cluster not in wanted
    }
    if not old:
        return smaller, gtsam.Values()
    leaves = tuple(key for key in eliminated if cluster_of(key) in old)
    steps = pending_delta[layout_of(eliminated).columns(leaves)]
    gone = smaller._moved(leaves, steps)
    stays = trimmed(smaller, {key for key in eliminated if cluster_of(key) not in old})
    newer = {cluster: stamp for cluster, stamp in prior.clusters.items() if cluster not in old}
    return replace(stays, clusters=newer), gone


def with_poses(keys: Collection[int]) -> frozenset[int]:
    """Variables, and the poses of the velocities among them, which turn with those."""
    poses = (pose_key(cluster_of(key)) for key in keys if kind_of(key) == 'v')
    return frozenset((*keys, *poses))


def pivot_of(layout: Layout, values: gtsam.Values, before: Array) -> Array:
    """Where the newest of some poses is (3,), which is near them all; ``before`` without any."""
    if not layout.poses:
        return before
    newest = max((key for key, _ in layout.poses), key=cluster_of)
    place: Array = values.atPose3(newest).translation()
    return place


def _own(
    steps: Array, prior: MarginalPrior, dropped: tuple[int, ...], kept: tuple[int, ...]
) -> Array:
    """Steps (f, k + 1) of dropped variables, with unit steps of the kept ones, as GTSAM's."""
    layout, count = layout_of(dropped + kept), len(steps)
    moves = np.concatenate([steps, np.eye(layout.size - count, steps.shape[1])])
    to_own_rows(moves, layout, Pivoted(prior.base, prior.pivot), dropped)
    return moves[:count]


def trimmed(prior: MarginalPrior, eliminated: Collection[int]) -> MarginalPrior:
    """The prior with fewer eliminated variables.

    Args:
        prior: Any prior.
        eliminated: Keys of those that stay.

    Returns:
        The same Gaussian over the same frontier.
    """
    kept = tuple(key for key in prior.eliminated if key in eliminated)
    rows = layout_of(prior.eliminated).columns(kept)
    return replace(
        prior,
        eliminated=kept,
        gains=prior.gains[rows],
        base=prior.base.extract([*prior.keys, *kept]),
        pending_delta=prior.pending_delta[rows],
    )


def triangle(matrix: Array, rhs: Array) -> tuple[Array, Array]:
    """R (n, n) and c (n,) of ‖matrix · δ − rhs‖² = ‖R · δ − c‖² + constant, m >= n rows."""
    size = matrix.shape[1]
    both = np.empty((len(rhs), size + 1), order='F')
    both[:, :size], both[:, size] = matrix, rhs
    packed, _, _, _ = dgeqrf(both, overwrite_a=1)
    triangle = np.where(_upper(min(len(packed), size), size + 1), packed[:size], 0.0)
    return triangle[:, :size], triangle[:, size]


@lru_cache(maxsize=256)
def _upper(rows: int, columns: int) -> NDArray[np.bool_]:
    """Which places of a matrix are not below its diagonal."""
    return np.arange(rows)[:, None] <= np.arange(columns)
