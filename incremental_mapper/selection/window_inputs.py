"""What the factors of a window are made of, from G(t-1) and the prepared measurements."""

from collections.abc import Mapping, Sequence

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.config import Config
from incremental_mapper.frontend.dead_reckoning import State, predict
from incremental_mapper.frontend.front_end import Prepared, PreparedFix
from incremental_mapper.frontend.imu_preintegration import ImuSeries, level_rotation
from incremental_mapper.graph.factor_builder import WindowInputs
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.smoothing.graph_state import GraphState


def window_inputs(
    items: Sequence[Prepared],
    state: GraphState,
    series: ImuSeries,
    orientation: NDArray[np.float64] | None,
    parameters: gtsam.PreintegrationCombinedParams,
    config: Config,
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
        items, start, scan_poses, series, parameters, max_gap, velocity_known=state.velocity_known
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
        config=config,
    )


def _head_state(state: GraphState) -> State:
    frontier = state.frontier
    assert frontier.head is not None
    inertial = frontier.head_inertial
    return State(
        stamp=frontier.head_stamp,
        pose=state.pose(frontier.head),
        velocity=state.velocity(frontier.head) if inertial else state.last_velocity,
        bias=state.bias(frontier.head) if inertial else state.last_bias,
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
    if len(series.stamps):
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


def fix_spread(state: GraphState, items: Sequence[Prepared]) -> Mapping[int, float]:
    """Extra standard deviation in metres of each fix, by stamp, while the yaw is unknown."""
    if state.georeferenced:
        return {}
    fixes = [item for item in items if isinstance(item, PreparedFix)]
    if not fixes:
        return {}
    first = state.fixes[0].enu if state.fixes else fixes[0].enu
    return {fix.core.stamp: 2.0 * float(np.linalg.norm((fix.enu - first)[:2])) for fix in fixes}
