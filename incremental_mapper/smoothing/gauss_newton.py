"""Gauss-Newton on top of a marginal prior: one set of factors, or many that share most of it.

GTSAM evaluates and linearises the factors. The steps are solved by normal equations, refined once,
since problems are small and there are many; ``batch`` solves whole graphs, by QR.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import isfinite

import gtsam
import numpy as np

from incremental_mapper.smoothing.batch import make_graph
from incremental_mapper.smoothing.linear_system import (
    Array,
    Layout,
    PriorRows,
    Rest,
    System,
    layout_of,
)
from incremental_mapper.smoothing.marginal_prior import MarginalPrior
from incremental_mapper.smoothing.tangent import Pivoted, linearised, retracted
from incremental_mapper.variables import LETTER, VELOCITY, cluster_of, kind_of, pose_key

AGREEMENT = 1e-4
"""A solve has converged where the linear error is the true one, or the step makes the linear
cost no smaller, to this, relative to 1 + error."""
AT_REST = 1e-6
"""A step is not worth taking where it makes the linear cost no smaller than this, relative to
1 + cost."""
HALVINGS = 8
"""How often a step is halved until it makes the cost smaller."""
NEAR = 0.01
"""Radians that a set's poses may turn from where its factors were linearised: that far, errors
are right to about a thousandth of 1 + error."""


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """Optimised variables: ``step`` (n,) away from where they are in ``start``.

    ``reached`` has them, where they have been made already, and no others.

    ``error`` is Σ‖h(x)−z‖²_Σ of the factors, ``cost`` the same with what the prior says against
    the step. ``system`` is all of it, linear somewhere near. ``eliminated`` is the layout of the
    variables that the prior eliminated.
    ``graph`` holds the factors; where it is None, the errors are those of the linear system.
    """

    prior: MarginalPrior
    eliminated: Layout
    start: Pivoted
    step: Array
    reached: gtsam.Values | None
    error: float
    cost: float
    system: System
    graph: gtsam.NonlinearFactorGraph | None

    def own(self) -> gtsam.Values:
        """Estimates of the variables that were solved for; not to be changed."""
        if self.reached is not None:
            return self.reached
        layout = self.system.layout
        here = Pivoted(self.start.values.extract(layout.keys), self.start.pivot)
        return retracted(here, layout, self.step)

    @property
    def values(self) -> gtsam.Values:
        """All estimates, those of eliminated variables included."""
        values, known, prior = gtsam.Values(self.own()), self.system.known, self.prior
        moved = prior.pending_delta + prior.gains @ self.system.total[:known]
        before = prior.base.extract(prior.eliminated)
        values.insert(before.retract(self.eliminated.vector_values(moved)))
        return values

    def pose(self, key: int) -> gtsam.Pose3 | None:
        """Estimate of one pose; None where it is neither solved for nor eliminated."""
        if (place := self.system.layout.places.get(key)) is not None:
            if self.reached is not None:
                return self.reached.atPose3(key)
            return self.start.values.atPose3(key).retract(
                self.start.own_step(key, self.step[place])
            )
        if (place := self.eliminated.places.get(key)) is not None:
            moved = self.prior.gains[place] @ self.system.total[: self.system.known]
            return self.prior.base.atPose3(key).retract(self.prior.pending_delta[place] + moved)
        return None

    def linear(self) -> System:
        """The system, linearised at the solution."""
        if self.graph is None or not self.step.any():
            return self.system
        here = Pivoted(self.own(), self.prior.pivot)
        rows = linearised(self.system.layout, self.graph, here)
        return self.system.relinearized(*rows)


class Problem:
    """Solves sets of factors on top of a prior, each by itself.

    ``initial`` holds the new variables. What the prior eliminated moves along.
    """

    def __init__(self, prior: MarginalPrior, initial: gtsam.Values, max_iterations: int) -> None:
        self._prior = prior
        self._eliminated = layout_of(prior.eliminated)
        self._known = layout_of(prior.keys)
        self._max_iterations = max_iterations
        self._rows = PriorRows(prior.root)
        # How far the frontier's ``values`` are from those of the prior.
        self._total = np.zeros(self._known.size)
        self._rhs = prior.rhs
        self.values = gtsam.Values(prior.base)
        self.values.insert(initial)

    def solve(
        self, factors: Iterable[gtsam.NonlinearFactor], variables: Iterable[int] = ()
    ) -> Solved | None:
        """Gauss-Newton; None where the result would not be finite.

        Solves for all variables that the factors touch, and ``variables`` besides. Each one that
        is new also gets a regularising prior at its initial value, so weak that it shows only
        where the factors leave it undetermined.
        """
        graph = make_graph(factors)
        layout = self._known.followed_by([*variables, *graph.keyVector()])
        here = Pivoted(self.values.extract(layout.keys), self._prior.pivot)
        system = self._system(layout, *linearised(layout, graph, here))
        return self._descend(graph, here, system)

    def refine(self, solved: Solved, factors: Iterable[gtsam.NonlinearFactor]) -> Solved | None:
        """Go on from the solution of the same factors until it has truly converged."""
        if solved.graph is not None:
            return solved
        graph, here = make_graph(factors), Pivoted(solved.own(), self._prior.pivot)
        system = solved.system.relinearized(*linearised(solved.system.layout, graph, here))
        return self._descend(graph, here, system)

    def _descend(
        self, graph: gtsam.NonlinearFactorGraph, here: Pivoted, system: System
    ) -> Solved | None:
        """Gauss-Newton from ``here``, where the system was linearised."""
        layout, error, pivot = system.layout, 2.0 * graph.error(here.values), here.pivot
        cost, last, there = error + system.prior_error, np.zeros(layout.size), here.values
        for _ in range(self._max_iterations):
            best = system.best()
            if best is None:
                return None
            (step, expected), better = best, False
            if system.cost - expected.cost <= AT_REST * (1.0 + cost):
                break
            for _ in range(HALVINGS):
                moved = retracted(here, layout, step)
                reached = 2.0 * graph.error(moved)
                better = reached + expected.prior_error <= cost * (1.0 + 1e-6) + 1e-9
                if better:
                    break
                step = step / 2.0
                expected = system.moved(step)
            if not better:
                break  # no shorter step helps either: this is as good as it gets
            small = AGREEMENT * (1.0 + expected.error)
            converged = (
                abs(reached - expected.error) <= small or system.cost - expected.cost <= small
            )
            last, there, error, system = step, moved, reached, expected
            cost = error + system.prior_error
            if converged:
                break
            here, last = Pivoted(moved, pivot), np.zeros(layout.size)
            system = system.relinearized(*linearised(layout, graph, here))
        if not isfinite(error):
            return None
        return self._solved(here, last, there, error, system, graph)

    def _system(self, layout: Layout, rows: Array, rhs: Array) -> System:
        """The prior and factors around ``values``."""
        total = np.zeros(layout.size)
        total[: len(self._total)] = self._total
        rest = Rest(self._rhs, np.zeros(layout.size - len(self._total)), rhs)
        return System(self._rows, layout, rows, rest, total)

    def _solved(
        self,
        start: Pivoted,
        step: Array,
        reached: gtsam.Values | None,
        error: float,
        system: System,
        graph: gtsam.NonlinearFactorGraph | None,
    ) -> Solved:
        return Solved(
            prior=self._prior,
            eliminated=self._eliminated,
            start=start,
            step=step,
            reached=reached,
            error=error,
            cost=error + system.prior_error,
            system=system,
            graph=graph,
        )


class SharedProblem(Problem):
    """Sets of factors on top of one prior that have most of their factors in common.

    A window's candidates are such sets. The first one is solved by itself. The others are linear
    around its solution: all that they need is one linear step.
    A set whose solution is not NEAR, or changes the weight of a robust factor, is solved by itself.
    ``values`` must hold all variables of a set before it is solved.
    """

    def __init__(self, prior: MarginalPrior, max_iterations: int) -> None:
        super().__init__(prior, gtsam.Values(), max_iterations)
        self._looked: dict[int, _Looked] = {}
        self._here = Pivoted(self.values, prior.pivot)  # of all sets but the first
        self._started = False

    def solve_next(self, factors: Sequence[gtsam.NonlinearFactor]) -> Solved | None:
        """The optimum of a set; None where it would not be finite."""
        if not self._started:
            solved = self.solve(factors)
            if solved is not None:
                self._start_from(solved)
            return solved
        looked = [self._look(factor) for factor in factors]
        layout = self._known.followed_by(key for item in looked for key in item.keys)
        graph = make_graph(factors)
        system = self._system(layout, *linearised(layout, graph, self._here))
        best = system.best()
        if best is None or not _is_near(best[0], layout):
            return self.solve(factors)
        step, there = best
        robust = [item.robust for item in looked if item.robust is not None]
        error = there.error + sum(item.apart for item in robust)
        solved = self._solved(self._here, step, None, error, there, None)
        if any(self._reweighs(item, step, layout, error) for item in robust):
            return self.refine(solved, factors)
        return solved

    def _reweighs(self, item: '_Robust', step: Array, layout: Layout, error: float) -> bool:
        """Whether a robust factor's error differs from the linear one after a step."""
        moved = step[layout.columns(item.layout.keys)]
        here = Pivoted(self.values.extract(item.layout.keys), self._prior.pivot)
        values = retracted(here, item.layout, moved)
        rest = item.rows @ moved - item.rhs
        linear = float(rest @ rest) + item.apart
        return abs(2.0 * item.factor.error(values) - linear) > AGREEMENT * (1.0 + error)

    def _start_from(self, solved: Solved) -> None:
        """Linearise the later sets around this solution."""
        self._started = True
        self._total = solved.system.total[: self._known.size].copy()
        self._rhs = self._prior.rhs - self._prior.root @ self._total
        self.values.update(solved.own())

    def _look(self, factor: gtsam.NonlinearFactor) -> '_Looked':
        """What is to be known of a factor, found out once."""
        known = self._looked.get(id(factor))
        if known is None:
            keys = tuple(factor.keys())
            # The step of a velocity turns with its pose.
            for velocity in keys:
                if velocity >> LETTER == VELOCITY:
                    pose = pose_key(cluster_of(velocity))
                    if pose not in keys and self.values.exists(pose):
                        keys = (*keys, pose)
            model = getattr(factor, 'noiseModel', lambda: None)()
            robust = None
            if isinstance(model, gtsam.noiseModel.Robust):
                layout = layout_of(keys)
                rows, rhs = linearised(layout, make_graph([factor]), self._here)
                apart = 2.0 * factor.error(self.values) - float(rhs @ rhs)
                robust = _Robust(factor, layout, rows, rhs, apart)
            known = self._looked[id(factor)] = _Looked(factor, keys, robust)
        return known


