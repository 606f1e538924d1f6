"""The newest part of G(t), kept small: what is older is marginalised into linear factors.

Its cost depends on the lag alone, never on how long the drive has been.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import gtsam

from incremental_mapper.graph.factors import bias_key, pose_key, velocity_key
from incremental_mapper.graph.solver import (
    Elimination,
    copy_value,
    eliminate,
    make_graph,
    optimize,
)


@dataclass(frozen=True, slots=True, eq=False)
class Lag:
    """Factors and values of the newest clusters; values in, values out.

    ``clusters`` maps the cluster ids inside the lag to their stamps. ``healthy`` is False after
    an optimisation failed; the values are then the initial ones.
    """

    factors: tuple[gtsam.NonlinearFactor, ...] = ()
    values: gtsam.Values | None = None
    clusters: Mapping[int, int] | None = None
    healthy: bool = True


def cluster_keys(cluster: int, values: gtsam.Values) -> list[int]:
    """The keys of a cluster's variables that exist in ``values``."""
    keys = (pose_key(cluster), velocity_key(cluster), bias_key(cluster))
    return [key for key in keys if values.exists(key)]


def extend(
    lag: Lag,
    factors: Iterable[gtsam.NonlinearFactor],
    initial: gtsam.Values,
    clusters: Mapping[int, int],
    max_iterations: int,
) -> Lag:
    """Append factors and variables, and optimise the lag."""
    values = gtsam.Values() if lag.values is None else gtsam.Values(lag.values)
    values.insert(initial)
    everything = (*lag.factors, *factors)
    solution = optimize(make_graph(everything), values, max_iterations)
    return Lag(
        factors=everything,
        values=values if solution is None else solution.values,
        clusters={**(lag.clusters or {}), **clusters},
        healthy=solution is not None,
    )


def shorten(lag: Lag, oldest: int, keep: Collection[int]) -> tuple[Lag, gtsam.Values]:
    """Marginalise clusters older than the stamp ``oldest`` (ns) that are not in ``keep``.

    Returns the shorter lag and the final values of the variables that left it.
    """
    gone = gtsam.Values()
    if lag.values is None or lag.clusters is None:
        return lag, gone
    leaving = [
        cluster for cluster, stamp in lag.clusters.items() if stamp < oldest and cluster not in keep
    ]
    if not leaving:
        return lag, gone
    dropped = [key for cluster in leaving for key in cluster_keys(cluster, lag.values)]
    dropped_set = set(dropped)
    touched = [f for f in lag.factors if not dropped_set.isdisjoint(f.keys())]
    untouched = [f for f in lag.factors if dropped_set.isdisjoint(f.keys())]
    rest = eliminate(make_graph(touched), lag.values, dropped).factors
    values = gtsam.Values(lag.values)
    for key in dropped:
        copy_value(lag.values, key, gone)
        values.erase(key)
    return (
        Lag(
            factors=(*untouched, *rest),
            values=values,
            clusters={c: s for c, s in lag.clusters.items() if c not in set(leaving)},
            healthy=lag.healthy,
        ),
        gone,
    )


def split_at(lag: Lag, keys: Sequence[int]) -> Elimination | None:
    """The lag as p(rest | frontier) · p(frontier), for the frontier's ``keys``; None if empty."""
    if lag.values is None:
        return None
    kept = set(keys)
    dropped = [key for key in lag.values.keys() if key not in kept]  # noqa: SIM118 (no mapping)
    dropped.sort(key=lambda key: int(gtsam.Symbol(key).index()))
    return eliminate(make_graph(lag.factors), lag.values, dropped)
