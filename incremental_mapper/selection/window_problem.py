"""The problem of one window: everything that its choice depends on, put together once."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.candidates.model import Candidate, Cluster
from incremental_mapper.candidates.partitions import Element, group_elements
from incremental_mapper.candidates.spans import ImuStamps
from incremental_mapper.config import Config
from incremental_mapper.frontend.dead_reckoning import State, Turns, predict, turns_of
from incremental_mapper.frontend.front_end import Prepared, PreparedFix
from incremental_mapper.frontend.imu_preintegration import ImuSeries, level_rotation
from incremental_mapper.graph.bias_sharing import sharing
from incremental_mapper.graph.connectivity import Partitions
from incremental_mapper.graph.factor_builder import FactorBuilder
from incremental_mapper.graph.initial_guess import InitialGuess
from incremental_mapper.graph.motion_compensation import MotionCompensation
from incremental_mapper.graph.passed_clusters import MotionSigmas
from incremental_mapper.graph.window_inputs import WindowInputs
from incremental_mapper.measurements import NANOSECONDS, NO_VERTICAL_SIGMA
from incremental_mapper.selection.local_map import LocalMapBuilder
from incremental_mapper.smoothing.correction import release
from incremental_mapper.smoothing.graph_state import GraphState
from incremental_mapper.smoothing.marginal_prior import MarginalPrior, trimmed
from incremental_mapper.variables import bias_key, velocity_key


@dataclass(frozen=True, eq=False)
class WindowProblem:
    """A window's elements, their factors, and what candidates are judged on.

    Attributes:
        config: All settings.
        inputs: What the factors are made of.
        imu: Which IMU samples lie between two stamps.
        prior: What G(t-1) says of its frontier, and of the earlier poses that candidates are
            judged by.
        partitions: Numbers of the clusters, and which of them hang together.
        compensation: Where the members of a cluster stand in it.
        factors: Builds the factors of candidates.
        guess: The values from which they are solved.
        local_maps: Places a window's scans among the recent ones.
        may_merge: Whether candidates that merge may win; else only where no other is connected.
        limit: Connected candidates that may be solved, the least shifted ones; None is all.
    """

    config: Config
    inputs: WindowInputs
    imu: ImuStamps
    prior: MarginalPrior
    partitions: Partitions
    compensation: MotionCompensation
    factors: FactorBuilder
    guess: InitialGuess
    local_maps: LocalMapBuilder
    may_merge: bool
    limit: int | None = None

    @cached_property
    def elements(self) -> tuple[Element, ...]:
        """The core measurements, grouped by stamp, in time order."""
        return group_elements(self.inputs.prepared)

    @property
    def head(self) -> int | None:
        """Stamp (ns) of the cluster of G(t-1) to connect from, None where there is none."""
        frontier = self.inputs.frontier
        return None if frontier.head is None else frontier.head_stamp

    @cached_property
    def apart(self) -> bool:
        """Whether nothing ties any measurement to G(t-1), so that no candidate is connected.

        As where the matching of every LiDAR begins anew behind a hole in the IMU samples.
        """
        frontier, head = self.inputs.frontier, self.head
        if frontier.newest is None or self.partitions.touched:
            return False
        # A cluster's stamp is that of one of its elements.
        stamps = [element[0].stamp for element in self.elements]
        return head is None or all(self.imu.first_sample(head, end) is None for end in stamps)

    def unconnected(self, candidate: Candidate) -> list[list[Cluster]]:
        """Decide connectivity by union-find, before anything is solved (paper, step 5).

        In the first window there is no G(t-1), and the component of the first cluster counts
        as it.

        Args:
            candidate: One of the window's candidates.

        Returns:
            The clusters of every component that does not reach G(t-1), both in time order; empty
            where the candidate is connected.
        """
        return self.partitions.of(candidate).unconnected(candidate)

    def held(self, candidate: Candidate) -> bool:
        """Tell a candidate whose clusters all have more than weak matches to hang on.

        One that has not may lie anywhere along the weak direction, and the local map looks alike
        wherever it does: no score of the map can tell.

        Args:
            candidate: One of the window's candidates.

        Returns:
            Whether no cluster hangs on matches that the scans hold weakly in some direction.
        """
        return self.partitions.of(candidate).held(candidate)


def pose_problem(
    items: Sequence[Prepared],
    state: GraphState,
    series: ImuSeries,
    orientation: NDArray[np.float64] | None,
    parameters: gtsam.PreintegrationCombinedParams,
    config: Config,
    limit: int | None = None,
) -> WindowProblem:
    """Put a window's problem together; nothing is built or solved yet.

    Args:
        items: Prepared core measurements in time order, at least one.
        state: G(t-1).
        series: IMU samples that no span has used yet.
        orientation: The IMU's first quaternion x, y, z, w of T_enu_imu, if it has any.
        parameters: Noise and gravity of the pre-integration.
        config: All settings.
        limit: Candidates that may be solved while measurements come too fast; None is all.

    Returns:
        The problem that a strategy selects from.
    """
    recent = config.mom.submap_scans
    max_gap = round(config.preintegration.max_gap * NANOSECONDS)
    series = series.with_forces(parameters)
    # What is held for evidence that comes later is no part of a window's choice.
    prior = release(trimmed(state.prior, state.recent_poses(recent)))
    turns = turns_of(items)
    inputs = window_inputs(items, state, series, orientation, parameters, config, turns)
    partitions = Partitions(inputs.prepared, inputs.frontier)
    compensation = MotionCompensation(
        inputs.head_state,
        series,
        parameters,
        max_gap,
        config.graph.motion_compensation,
        turns,
    )
    factors = FactorBuilder(inputs, partitions, compensation)
    return WindowProblem(
        config=config,
        inputs=inputs,
        imu=ImuStamps(series.stamps, max_gap, inputs.bias.use),
        prior=prior,
        partitions=partitions,
        compensation=compensation,
        factors=factors,
        guess=InitialGuess(
            inputs.states, inputs.head_state, inputs.frontier, partitions, inputs.bias
        ),
        local_maps=LocalMapBuilder(items, inputs, partitions, compensation, state, recent),
        # How far a merged measurement must be moved is unknown before the velocity is.
        may_merge=state.velocity_known or not config.graph.motion_compensation,
        limit=limit,
    )


def window_inputs(
    items: Sequence[Prepared],
    state: GraphState,
    series: ImuSeries,
    orientation: NDArray[np.float64] | None,
    parameters: gtsam.PreintegrationCombinedParams,
    config: Config,
    turns: Turns,
) -> WindowInputs:
    """Gather the inputs of a window; ``orientation`` is the IMU's first quaternion, if any."""
    frontier = state.frontier
    start = (
        _first_state(items[0].core.stamp, series, orientation, config)
        if frontier.head is None
        else _head_state(state)
    )
    scan_poses = {
        (name, stamp): state.pose(cluster).compose(state.scan_offsets[name, stamp])
        for name, (cluster, stamp) in frontier.chains.items()
    }
    max_gap = round(config.preintegration.max_gap * NANOSECONDS)
    states = predict(
        items, start, scan_poses, series, parameters, max_gap, state.velocity_known, turns
    )
    return WindowInputs(
        prepared={item.core: item for item in items},
        states=states,
        series=series,
        parameters=parameters,
        frontier=frontier,
        head_state=start,
        scan_offsets=state.scan_offsets,
        enu_offset=_enu_offset(items, state, states, config),
        fix_inflation=fix_spread(state, items),
        known=_motion_sigmas(state, config),
        bias=sharing(frontier, items[0].core.stamp, config.graph, config.selection.strategy),
        config=config,
    )


