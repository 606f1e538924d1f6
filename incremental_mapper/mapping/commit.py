"""Appending the winner: G(t) = G(t-1) ⊕ G_best (paper, Algorithm 1)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from incremental_mapper.candidates.model import Candidate
from incremental_mapper.config import Config
from incremental_mapper.frontend.front_end import PreparedFix
from incremental_mapper.frontend.scan_preparation import PreparedScan
from incremental_mapper.graph.factor_builder import WindowFactors, WindowInputs
from incremental_mapper.graph.factors import BETWEEN_STATES, Factor, FactorKind
from incremental_mapper.graph.frontier import Frontier
from incremental_mapper.graph.values import bias_key, copy_value, pose_key, velocity_key
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.smoothing.batch import squared_error
from incremental_mapper.smoothing.gauss_newton import Solved
from incremental_mapper.smoothing.graph_state import (
    GraphState,
    PlacedCluster,
    PlacedFix,
    PlacedScan,
)
from incremental_mapper.smoothing.marginal_prior import marginalise
from incremental_mapper.smoothing.smoother import commit_solution, smoother_update

KNOWN_VELOCITY = 0.5
"""m/s; a velocity with a smaller standard deviation may be used to predict motion."""


@dataclass(frozen=True, slots=True, eq=False)
class Appended:
    """New clusters, and Σ‖h(x)−z‖²_Σ of the factors that came with them."""

    placed: tuple[PlacedCluster, ...]
    error: float


NOTHING = Appended((), 0.0)
"""What a window appends that is carried into the next one."""


def append_candidate(
    state: GraphState,
    window: int,
    candidate: Candidate,
    solved: Solved | None,
    extra: Sequence[Factor],
    factors: WindowFactors,
    inputs: WindowInputs,
    consecutive: bool,
) -> Appended:
    """Give the winner its final numbers, append it to ``state``, and solve it if it is not solved.

    ``extra`` are weak priors or bridges beside the candidate's own factors, which are not in
    ``solved``; ``consecutive`` makes the next window connect from the newest cluster whatever it
    has.
    """
    config = inputs.config
    placed: list[PlacedCluster] = []
    final: dict[int, int] = {}
    for cluster in candidate.clusters:
        number = len(state.clusters) + len(placed)
        placed.append(PlacedCluster(number, window, cluster))
        local = factors.local_id(cluster)
        for make in (pose_key, velocity_key, bias_key):
            final[make(local)] = make(number)
    made = [_renamed(factor, final) for factor in [*factors.factors(candidate), *extra]]
    stamps = {item.id: item.cluster.stamp for item in placed}
    if solved is not None and not extra:
        state.prior, error = commit_solution(state.prior, solved, final, stamps), solved.error
    else:
        values, initial = gtsam.Values(), factors.initial(candidate)
        for key in initial.keys():  # noqa: SIM118 (no mapping)
            copy_value(initial, key, values, final.get(key, key))
        plain = [factor.factor for factor in made]
        state.prior, _ = smoother_update(
            state.prior, plain, values, stamps, config.graph.max_iterations
        )
        error = squared_error(plain, state.prior.base)
    _remember_measurements(state, placed, factors, inputs, made)
    state.add_factors(made)
    state.clusters.extend(placed)
    for factor in made:
        # Continuity is no measurement: what only that holds together counts as apart.
        for key in factor.keys if factor.kind not in BETWEEN_STATES else ():
            state.components.union(factor.keys[0], key)
    state.frontier = _next_frontier(state, placed, inputs, consecutive)
    head = state.frontier.head
    if head is not None and state.frontier.head_inertial:
        state.last_velocity, state.last_bias = state.velocity(head), state.bias(head)
        state.velocity_known |= _velocity_sigma(state, head) < KNOWN_VELOCITY
    elif len(inputs.states) > 0:
        state.last_velocity = inputs.states[max(inputs.states)].velocity
    oldest = state.frontier.newest_stamp - round(config.graph.lag * NANOSECONDS)
    state.prior, gone = marginalise(state.prior, state.frontier.keys(), oldest)
    state.keep(gone)
    return Appended(tuple(placed), error)


def _velocity_sigma(state: GraphState, cluster: int) -> float:
    """Largest standard deviation of a cluster's velocity, m/s; only asked for at the start."""
    if state.velocity_known:
        return 0.0
    covariance = state.prior.covariance(velocity_key(cluster))
    if covariance is None:
        return float('inf')
    return float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))


def _renamed(factor: Factor, final: dict[int, int]) -> Factor:
    keys = tuple(final.get(key, key) for key in factor.keys)
    return replace(factor, keys=keys, factor=factor.factor.rekey(list(keys)))


def _remember_measurements(
    state: GraphState,
    placed: Sequence[PlacedCluster],
    factors: WindowFactors,
    inputs: WindowInputs,
    made: Sequence[Factor],
) -> None:
    place = {
        (factor.sensor, factor.stamps[0]): len(state.factors) + index
        for index, factor in enumerate(made)
        if factor.kind is FactorKind.GNSS
    }
    for item in placed:
        for core in item.cluster.members:
            prepared = inputs.prepared[core]
            offset = factors.offset(item.cluster, core.stamp)
            if isinstance(prepared, PreparedScan):
                scan = PlacedScan(
                    item.id,
                    core.stamp,
                    core.sensor,
                    state.store.put(prepared.thinned.astype(np.float32, copy=False)),
                    offset,
                )
                state.scans.append(scan)
                state.recent.append((scan, prepared.sparse))
            elif isinstance(prepared, PreparedFix):
                arm = offset.transformFrom(inputs.config.gnss.matrix()[:3, 3])
                state.fixes.append(
                    PlacedFix(
                        item.id,
                        core.stamp,
                        prepared.enu,
                        prepared.covariance,
                        arm,
                        place[core.sensor, core.stamp],
                    )
                )
                state.alignment = inputs.alignment


def _next_frontier(
    state: GraphState,
    placed: Sequence[PlacedCluster],
    inputs: WindowInputs,
    consecutive: bool,
) -> Frontier:
    config: Config = inputs.config
    newest = max(placed, key=lambda item: item.cluster.stamp)
    newest_stamp = newest.cluster.stamp
    chains = dict(state.frontier.chains)
    for item in placed:
        for core in item.cluster.members:
            scan = inputs.prepared[core]
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
    state.scan_offsets = {
        (scan.sensor, scan.stamp): scan.T_cluster_scan
        for scan in state.scans[-50 * max(len(chains), 1) :]
        if chains.get(scan.sensor, (0, -1))[1] == scan.stamp
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
    stamps = inputs.series.stamps
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
    )