@dataclass(frozen=True, slots=True, eq=False)
class _Robust:
    """A robust factor as whitened ``rows`` (r, n) and ``rhs`` (r,) over the keys of its ``layout``.

    ``apart`` is the true Σ‖h(x)−z‖²_Σ less the linear one: that of a robust loss grows slower than
    the square that stands for it.
    """

    factor: gtsam.NonlinearFactor
    layout: Layout
    rows: Array
    rhs: Array
    apart: float


@dataclass(frozen=True, slots=True, eq=False)
class _Looked:
    """A factor, its keys with the poses of its velocities, and what it is where it is robust."""

    factor: gtsam.NonlinearFactor
    keys: tuple[int, ...]
    robust: _Robust | None


def _is_near(step: Array, layout: Layout) -> bool:
    """Whether no pose turns by more than NEAR."""
    sizes = np.abs(step)
    if sizes.max(initial=0.0) <= NEAR:
        return True
    turns = [
        index
        for key, place in layout.places.items()
        if kind_of(key) == 'x'
        for index in range(place.start, place.start + 3)
    ]
    return bool(sizes[turns].max(initial=0.0) <= NEAR)


def linear_system(
    prior: MarginalPrior, layout: Layout, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values
) -> System:
    """The prior and factors, linearised at ``values``."""
    rows, rhs = linearised(layout, graph, Pivoted(values, prior.pivot))
    regularising = np.zeros(layout.size - prior.root.shape[1])
    total = np.zeros(layout.size)
    return System(PriorRows(prior.root), layout, rows, Rest(prior.rhs, regularising, rhs), total)
