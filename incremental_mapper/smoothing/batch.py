"""Whole graphs at once: the final solve, and the elimination of all but the frontier.

GTSAM returns without a word on under-constrained graphs and on NaN, so every result is checked
for finite numbers here. Both use QR: on long chains that hardly anything anchors, Cholesky breaks
down. Candidates and windows are solved elsewhere, by normal equations (``gauss_newton``).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from incremental_mapper.smoothing.linear_system import REGULARISING_SIGMA
from incremental_mapper.variables import kind_of


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Optimised variables, and Σ‖h(x)−z‖²_Σ over all factors that were solved."""

    values: gtsam.Values
    error: float


def make_graph(factors: Iterable[gtsam.NonlinearFactor]) -> gtsam.NonlinearFactorGraph:
    """Collect factors in a GTSAM graph."""
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.push_back(factor)
    return graph


def squared_error(factors: Iterable[gtsam.NonlinearFactor], values: gtsam.Values) -> float:
    """Σ‖h(x)−z‖²_Σ; GTSAM's ``error`` is half of it (paper, Minimum Solver Error).

    Args:
        factors: Any factors.
        values: Values of all their variables.

    Returns:
        The sum, without a unit.
    """
    return 2.0 * float(sum(factor.error(values) for factor in factors))


def optimize(
    graph: gtsam.NonlinearFactorGraph, initial: gtsam.Values, max_iterations: int
) -> Solution | None:
    """Levenberg-Marquardt on a whole graph, by QR.

    Args:
        graph: The graph.
        initial: Initial values of all its variables.
        max_iterations: Of Levenberg-Marquardt.

    Returns:
        The optimum; None where it is not finite or the graph cannot be solved.
    """
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(max_iterations)
    parameters.setLinearSolverType('MULTIFRONTAL_QR')
    try:
        optimizer = gtsam.LevenbergMarquardtOptimizer(graph, initial, parameters)
        values = optimizer.optimize()
        error = 2.0 * float(optimizer.error())
    except RuntimeError:
        return None
    # LM hands back the initial values when the error is NaN; the error itself stays NaN.
    if not np.isfinite(error):
        return None
    return Solution(values=values, error=error)


@dataclass(frozen=True, slots=True, eq=False)
class Elimination:
    """A graph split into p(dropped | kept) · p(kept), both linear at ``values``.

    ``conditional`` says how the dropped variables follow the kept ones; ``factors`` are what the
    graph says about the kept ones alone.
    """

    values: gtsam.Values
    conditional: gtsam.GaussianBayesNet
    factors: tuple[gtsam.LinearContainerFactor, ...]


def eliminate(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, dropped: Sequence[int]
) -> Elimination:
    """Eliminate variables in the given order; in time order nothing fills in.

    Variables that the graph leaves undetermined get a regularising prior where they are, so weak
    that it shows nowhere else.
    """
    linear = graph.linearize(values)
    conditional, rest = gtsam.GaussianBayesNet(), linear
    if dropped:
        ordering = gtsam.Ordering()
        for key in dropped:
            ordering.push_back(key)
        try:
            conditional, rest = linear.eliminatePartialSequential(ordering, gtsam.EliminateQR)
        except RuntimeError:
            held = make_graph(
                [*(graph.at(i) for i in range(graph.size())), *_regularising(graph, values)]
            )
            conditional, rest = held.linearize(values).eliminatePartialSequential(
                ordering, gtsam.EliminateQR
            )
    factors = (rest.at(i) for i in range(rest.size()))
    return Elimination(
        values=values,
        conditional=conditional,
        factors=tuple(
            gtsam.LinearContainerFactor(factor, values)
            for factor in factors
            if factor is not None and factor.size() > 0
        ),
    )


def _regularising(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values
) -> list[gtsam.NonlinearFactor]:
    """Regularising priors at the present values on every variable of a graph."""
    priors: list[gtsam.NonlinearFactor] = []
    for key in graph.keyVector():
        kind = kind_of(key)
        model = gtsam.noiseModel.Isotropic.Sigma(3 if kind == 'v' else 6, REGULARISING_SIGMA)
        if kind == 'x':
            priors.append(gtsam.PriorFactorPose3(key, values.atPose3(key), model))
        elif kind == 'v':
            priors.append(gtsam.PriorFactorVector(key, values.atVector(key), model))
        else:
            bias = values.atConstantBias(key)
            priors.append(gtsam.PriorFactorConstantBias(key, bias, model))
    return priors
