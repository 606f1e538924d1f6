"""The problem of one window: everything that its choice depends on, put together once."""

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.candidates.model import Candidate, Cluster
from incremental_mapper.candidates.partitions import Element, group_elements
from incremental_mapper.candidates.spans import ImuStamps
from incremental_mapper.config import Config
from incremental_mapper.frontend.front_end import Prepared
from incremental_mapper.frontend.imu_preintegration import ImuSeries
from incremental_mapper.graph.connectivity import Partitions
from incremental_mapper.graph.factor_builder import FactorBuilder, WindowInputs
from incremental_mapper.graph.initial_guess import InitialGuess
from incremental_mapper.graph.motion_compensation import MotionCompensation
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.selection.local_map import LocalMapBuilder
from incremental_mapper.selection.window_inputs import window_inputs
from incremental_mapper.smoothing.graph_state import GraphState
from incremental_mapper.smoothing.marginal_prior import MarginalPrior, trimmed


@dataclass(frozen=True, slots=True, eq=False)
class WindowProblem:
    """A window's elements, their factors, and what candidates are judged on.

    Attributes:
        config: All settings.
        inputs: What the factors are made of.
        elements: The core measurements, grouped by stamp, in time order.
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
    elements: tuple[Element, ...]
    imu: ImuStamps
    prior: MarginalPrior
    partitions: Partitions
    compensation: MotionCompensation
    factors: FactorBuilder
    guess: InitialGuess
    local_maps: LocalMapBuilder
    may_merge: bool
    limit: int | None = None

    @property
    def head(self) -> int | None:
        """Stamp (ns) of the cluster of G(t-1) to connect from, None where there is none."""
        frontier = self.inputs.frontier
        return None if frontier.head is None else frontier.head_stamp

    def unconnected(self, candidate: Candidate) -> list[list[Cluster]]:
        """Components of a candidate that do not reach G(t-1), empty where it is connected.

        In the first window there is no G(t-1), and the component of the first cluster counts
        as it.
        """
        return self.partitions.of(candidate).unconnected(candidate)


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
    inputs = window_inputs(items, state, series, orientation, parameters, config)
    elements = group_elements(item.core for item in items)
    max_gap = round(config.preintegration.max_gap * NANOSECONDS)
    partitions = Partitions(inputs.prepared, inputs.frontier, len(elements))
    compensation = MotionCompensation(
        inputs.head_state, series, parameters, max_gap, config.graph.motion_compensation
    )
    recent = config.mom.submap_scans
    return WindowProblem(
        config=config,
        inputs=inputs,
        elements=elements,
        imu=ImuStamps(series.stamps, max_gap),
        prior=trimmed(state.prior, state.recent_poses(recent)),
        partitions=partitions,
        compensation=compensation,
        factors=FactorBuilder(inputs, partitions, compensation),
        guess=InitialGuess(inputs.states, inputs.head_state, inputs.frontier, partitions),
        local_maps=LocalMapBuilder(items, inputs, partitions, compensation, state, recent),
        # How far a merged measurement must be moved is unknown before the velocity is.
        may_merge=state.velocity_known or not config.graph.motion_compensation,
        limit=limit,
    )
