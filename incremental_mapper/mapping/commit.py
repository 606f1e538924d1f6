"""Committing the winner: G(t) = G(t-1) ⊕ G_best (paper, Algorithm 1)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.config import Config
from incremental_mapper.frontend.front_end import PreparedFix
from incremental_mapper.frontend.prepared_scan import PreparedScan
from incremental_mapper.graph.factors import Factor, FactorKind
from incremental_mapper.graph.frontier import Frontier
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.selection.choice import Choice
from incremental_mapper.selection.window_problem import WindowProblem
from incremental_mapper.smoothing.batch import squared_error
from incremental_mapper.smoothing.graph_state import (
    GraphState,
    PlacedCluster,
    PlacedFix,
    PlacedScan,
)
from incremental_mapper.smoothing.smoother import commit_solution, smoother_update
from incremental_mapper.variables import bias_key, cluster_of, copy_value, pose_key, velocity_key


@dataclass(frozen=True, slots=True, eq=False)
class Committed:
    """New clusters, and Σ‖h(x)−z‖²_Σ of the factors that came with them."""

    placed: tuple[PlacedCluster, ...]
    error: float


NOTHING = Committed((), 0.0)
"""What comes of a window that is carried into the next one."""


def commit(state: GraphState, window: int, choice: Choice, problem: WindowProblem) -> Committed:
    """Give the winner its final numbers and append it to G(t); solve it if it is not solved.

    Args:
        state: G(t-1), which becomes G(t).
        window: Number of the window.
        choice: The window's choice, with a winner.
        problem: What it was chosen from.

    Returns:
        What was appended.
    """
    candidate, config = choice.winner, problem.config
    assert candidate is not None
    placed: list[PlacedCluster] = []
    final: dict[int, int] = {}
    for cluster in candidate.clusters:
        number = len(state.clusters) + len(placed)
        placed.append(PlacedCluster(number, window, cluster))
        local = problem.partitions.number(cluster)
        for make in (pose_key, velocity_key, bias_key):
            final[make(local)] = make(number)
    factors = [*problem.factors.factors(candidate), *choice.extra]
    made = [_renamed(factor, final) for factor in factors]
    stamps = {item.id: item.cluster.stamp for item in placed}
    # Before anything changes: where points cannot be kept, G(t-1) is as it was.
    scans, fixes = _measurements(state, placed, problem, made)
    if choice.solution is not None and not choice.extra:
        prior = commit_solution(state.prior, choice.solution, final, stamps)
        error = choice.solution.error
    else:
        values, initial = gtsam.Values(), problem.guess.values(candidate)
        for key in initial.keys():  # noqa: SIM118 (no mapping)
            copy_value(initial, key, values, final.get(key, key))
        plain = [factor.factor for factor in made]
        prior, _ = smoother_update(state.prior, plain, values, stamps, config.graph.max_iterations)
        error = squared_error(plain, prior.base)
    if fixes:
        state.define_enu(problem.inputs.enu_offset)
    state.add_clusters(placed, scans, fixes)
    state.add_factors(made, prior)
    home = problem.inputs.bias.new_home(candidate, problem.partitions.number)
    frontier = _next_frontier(state, placed, problem, choice.consecutive)
    if not problem.inputs.bias.shared:
        frontier = replace(frontier, bias=frontier.inertial, bias_stamp=frontier.inertial_stamp)
    elif home is not None:
        frontier = replace(
            frontier,
            bias=cluster_of(final[bias_key(home)]),
            bias_stamp=candidate.connections[0].start_stamp,
        )
    states = problem.inputs.states
    oldest = frontier.newest_stamp - round(config.graph.lag * NANOSECONDS)
    state.advance(frontier, states[max(states)].velocity, oldest)
    return Committed(tuple(placed), error)


def _renamed(factor: Factor, final: dict[int, int]) -> Factor:
    keys = tuple(final.get(key, key) for key in factor.keys)
    renamed = factor.factor.rekey(list(keys))
    return Factor(factor.kind, keys, renamed, factor.sensor, factor.stamps, factor.describe)


def _measurements(
    state: GraphState,
    placed: Sequence[PlacedCluster],
    problem: WindowProblem,
    made: Sequence[Factor],
) -> tuple[list[tuple[PlacedScan, NDArray[np.float64]]], list[PlacedFix]]:
    """Scans, with their points for scoring, and fixes of new clusters with the factors ``made``."""
    place = {
        (factor.sensor, factor.stamps[0]): len(state.factors) + index
        for index, factor in enumerate(made)
        if factor.kind is FactorKind.GNSS
    }
    scans: list[tuple[PlacedScan, NDArray[np.float64]]] = []
    fixes: list[PlacedFix] = []
    for item in placed:
        for core in item.cluster.members:
            prepared = problem.inputs.prepared[core]
            offset = problem.compensation.offset(item.cluster, core.stamp)
            if isinstance(prepared, PreparedScan):
                stored = state.store.put(prepared.thinned.astype(np.float32, copy=False))
                scan = PlacedScan(item.id, core.stamp, core.sensor, stored, offset)
                scans.append((scan, prepared.sparse))
            elif isinstance(prepared, PreparedFix):
                arm = offset.transformFrom(problem.config.gnss.matrix()[:3, 3])
                fixes.append(
                    PlacedFix(
                        item.id,
                        core.stamp,
                        prepared.enu,
                        prepared.covariance,
                        arm,
                        place[core.sensor, core.stamp],
                    )
                )
    return scans, fixes


def _next_frontier(
    state: GraphState, placed: Sequence[PlacedCluster], problem: WindowProblem, consecutive: bool
) -> Frontier:
    config: Config = problem.config
    newest = max(placed, key=lambda item: item.cluster.stamp)
    newest_stamp = newest.cluster.stamp
    chains = dict(state.frontier.chains)
    for item in placed:
        for core in item.cluster.members:
            scan = problem.inputs.prepared[core]
            if not isinstance(scan, PreparedScan) or not scan.usable:
                continue
            if core.stamp >= chains.get(core.sensor, (0, 0))[1]:
                chains[core.sensor] = (item.id, core.stamp)
    # A scan that can no longer be matched to need not stay in the lag.
    max_gap = round(config.odometry.max_gap * NANOSECONDS)
    chains = {
        name: (id_, stamp)
        for name, (id_, stamp) in chains.items()
        if newest_stamp - stamp <= max_gap
    }
    inertial = [item for item in placed if state.has_inertial(item.id)]
    old = state.frontier
    last_inertial, inertial_stamp = old.inertial, old.inertial_stamp
    head, head_stamp, head_inertial = old.head, old.head_stamp, old.head_inertial
    if inertial:
        last = max(inertial, key=lambda item: item.cluster.stamp)
        head, head_stamp, head_inertial = last.id, last.cluster.stamp, True
        last_inertial, inertial_stamp = last.id, last.cluster.stamp
    elif head is not None and state.has_inertial(head):
        head_inertial = True
        last_inertial, inertial_stamp = head, head_stamp
    # Samples between the inertial cluster and the newest one were in no usable span: a span
    # from the older cluster would be unusable again, so the chain starts anew at the newest.
    max_hole = round(config.preintegration.max_gap * NANOSECONDS)
    stamps = problem.inputs.series.stamps
    between = int(np.sum((stamps >= head_stamp) & (stamps < newest_stamp)))
    stale = consecutive or newest_stamp - head_stamp > max_hole or between > 0
    if head is None or not head_inertial or (head != newest.id and stale):
        head, head_stamp = newest.id, newest_stamp
        head_inertial = state.has_inertial(newest.id)
    return Frontier(
        chains=chains,
        head=head,
        head_stamp=head_stamp,
        head_inertial=head_inertial,
        inertial=last_inertial,
        inertial_stamp=inertial_stamp,
        newest=newest.id,
        newest_stamp=newest_stamp,
        bias=old.bias,
        bias_stamp=old.bias_stamp,
    )