def _motion_sigmas(state: GraphState, config: Config) -> MotionSigmas:
    """How well velocity and bias are known where the window starts."""
    frontier, graph = state.frontier, config.graph
    known = None
    if frontier.head is not None and frontier.head_inertial and frontier.bias is not None:
        known = state.prior.covariance(velocity_key(frontier.head), bias_key(frontier.bias))
    if known is None:
        return MotionSigmas(graph.prior_sigma_velocity, graph.prior_sigma_gyroscope_bias)
    # The bias has the accelerometer's three first.
    blocks = np.stack([known[:3, :3], known[6:, 6:]])
    worst = np.linalg.svd(blocks, compute_uv=False)[:, 0]
    return MotionSigmas(*np.sqrt(worst).tolist())


def _head_state(state: GraphState) -> State:
    frontier = state.frontier
    assert frontier.head is not None
    inertial = frontier.head_inertial
    return State(
        stamp=frontier.head_stamp,
        pose=state.pose(frontier.head),
        velocity=state.velocity(frontier.head) if inertial else state.last_velocity,
        bias=state.bias(frontier.bias)
        if inertial and frontier.bias is not None
        else state.last_bias,
    )


def _first_state(
    stamp: int, series: ImuSeries, orientation: NDArray[np.float64] | None, config: Config
) -> State:
    """Level by gravity; yaw from the IMU's orientation if it has one, else zero."""
    R_base_imu = config.imu.matrix()[:3, :3]
    yaw = 0.0
    if orientation is not None:
        x, y, z, w = orientation
        R_enu_base = gtsam.Rot3.Quaternion(w, x, y, z).compose(gtsam.Rot3(R_base_imu.T))
        yaw = float(R_enu_base.yaw())
    rotation = gtsam.Rot3.Yaw(yaw)
    if len(series.stamps) and config.preintegration.gravity > 0.0:
        rotation = level_rotation(R_base_imu @ series.acceleration.mean(axis=0), yaw)
    return State(
        stamp, gtsam.Pose3(rotation, np.zeros(3)), np.zeros(3), gtsam.imuBias.ConstantBias()
    )


def _enu_offset(
    items: Sequence[Prepared], state: GraphState, states: Mapping[int, State], config: Config
) -> NDArray[np.float64]:
    """Where ENU's origin lies in the map; before the first fix is used, that fix defines it."""
    if state.enu_offset is not None:
        return state.enu_offset
    for item in items:
        if isinstance(item, PreparedFix):
            arm = config.gnss.matrix()[:3, 3]
            antenna = states[item.core.stamp].pose.transformFrom(arm)
            offset: NDArray[np.float64] = antenna - item.enu
            return offset
    return np.zeros(3)


def fix_spread(state: GraphState, items: Sequence[Prepared]) -> Mapping[int, tuple[float, float]]:
    """Extra standard deviations of fixes, horizontal and vertical, metres, by stamp.

    While the yaw is unknown, the horizontal one grows with the distance from the first fix.
    Doubtful fixes say next to nothing.
    """
    fixes = [item for item in items if isinstance(item, PreparedFix)]
    if not fixes:
        return {}
    first = state.fixes[0].enu if state.fixes else fixes[0].enu
    spread: dict[int, tuple[float, float]] = {}
    for fix in fixes:
        far = 2.0 * float(np.linalg.norm((fix.enu - first)[:2]))
        if fix.doubtful:
            wide = max(far, NO_VERTICAL_SIGMA)
            spread[fix.core.stamp] = wide, wide
        elif not state.georeferenced:
            spread[fix.core.stamp] = far, 0.0
    return spread
