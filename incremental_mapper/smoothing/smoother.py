"""Beliefs that grow: by factors that are new, by what was solved already, or from a whole graph."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace

import gtsam
import numpy as np

from incremental_mapper.graph.values import cluster_of, copy_value
from incremental_mapper.smoothing.batch import eliminate, make_graph
from incremental_mapper.smoothing.gauss_newton import Problem, Solved, linear_system
from incremental_mapper.smoothing.linear_system import System
from incremental_mapper.smoothing.marginal_prior import Belief, triangle
from incremental_mapper.smoothing.tangent_layout import Layout


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
    if solved is not None:
        return adopt(belief, solved, {}, clusters), solved.cost
    layout = Layout([*belief.keys, *initial.keys()])
    system = linear_system(belief, layout, make_graph(factors), problem.values)
    grown = _larger(belief, system, layout.keys, problem.values, clusters)
    return replace(grown, healthy=False), np.inf


def adopt(
    belief: Belief, solved: Solved, names: Mapping[int, int], clusters: Mapping[int, int]
) -> Belief:
    """Append what was solved on top of the same belief, with fewer followers or not.

    ``names`` are the keys that new variables get in place of those that they were solved under.
    """
    system, own = solved.linear(), solved.own()
    new = system.layout.keys[len(belief.keys) :]
    base = gtsam.Values(belief.base)
    base.update(own.extract(belief.keys))
    for key in new:
        copy_value(own, key, base, names.get(key, key))
    renamed = (*belief.keys, *(names.get(key, key) for key in new))
    grown = _larger(belief, system, renamed, base, clusters)
    step = belief.slopes @ system.total[: system.known]
    return replace(grown, ahead=belief.ahead + step)


def _larger(
    belief: Belief,
    system: System,
    keys: tuple[int, ...],
    base: gtsam.Values,
    clusters: Mapping[int, int],
) -> Belief:
    new = system.layout.size - belief.root.shape[1]
    root, rhs = system.stacked()
    return Belief(
        keys=keys,
        root=root,
        rhs=rhs,
        followers=belief.followers,
        slopes=np.hstack([belief.slopes, np.zeros((len(belief.slopes), new))]),
        base=base,
        ahead=belief.ahead,
        clusters={**belief.clusters, **clusters},
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
    system = linear_system(Belief(), layout, make_graph(split.factors), values)
    root, rhs = triangle(*system.stacked())
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
        base=values.extract(inside),
        ahead=np.zeros(len(slopes)),
        clusters={c: s for c, s in clusters.items() if c in newer},
    )
    return belief, values.extract(gone)
