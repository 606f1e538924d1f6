"""What G(t) says of its newest part, kept small: a Gaussian over the frontier, and followers.

The frontier are the variables that new factors may touch. Everything older is marginalised, once
and for good, into a square-root information matrix over the frontier; the newest of those older
variables, the followers, still move with it by their linear conditional p(follower | frontier).
All of it is relative to the newest estimates, so the cost of a window depends on nothing but the
window.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import gtsam
import numpy as np
from scipy.linalg.lapack import dgeqrf, dtrtrs

from incremental_mapper.graph.factors import cluster_of
from incremental_mapper.graph.linear import Array, Layout, solve_scaled


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """Frontier and followers, linear around ``values``.

    ``keys`` are the frontier's variables; what G(t) says of a tangent step δ (n,) of them is
    ‖root · δ − rhs‖², with ``root`` (m, n) and ``rhs`` (m,). ``values`` are the newest estimates;
    where the last solve converged they are the mean, and ``rhs`` is zero up to a constant.
    ``followers`` move by ``slopes`` (f, n) · δ. ``values`` holds both kinds; ``clusters`` are the
    cluster ids in it with their stamps (ns). ``healthy`` is False where the last window could not
    be solved and stays at its initial values.
    """

    keys: tuple[int, ...] = ()
    root: Array = field(default_factory=lambda: np.zeros((0, 0)))
    rhs: Array = field(default_factory=lambda: np.zeros(0))
    followers: tuple[int, ...] = ()
    slopes: Array = field(default_factory=lambda: np.zeros((0, 0)))
    values: gtsam.Values = field(default_factory=gtsam.Values)
    clusters: Mapping[int, int] = field(default_factory=dict)
    healthy: bool = True

    def covariance(self, key: int) -> Array | None:
        """Marginal covariance (d, d) of a frontier variable; None where it is undetermined."""
        layout = Layout(self.keys)
        columns = layout.columns([key])
        unit = np.zeros((layout.size, len(columns)))
        unit[columns, np.arange(len(columns))] = 1.0
        solution = solve_scaled(self.root.T @ self.root, unit)
        return None if solution is None else solution[columns]


def shrink(belief: Belief, keep: Collection[int], oldest: int) -> tuple[Belief, gtsam.Values]:
    """Leave only the variables ``keep`` in the frontier; the others become followers.

    Followers of clusters older than the stamp ``oldest`` (ns), of which nothing is kept, are let
    go: their final values come back beside the smaller belief.
    """
    layout = Layout(belief.keys)
    kept = tuple(key for key in layout.keys if key in keep)
    dropped = tuple(key for key in layout.keys if key not in keep)
    wanted = {cluster_of(key) for key in kept}
    first, last = layout.columns(dropped), layout.columns(kept)
    reduced, rest = triangle(belief.root[:, np.concatenate([first, last])], belief.rhs)
    count = len(first)
    # Where the last solve did not converge, the dropped ones still have a way to go: the last
    # column.
    solved = np.column_stack([-reduced[:count, count:], rest[:count]])
    if count:
        solved, _ = dtrtrs(reduced[:count, :count], solved)
    moves = np.vstack([belief.slopes[:, first] @ solved, solved])
    slopes, ahead = moves[:, :-1], moves[:, -1]
    slopes[: len(belief.slopes)] += belief.slopes[:, last]
    followers = Layout([*belief.followers, *dropped])
    gone_clusters = {
        cluster
        for cluster, stamp in belief.clusters.items()
        if stamp < oldest and cluster not in wanted
    }
    values = belief.values.retract(followers.vector_values(ahead))
    stays = [key for key in followers.keys if cluster_of(key) not in gone_clusters]
    gone = values.extract([key for key in followers.keys if cluster_of(key) in gone_clusters])
    if gone_clusters:
        values = values.extract([*kept, *stays])
        slopes = slopes[followers.columns(stays)]
    smaller = Belief(
        keys=kept,
        root=reduced[count:, count:],
        rhs=rest[count:],
        followers=tuple(stays),
        slopes=slopes,
        values=values,
        clusters={c: s for c, s in belief.clusters.items() if c not in gone_clusters},
        healthy=belief.healthy,
    )
    return smaller, gone


def trimmed(belief: Belief, followers: Collection[int]) -> Belief:
    """The belief with no other followers than these."""
    layout = Layout(belief.followers)
    kept = [key for key in belief.followers if key in followers]
    return replace(
        belief,
        followers=tuple(kept),
        slopes=belief.slopes[layout.columns(kept)],
        values=belief.values.extract([*belief.keys, *kept]),
    )


def triangle(matrix: Array, rhs: Array) -> tuple[Array, Array]:
    """R (n, n) and c (n,) of ‖matrix · δ − rhs‖² = ‖R · δ − c‖² + constant, m >= n rows."""
    size = matrix.shape[1]
    packed, _, _, _ = dgeqrf(np.column_stack([matrix, rhs]), overwrite_a=1)
    triangle = np.triu(packed[:size])
    return triangle[:, :size], triangle[:, size]
