"""What G(t) says of its newest part, kept small: a Gaussian over the frontier, and followers.

The frontier are the variables that new factors may touch. Everything older is marginalised, once
and for good, into a square-root information matrix over the frontier; the newest of those older
variables, the followers, still move with it by their linear conditional p(follower | frontier).
All of it is relative to the newest estimates, so the cost of a window depends on nothing but the
window.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain

import gtsam
import numpy as np
from scipy.linalg import solve_triangular

from incremental_mapper.graph.factors import bias_key, pose_key, velocity_key
from incremental_mapper.graph.linear import Array, Layout, Rows, linearize, solve_scaled
from incremental_mapper.graph.solver import (
    LOOSE,
    copy_value,
    eliminate,
    make_graph,
    squared_error,
)

AGREEMENT = 1e-4
"""A solve has converged where the linear error is the true one to this, relative to 1 + error."""
HALVINGS = 8
"""How often a step is halved until it makes the cost smaller."""


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """Frontier and followers, linear around their newest estimates.

    ``keys`` are the frontier's variables; what G(t) says of a tangent step δ (n,) of them is
    ‖root · δ‖², with ``root`` (m, n). ``followers`` move by ``slopes`` (f, n) · δ. ``values``
    holds both kinds; ``clusters`` are the cluster ids in it with their stamps (ns). ``healthy``
    is False where the last window could not be solved and stays at its initial values.
    """

    keys: tuple[int, ...] = ()
    root: Array = field(default_factory=lambda: np.zeros((0, 0)))
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


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """Optimised variables.

    ``values`` has the new estimates, those of followers included. ``error`` is
    Σ‖h(x)−z‖²_Σ of the factors, ``cost`` the same with what the belief says against the step.
    """

    values: gtsam.Values
    error: float
    cost: float


class Problem:
    """Solves sets of factors on top of a belief; what sets share is linearised once.

    ``initial`` holds the new variables; more may be inserted into ``values`` between solves.
    The belief's followers are moved along.
    """

    def __init__(self, belief: Belief, initial: gtsam.Values, max_iterations: int) -> None:
        self._belief = belief
        self._information = belief.root.T @ belief.root
        self._followers = Layout(belief.followers)
        self._max_iterations = max_iterations
        self._rows: dict[gtsam.NonlinearFactor, Rows] = {}
        self.values = gtsam.Values(belief.values)
        self.values.insert(initial)

    def solve(self, factors: Sequence[gtsam.NonlinearFactor]) -> Solved | None:
        """Gauss-Newton; None where the result would not be finite.

        Each variable that is new is also held at its initial value, so loosely (LOOSE) that it
        shows only where the factors leave it undetermined.
        """
        touched = chain.from_iterable(factor.keys() for factor in factors)
        layout = Layout([*self._belief.keys, *touched])
        width = len(self._information)
        prior = np.zeros((layout.size, layout.size))
        prior[:width, :width] = self._information
        np.fill_diagonal(prior[width:, width:], LOOSE**-2)
        values, total = self.values, np.zeros(layout.size)
        error = squared_error(factors, values)
        rows = [self._shared(factor) for factor in factors]
        columns = [layout.columns(row.keys) for row in rows]
        for _ in range(self._max_iterations):
            information, gradient = prior.copy(), -prior @ total
            for row, own in zip(rows, columns, strict=True):
                information[own[:, None], own] += row.information
                gradient[own] += row.gradient
            step = solve_scaled(information, gradient)
            if step is None:
                return None
            expected = sum(row.error(step[own]) for row, own in zip(rows, columns, strict=True))
            before = error + float(total @ prior @ total)
            better = False
            for _ in range(HALVINGS):
                moved = values.retract(layout.vector_values(step))
                reached, there = squared_error(factors, moved), total + step
                better = reached + float(there @ prior @ there) <= before * (1.0 + 1e-6) + 1e-9
                if better:
                    break
                step = step / 2.0
                expected = np.inf
            if not better:
                break  # no shorter step helps either: this is as good as it gets
            values, total, error = moved, there, reached
            if abs(error - expected) <= AGREEMENT * (1.0 + expected):
                break
            rows = [linearize(factor, values) for factor in factors]
        if not np.isfinite(error):
            return None
        followed = self._followers.vector_values(self._belief.slopes @ total[:width])
        return Solved(values.retract(followed), error, error + float(total @ prior @ total))

    def _shared(self, factor: gtsam.NonlinearFactor) -> Rows:
        rows = self._rows.get(factor)
        if rows is None:
            rows = self._rows[factor] = linearize(factor, self.values)
        return rows


def extend(
    belief: Belief,
    factors: Sequence[gtsam.NonlinearFactor],
    initial: gtsam.Values,
    clusters: Mapping[int, int],
    max_iterations: int,
) -> tuple[Belief, float]:
    """Append factors and variables, and solve; all new variables join the frontier.

    The cost of the solution comes back beside the larger belief, infinite where there is none.
    """
    problem = Problem(belief, initial, max_iterations)
    solved = problem.solve(factors)
    values = problem.values if solved is None else solved.values
    layout = Layout([*belief.keys, *initial.keys()])
    known = belief.root.shape[1]
    new = layout.size - known
    rows = [linearize(factor, values) for factor in factors]
    pieces = [np.hstack([belief.root, np.zeros((len(belief.root), new))])]
    pieces.append(np.hstack([np.zeros((new, known)), np.eye(new) / LOOSE]))
    pieces += [_spread(row, layout) for row in rows if np.isfinite(row.matrix).all()]
    slopes = np.hstack([belief.slopes, np.zeros((len(belief.slopes), new))])
    larger = Belief(
        keys=layout.keys,
        root=np.vstack(pieces),
        followers=belief.followers,
        slopes=slopes,
        values=values,
        clusters={**belief.clusters, **clusters},
        healthy=solved is not None,
    )
    return larger, np.inf if solved is None else solved.cost


def shrink(belief: Belief, keep: Collection[int], oldest: int) -> tuple[Belief, gtsam.Values]:
    """Leave only the clusters ``keep`` in the frontier; the others become followers.

    Followers of clusters older than the stamp ``oldest`` (ns) are let go: their final values come
    back beside the smaller belief.
    """
    layout = Layout(belief.keys)
    wanted = set(keep)
    kept = tuple(key for key in layout.keys if gtsam.Symbol(key).index() in wanted)
    dropped = tuple(key for key in layout.keys if gtsam.Symbol(key).index() not in wanted)
    first, last = layout.columns(dropped), layout.columns(kept)
    reduced = _triangle(belief.root[:, np.concatenate([first, last])])
    count = len(first)
    follow_kept = -solve_triangular(reduced[:count, :count], reduced[:count, count:])
    slopes = np.vstack(
        [belief.slopes[:, last] + belief.slopes[:, first] @ follow_kept, follow_kept]
    )
    followers = Layout([*belief.followers, *dropped])
    gone_clusters = {
        cluster
        for cluster, stamp in belief.clusters.items()
        if stamp < oldest and cluster not in wanted
    }
    values, gone, stays = belief.values, gtsam.Values(), list(followers.keys)
    if gone_clusters:
        values = gtsam.Values(values)
        stays = []
        for key in followers.keys:
            if gtsam.Symbol(key).index() in gone_clusters:
                copy_value(values, key, gone)
                values.erase(key)
            else:
                stays.append(key)
        slopes = slopes[followers.columns(stays)]
    smaller = Belief(
        keys=kept,
        root=reduced[count:, count:],
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
    return replace(belief, followers=tuple(kept), slopes=belief.slopes[layout.columns(kept)])


def belief_of(
    factors: Iterable[gtsam.NonlinearFactor],
    values: gtsam.Values,
    clusters: Mapping[int, int],
    keep: Collection[int],
    oldest: int,
) -> tuple[Belief, gtsam.Values]:
    """The belief of a whole graph at its optimum ``values``, and what lies before the lag.

    Costs a sparse elimination of the graph; ``extend`` and ``shrink`` do it step by step.
    """
    newer = {c for c, stamp in clusters.items() if stamp >= oldest or c in set(keep)}
    kept = [key for cluster in sorted(keep) for key in cluster_keys(cluster, values)]
    dropped = sorted(set(values.keys()) - set(kept), key=lambda key: gtsam.Symbol(key).index())
    split = eliminate(make_graph(factors), values, dropped)
    layout = Layout(kept)
    rows = [linearize(factor, values) for factor in split.factors]
    pieces = [np.eye(layout.size) / LOOSE, *(_spread(row, layout) for row in rows)]
    followers = tuple(key for key in dropped if gtsam.Symbol(key).index() in newer)
    follower_layout = Layout(followers)
    slopes = np.zeros((follower_layout.size, layout.size))
    at_rest = split.conditional.optimize(layout.vector_values(np.zeros(layout.size)))
    for column in range(layout.size):
        unit = np.zeros(layout.size)
        unit[column] = 1.0
        moved = split.conditional.optimize(layout.vector_values(unit))
        for key, place in follower_layout.places.items():
            slopes[place, column] = moved.at(key) - at_rest.at(key)
    inside, gone = gtsam.Values(), gtsam.Values()
    for key in values.keys():  # noqa: SIM118 (no mapping)
        copy_value(values, key, inside if gtsam.Symbol(key).index() in newer else gone)
    belief = Belief(
        keys=layout.keys,
        root=_triangle(np.vstack(pieces)),
        followers=followers,
        slopes=slopes,
        values=inside,
        clusters={c: s for c, s in clusters.items() if c in newer},
    )
    return belief, gone


def cluster_keys(cluster: int, values: gtsam.Values) -> list[int]:
    """The keys of a cluster's variables that exist in ``values``."""
    keys = (pose_key(cluster), velocity_key(cluster), bias_key(cluster))
    return [key for key in keys if values.exists(key)]


def _spread(rows: Rows, layout: Layout) -> Array:
    """The rows' matrix in the columns of a layout."""
    spread = np.zeros((len(rows.rhs), layout.size))
    spread[:, layout.columns(rows.keys)] = rows.matrix
    return spread


def _triangle(matrix: Array) -> Array:
    """The upper triangular R of Q R = ``matrix`` (m, n), m >= n."""
    triangle: Array = np.asarray(np.linalg.qr(matrix, mode='r'))
    return triangle
