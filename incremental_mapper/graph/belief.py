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
"""A solve has converged where the linear error is the true one, or the step makes the linear
cost no smaller, to this, relative to 1 + error."""
HALVINGS = 8
"""How often a step is halved until it makes the cost smaller."""


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


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """Optimised variables.

    ``values`` has the new estimates, those of followers included. ``error`` is
    Σ‖h(x)−z‖²_Σ of the factors, ``cost`` the same with what the belief says against the step.
    ``system`` is all of it, linear somewhere near.
    """

    values: gtsam.Values
    error: float
    cost: float
    system: '_System'


class Problem:
    """Solves sets of factors on top of a belief; what sets share is linearised once.

    ``initial`` holds the new variables; more may be inserted into ``values`` between solves.
    The belief's followers are moved along.
    """

    def __init__(self, belief: Belief, initial: gtsam.Values, max_iterations: int) -> None:
        self._belief = belief
        self._followers = Layout(belief.followers)
        self._max_iterations = max_iterations
        self._rows: dict[gtsam.NonlinearFactor, Rows] = {}
        self.values = gtsam.Values(belief.values)
        self.values.insert(initial)

    def solve(
        self, factors: Sequence[gtsam.NonlinearFactor], variables: Iterable[int] = ()
    ) -> Solved | None:
        """Gauss-Newton; None where the result would not be finite.

        Solves for all variables that the factors touch, and ``variables`` besides. Each one that
        is new is also held at its initial value, so loosely (LOOSE) that it shows only where the
        factors leave it undetermined.
        """
        belief = self._belief
        touched = chain.from_iterable(factor.keys() for factor in factors)
        layout = Layout([*belief.keys, *variables, *touched])
        values, error = self.values, squared_error(factors, self.values)
        system = _System(belief, layout, [self._shared(factor) for factor in factors])
        cost = error + system.prior_error
        for _ in range(self._max_iterations):
            step = system.step()
            if step is None:
                return None
            expected = system.moved(step)
            better = False
            for _ in range(HALVINGS):
                moved = values.retract(layout.vector_values(step))
                reached = squared_error(factors, moved)
                better = reached + expected.prior_error <= cost * (1.0 + 1e-6) + 1e-9
                if better:
                    break
                step = step / 2.0
                expected = system.moved(step)
            if not better:
                break  # no shorter step helps either: this is as good as it gets
            small = AGREEMENT * (1.0 + expected.error)
            settled = abs(reached - expected.error) <= small or system.cost - expected.cost <= small
            values, error, system = moved, reached, expected
            cost = error + system.prior_error
            if settled:
                break
            system = system.relinearized([linearize(factor, values) for factor in factors])
        if not np.isfinite(error):
            return None
        followed = belief.slopes @ system.total[: len(belief.root.T)]
        return Solved(
            values=values.retract(self._followers.vector_values(followed)),
            error=error,
            cost=cost,
            system=system,
        )

    def _shared(self, factor: gtsam.NonlinearFactor) -> Rows:
        rows = self._rows.get(factor)
        if rows is None:
            rows = self._rows[factor] = linearize(factor, self.values)
        return rows


