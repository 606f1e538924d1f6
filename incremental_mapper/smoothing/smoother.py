"""The smoother: marginal priors that take in new factors, what was solved, or a whole graph."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace

import gtsam
import numpy as np

from incremental_mapper.smoothing.batch import eliminate, make_graph
from incremental_mapper.smoothing.gauss_newton import Problem, Solved, linear_system
from incremental_mapper.smoothing.linear_system import Layout, System
from incremental_mapper.smoothing.marginal_prior import (
    MarginalPrior,
    pivot_of,
    triangle,
    with_poses,
)
from incremental_mapper.smoothing.tangent import Pivoted, from_own_columns
from incremental_mapper.variables import cluster_of, copy_value


def smoother_update(
    prior: MarginalPrior,
    factors: Sequence[gtsam.NonlinearFactor],
    initial: gtsam.Values,
    clusters: Mapping[int, int],
    max_iterations: int,
) -> tuple[MarginalPrior, float]:
    """Append factors and variables to a marginal prior, and solve.

    Args:
        prior: What G(t-1) says of its frontier.
        factors: New factors.
        initial: Initial values of the new variables.
        clusters: Stamps (ns) of the new clusters, by id.
        max_iterations: Of Gauss-Newton.

    Returns:
        The larger prior, whose frontier holds all new variables, and the cost of the solution:
        Σ‖h(x)−z‖²_Σ with what the prior says against it, infinite where there is no solution.
    """
    problem = Problem(prior, initial, max_iterations)
    solved = problem.solve(factors, initial.keys())
    if solved is not None:
        return commit_solution(prior, solved, {}, clusters), solved.cost
    layout = Layout([*prior.keys, *initial.keys()])
    system = linear_system(prior, layout, make_graph(factors), problem.values)
    grown = _larger(prior, system, layout.keys, problem.values, clusters)
    return replace(grown, healthy=False), np.inf


def commit_solution(
    prior: MarginalPrior, solved: Solved, names: Mapping[int, int], clusters: Mapping[int, int]
) -> MarginalPrior:
    """Append what was solved on top of the same prior; nothing is solved again.

    Args:
        prior: What G(t-1) says of its frontier; the solution may have been found with fewer of its
            eliminated variables.
        solved: The solution.
        names: Keys that new variables get in place of those that they were solved under.
        clusters: Stamps (ns) of the new clusters, by id.

    Returns:
        The larger prior, whose frontier holds all new variables.
    """
    system, own = solved.linear(), solved.own()
    new = system.layout.keys[len(prior.keys) :]
    base = gtsam.Values(prior.base)
    base.update(own.extract(prior.keys))
    for key in new:
        copy_value(own, key, base, names.get(key, key))
    renamed = (*prior.keys, *(names.get(key, key) for key in new))
    grown = _larger(prior, system, renamed, base, clusters)
    step = prior.gains @ system.total[: system.known]
    return replace(grown, pending_delta=prior.pending_delta + step)


def _larger(
    prior: MarginalPrior,
    system: System,
    keys: tuple[int, ...],
    base: gtsam.Values,
    clusters: Mapping[int, int],
) -> MarginalPrior:
    new = system.layout.size - prior.root.shape[1]
    root, rhs = system.stacked()
    return MarginalPrior(
        keys=keys,
        root=root,
        rhs=rhs,
        pivot=prior.pivot,
        eliminated=prior.eliminated,
        gains=np.hstack([prior.gains, np.zeros((len(prior.gains), new))]),
        base=base,
        pending_delta=prior.pending_delta,
        clusters={**prior.clusters, **clusters},
        held=prior.held,
        spread=prior.spread,
    )


def marginal_prior_of(
    factors: Iterable[gtsam.NonlinearFactor],
    values: gtsam.Values,
    clusters: Mapping[int, int],
    keep: Collection[int],
    oldest: int,
) -> tuple[MarginalPrior, gtsam.Values]:
    """The marginal prior of a whole graph; costs a sparse elimination of it.

    ``smoother_update`` and ``marginalise`` do the same step by step.

    Args:
        factors: All factors.
        values: Their optimum.
        clusters: Stamps (ns) of all clusters, by id.
        keep: Variables of the frontier.
        oldest: Stamp (ns) of the oldest clusters whose eliminated variables still move.

    Returns:
        The prior, and the values of what lies before it.
    """
    present = with_poses(keep) & set(values.keys())
    kept = sorted(present, key=lambda key: (cluster_of(key), key))
    wanted = {cluster_of(key) for key in kept}
    newer = {c for c, stamp in clusters.items() if stamp >= oldest or c in wanted}
    dropped = sorted(set(values.keys()) - set(kept), key=cluster_of)
    split = eliminate(make_graph(factors), values, dropped)
    layout = Layout(kept)
    pivot = pivot_of(layout, values, np.zeros(3))
    system = linear_system(MarginalPrior(pivot=pivot), layout, make_graph(split.factors), values)
    root, rhs = triangle(*system.stacked())
    eliminated = tuple(key for key in dropped if cluster_of(key) in newer)
    eliminated_layout = Layout(eliminated)
    gains = np.zeros((eliminated_layout.size, layout.size))
    at_rest = split.conditional.optimize(layout.vector_values(np.zeros(layout.size)))
    for column in range(layout.size):
        unit = np.zeros(layout.size)
        unit[column] = 1.0
        moved = split.conditional.optimize(layout.vector_values(unit))
        for key, place in eliminated_layout.places.items():
            gains[place, column] = moved.at(key) - at_rest.at(key)
    from_own_columns(gains, layout, Pivoted(values, pivot))
    inside = [key for key in values.keys() if cluster_of(key) in newer]  # noqa: SIM118
    gone = [key for key in values.keys() if cluster_of(key) not in newer]  # noqa: SIM118
    prior = MarginalPrior(
        keys=layout.keys,
        root=root,
        rhs=rhs,
        pivot=pivot,
        eliminated=eliminated,
        gains=gains,
        base=values.extract(inside),
        pending_delta=np.zeros(len(gains)),
        clusters={c: s for c, s in clusters.items() if c in newer},
    )
    return prior, values.extract(gone)
