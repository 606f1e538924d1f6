"""What G(t) says of its newest part, kept small: a Gaussian over the frontier, and followers.

The frontier are the variables that new factors may touch. Everything older is marginalised, once
and for good, into a square-root information matrix over the frontier; the newest of those older
variables, the followers, still move with it by their linear conditional p(follower | frontier).
All of it is relative to the newest estimates, so the cost of a window depends on nothing but the
window.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import gtsam
import numpy as np
from scipy.linalg.lapack import dgeqrf, dtrtrs

from incremental_mapper.graph.factors import cluster_of
from incremental_mapper.graph.linear import Array, Cholesky, Layout, solve_scaled
from incremental_mapper.graph.solver import LOOSE, copy_value, eliminate, make_graph

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
    """Solves sets of factors on top of a belief.

    ``initial`` holds the new variables; more may be inserted into ``values`` between solves.
    The belief's followers are moved along.
    """

    def __init__(self, belief: Belief, initial: gtsam.Values, max_iterations: int) -> None:
        self._belief = belief
        self._followers = Layout(belief.followers)
        self._followed = belief.values.extract(belief.followers)
        self._max_iterations = max_iterations
        self.values = gtsam.Values(belief.values)
        self.values.insert(initial)

    def solve(
        self, factors: Iterable[gtsam.NonlinearFactor], variables: Iterable[int] = ()
    ) -> Solved | None:
        """Gauss-Newton; None where the result would not be finite.

        Solves for all variables that the factors touch, and ``variables`` besides. Each one that
        is new is also held at its initial value, so loosely (LOOSE) that it shows only where the
        factors leave it undetermined.
        """
        graph = make_graph(factors)
        layout = Layout([*self._belief.keys, *variables, *graph.keyVector()])
        values = self.values.extract(layout.keys)
        system, error = _System(self._belief, layout, graph, values), 2.0 * graph.error(values)
        cost = error + system.prior_error
        for _ in range(self._max_iterations):
            best = system.best()
            if best is None:
                return None
            (step, expected), better = best, False
            for _ in range(HALVINGS):
                moved = values.retract(layout.vector_values(step))
                reached = 2.0 * graph.error(moved)
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
            system = system.relinearized(values)
        if not np.isfinite(error):
            return None
        followed = self._belief.slopes @ system.total[: self._belief.root.shape[1]]
        values.insert(self._followed.retract(self._followers.vector_values(followed)))
        return Solved(values=values, error=error, cost=cost, system=system)

    def learn(self, solved: Solved) -> None:
        """Begin later solves where this one put its new variables: most sets agree on those."""
        new = solved.system.layout.keys[len(self._belief.keys) :]
        self.values.update(solved.values.extract(new))


class _System:
    """Belief, loose hold on new variables and factors as ‖root · δ − rhs‖², and how far it moved.

    The last rows are the factors'. ``total`` (n,) is the step from the belief's values so far.
    """

    __slots__ = ('_columns', '_factor', '_graph', '_held', 'layout', 'rhs', 'root', 'total')

    def __init__(
        self,
        belief: Belief,
        layout: Layout,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
    ) -> None:
        known = belief.root.shape[1]
        self.layout, self._graph = layout, graph
        self._held = len(belief.root) + layout.size - known
        self._columns = layout.columns(graph.keyVector())
        rows = self._rows(values)
        self.root = np.zeros((self._held + len(rows), layout.size))
        self.rhs = np.zeros(len(self.root))
        self.total = np.zeros(layout.size)
        self.root[: len(belief.root), :known] = belief.root
        self.rhs[: len(belief.root)] = belief.rhs
        new = np.arange(layout.size - known)
        self.root[len(belief.root) + new, known + new] = 1.0 / LOOSE
        self._factor: Cholesky | None = None
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

    def best(self) -> tuple[Array, '_System'] | None:
        """The best step from here and the system there, None where it would not be finite.

        Normal equations square the condition of ``root``, which short IMU spans make large; what
        that costs is made good by solving once more for what the first solution leaves.
        """
        try:
            factor = self._factor or Cholesky(self.root.T @ self.root)
        except ValueError:
            return None
        self._factor = factor
        step = factor.solve(self.root.T @ self.rhs)
        if step is None:
            return None
        rest = self.rhs - self.root @ step
        more = factor.solve(self.root.T @ rest)
        if more is not None:
            step, rest = step + more, rest - self.root @ more
        return step, self._there(step, rest)

    def moved(self, step: Array) -> '_System':
        """The same system seen from a place that is ``step`` (n,) away."""
        return self._there(step, self.rhs - self.root @ step)

    def _there(self, step: Array, rhs: Array) -> '_System':
        other = self._copy()
        other.rhs, other.total = rhs, self.total + step
        return other

    def relinearized(self, values: gtsam.Values) -> '_System':
        """The same system with the factors linearised at ``values``."""
        other = self._copy()
        other.root, other.rhs = self.root.copy(), self.rhs.copy()
        other._fill(self._rows(values))
        return other

    def _rows(self, values: gtsam.Values) -> Array:
        """The whitened factors; the last column is their right-hand side."""
        return self._graph.linearize(values).augmentedJacobian()

    def _fill(self, rows: Array) -> None:
        self.root[self._held :, self._columns] = rows[:, :-1]
        self.rhs[self._held :] = rows[:, -1]
        self._factor = None

    def without_nonsense(self) -> '_System':
        """The same system without rows that are not finite."""
        other = self._copy()
        finite = np.isfinite(self.root).all(axis=1) & np.isfinite(self.rhs)
        other.root, other.rhs = self.root[finite], self.rhs[finite]
        return other

    def _copy(self) -> '_System':
        other = object.__new__(_System)
        for name in _System.__slots__:
            setattr(other, name, getattr(self, name))
        return other


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
    if solved is None:
        values, cost = problem.values, np.inf
        layout = Layout([*belief.keys, *initial.keys()])
        system = _System(belief, layout, make_graph(factors), values).without_nonsense()
    else:
        values, cost = solved.values, solved.cost
        system = solved.system.relinearized(values)
    return _larger(belief, system, system.layout.keys, values, clusters, solved is not None), cost


def adopt(
    belief: Belief, solved: Solved, names: Mapping[int, int], clusters: Mapping[int, int]
) -> Belief:
    """Append what was solved on top of the same belief, with fewer followers or not.

    ``names`` are the keys that new variables get in place of those that they were solved under.
    """
    known = belief.root.shape[1]
    keys = solved.system.layout.keys
    new = keys[len(belief.keys) :]
    values = solved.values.extract(belief.keys)
    followers = Layout(belief.followers)
    step = belief.slopes @ solved.system.total[:known]
    moved = belief.values.extract(followers.keys).retract(followers.vector_values(step))
    values.insert(moved)
    for key in new:
        copy_value(solved.values, key, values, names.get(key, key))
    renamed = (*belief.keys, *(names.get(key, key) for key in new))
    system = solved.system.relinearized(solved.values)
    return _larger(belief, system, renamed, values, clusters, healthy=True)


def _larger(
    belief: Belief,
    system: _System,
    keys: tuple[int, ...],
    values: gtsam.Values,
    clusters: Mapping[int, int],
    healthy: bool,
) -> Belief:
    new = system.layout.size - belief.root.shape[1]
    return Belief(
        keys=keys,
        root=system.root,
        rhs=system.rhs,
        followers=belief.followers,
        slopes=np.hstack([belief.slopes, np.zeros((len(belief.slopes), new))]),
        values=values,
        clusters={**belief.clusters, **clusters},
        healthy=healthy,
    )


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
    reduced, rest = _triangle(belief.root[:, np.concatenate([first, last])], belief.rhs)
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


def belief_of(
    factors: Iterable[gtsam.NonlinearFactor],
    values: gtsam.Values,
    clusters: Mapping[int, int],
    keep: Collection[int],
    oldest: int,
) -> tuple[Belief, gtsam.Values]:
    """The belief of a whole graph at its optimum ``values``, and what lies before the lag.

    ``keep`` are the variables of its frontier. Costs a sparse elimination of the graph; ``extend``
    and ``shrink`` do it step by step.
    """
    kept = sorted(set(keep) & set(values.keys()), key=lambda key: (cluster_of(key), key))
    wanted = {cluster_of(key) for key in kept}
    newer = {c for c, stamp in clusters.items() if stamp >= oldest or c in wanted}
    dropped = sorted(set(values.keys()) - set(kept), key=cluster_of)
    split = eliminate(make_graph(factors), values, dropped)
    layout = Layout(kept)
    system = _System(Belief(), layout, make_graph(split.factors), values)
    root, rhs = _triangle(system.root, system.rhs)
    followers = tuple(key for key in dropped if cluster_of(key) in newer)
    follower_layout = Layout(followers)
    slopes = np.zeros((follower_layout.size, layout.size))
    at_rest = split.conditional.optimize(layout.vector_values(np.zeros(layout.size)))
    for column in range(layout.size):
        unit = np.zeros(layout.size)
        unit[column] = 1.0
        moved = split.conditional.optimize(layout.vector_values(unit))
        for key, place in follower_layout.places.items():
            slopes[place, column] = moved.at(key) - at_rest.at(key)
    inside = [key for key in values.keys() if cluster_of(key) in newer]  # noqa: SIM118
    gone = [key for key in values.keys() if cluster_of(key) not in newer]  # noqa: SIM118
    belief = Belief(
        keys=layout.keys,
        root=root,
        rhs=rhs,
        followers=followers,
        slopes=slopes,
        values=values.extract(inside),
        clusters={c: s for c, s in clusters.items() if c in newer},
    )
    return belief, values.extract(gone)


def _triangle(matrix: Array, rhs: Array) -> tuple[Array, Array]:
    """R (n, n) and c (n,) of ‖matrix · δ − rhs‖² = ‖R · δ − c‖² + constant, m >= n rows."""
    size = matrix.shape[1]
    packed, _, _, _ = dgeqrf(np.column_stack([matrix, rhs]), overwrite_a=1)
    triangle = np.triu(packed[:size])
    return triangle[:, :size], triangle[:, size]