class _System:
    """Belief, loose hold on new variables and factors as ‖root · δ − rhs‖², and how far it moved.

    The last rows are the factors'. ``total`` (n,) is the step from the belief's values so far.
    """

    __slots__ = ('_held', '_normal', 'layout', 'rhs', 'root', 'total')

    def __init__(self, belief: Belief, layout: Layout, rows: Sequence[Rows]) -> None:
        known = belief.root.shape[1]
        self.layout, self._held = layout, len(belief.root) + layout.size - known
        self._normal: Array | None = None
        count = self._held + sum(len(row.rhs) for row in rows)
        self.root, self.rhs = np.zeros((count, layout.size)), np.zeros(count)
        self.total = np.zeros(layout.size)
        self.root[: len(belief.root), :known] = belief.root
        self.rhs[: len(belief.root)] = belief.rhs
        new = np.arange(layout.size - known)
        self.root[len(belief.root) + new, known + new] = 1.0 / LOOSE
        self._fill(rows)

    @property
    def prior_error(self) -> float:
        """What belief and loose hold say against the step so far."""
        rest = self.rhs[: self._held]
        return float(rest @ rest)

    @property
    def error(self) -> float:
        """Σ‖h(x)−z‖²_Σ of the factors, as far as they are linear."""
        rest = self.rhs[self._held :]
        return float(rest @ rest)

    @property
    def cost(self) -> float:
        """Both together."""
        return float(self.rhs @ self.rhs)

    def step(self) -> Array | None:
        """The best step from here, or None where it would not be finite.

        Normal equations square the condition of ``root``, which short IMU spans make large; what
        that costs is made good by solving once more for what the first solution leaves.
        """
        if self._normal is None:
            self._normal = self.root.T @ self.root
        first = solve_scaled(self._normal, self.root.T @ self.rhs)
        if first is None:
            return None
        rest = self.root.T @ (self.rhs - self.root @ first)
        second = solve_scaled(self._normal, rest)
        return first if second is None else first + second

    def moved(self, step: Array) -> '_System':
        """The same system seen from a place that is ``step`` (n,) away."""
        other = self._copy()
        other.rhs = self.rhs - self.root @ step
        other.total = self.total + step
        return other

    def relinearized(self, rows: Sequence[Rows]) -> '_System':
        """The same system with the factors linearised anew."""
        other = self._copy()
        other.root, other.rhs, other._normal = self.root.copy(), self.rhs.copy(), None
        other.root[self._held :] = 0.0
        other._fill(rows)
        return other

    def _copy(self) -> '_System':
        other = object.__new__(_System)
        for name in _System.__slots__:
            setattr(other, name, getattr(self, name))
        return other

    def _fill(self, rows: Sequence[Rows]) -> None:
        first = self._held
        for row in rows:
            last = first + len(row.rhs)
            self.root[first:last, self.layout.columns(row.keys)] = row.matrix
            self.rhs[first:last] = row.rhs
            first = last


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
    solved = problem.solve(factors, initial.keys())
    values = problem.values if solved is None else solved.values
    rows = [linearize(factor, values) for factor in factors]
    if solved is None:
        layout = Layout([*belief.keys, *initial.keys()])
        system, cost = _System(belief, layout, [row for row in rows if row.finite]), np.inf
    else:
        system, cost = solved.system.relinearized(rows), solved.cost
    new = system.layout.size - belief.root.shape[1]
    larger = Belief(
        keys=system.layout.keys,
        root=system.root,
        rhs=system.rhs,
        followers=belief.followers,
        slopes=np.hstack([belief.slopes, np.zeros((len(belief.slopes), new))]),
        values=values,
        clusters={**belief.clusters, **clusters},
        healthy=solved is not None,
    )
    return larger, cost


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
    reduced, rest = _triangle(belief.root[:, np.concatenate([first, last])], belief.rhs)
    count = len(first)
    upper = reduced[:count, :count]
    follow_kept = -solve_triangular(upper, reduced[:count, count:])
    slopes = np.vstack(
        [belief.slopes[:, last] + belief.slopes[:, first] @ follow_kept, follow_kept]
    )
    # Where the last solve did not converge, the dropped ones still have a way to go.
    ahead = solve_triangular(upper, rest[:count])
    ahead = np.concatenate([belief.slopes[:, first] @ ahead, ahead])
    followers = Layout([*belief.followers, *dropped])
    gone_clusters = {
        cluster
        for cluster, stamp in belief.clusters.items()
        if stamp < oldest and cluster not in wanted
    }
    values, gone = belief.values.retract(followers.vector_values(ahead)), gtsam.Values()
    stays = list(followers.keys)
    if gone_clusters:
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
    system = _System(Belief(), layout, rows)
    root, rhs = _triangle(system.root, system.rhs)
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
        root=root,
        rhs=rhs,
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


def _triangle(matrix: Array, rhs: Array) -> tuple[Array, Array]:
    """R (n, n) and c (n,) of ‖matrix · δ − rhs‖² = ‖R · δ − c‖² + constant, m >= n rows."""
    size = matrix.shape[1]
    triangle = np.asarray(np.linalg.qr(np.column_stack([matrix, rhs]), mode='r'))
    return triangle[:size, :size], triangle[:size, size]
