"""Where the car probably is at each stamp of a window: initial values, never measurements."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.frontend.front_end import Prepared
from incremental_mapper.frontend.imu_preintegration import ImuSeries, integrate
from incremental_mapper.frontend.lidar_odometry import PreparedScan
from incremental_mapper.measurements import NANOSECONDS


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Pose T_map_base, velocity (3,) in the map (m/s) and IMU bias at a stamp (ns)."""

    stamp: int
    pose: gtsam.Pose3
    velocity: NDArray[np.float64]
    bias: gtsam.imuBias.ConstantBias


def normalise(pose: gtsam.Pose3) -> gtsam.Pose3:
    """The pose with the rotation nearest to its own.

    GTSAM keeps rotations as matrices, and takes the transpose for the inverse. Poses that are made
    of each other, window after window, multiply what is wrong with them by rounding: after a
    minute or two it would show as a wrong gravity.

    Args:
        pose: A pose whose rotation is one up to rounding.

    Returns:
        The same place, with a rotation in SO(3).
    """
    return gtsam.Pose3(gtsam.Rot3.ClosestTo(pose.rotation().matrix()), pose.translation())


def propagate(
    state: State,
    stamp: int,
    series: ImuSeries,
    parameters: gtsam.PreintegrationCombinedParams,
    max_gap: int,
) -> State:
    """Carry a state to another stamp: by the IMU where it covers the time, else straight on.

    Args:
        state: Pose T_map_base, velocity in the map and IMU bias at a stamp.
        stamp: Where to carry it, ns; it may lie before the state.
        series: IMU samples; where none lies between, the nearest one stands for them.
        parameters: Noise and gravity of the pre-integration.
        max_gap: Longest hole at either end, ns, that the IMU is used across.

    Returns:
        The state at ``stamp``.
    """
    samples = series.within(state.stamp, stamp)
    if len(samples.stamps) == 0 and stamp > state.stamp:
        samples = series.nearest(state.stamp)
    inside = samples.stamps
    if len(inside) and max(abs(inside[0] - state.stamp), abs(stamp - inside[-1])) <= max_gap:
        span = integrate(samples, state.stamp, stamp, parameters, state.bias)
        moved = span.predict(gtsam.NavState(state.pose, state.velocity), state.bias)
        return State(stamp, normalise(moved.pose()), moved.velocity(), state.bias)
    shift = state.velocity * ((stamp - state.stamp) / NANOSECONDS)
    pose = gtsam.Pose3(state.pose.rotation(), state.pose.translation() + shift)
    return State(stamp, pose, state.velocity, state.bias)


def predict(
    prepared: Sequence[Prepared],
    start: State,
    scan_poses: Mapping[tuple[str, int], gtsam.Pose3],
    series: ImuSeries,
    parameters: gtsam.PreintegrationCombinedParams,
    max_gap: int,
    velocity_known: bool,
) -> dict[int, State]:
    """States at the stamps of a window's core measurements: initial values, never measurements.

    A scan with odometry goes where its odometry puts it; everything else follows the state before.

    Args:
        prepared: Core measurements in time order.
        start: State to start from.
        scan_poses: T_map_base at earlier scans, by sensor and stamp (ns).
        series: IMU samples.
        parameters: Noise and gravity of the pre-integration.
        max_gap: Longest hole in the samples, ns, that they are used across.
        velocity_known: Whether the velocity of ``start`` is better than what one match says.

    Returns:
        The states by stamp (ns), in time order.
    """
    poses = dict(scan_poses)
    states: dict[int, State] = {}
    current = start
    for item in prepared:
        stamp = item.core.stamp
        moved = propagate(current, stamp, series, parameters, max_gap)
        if isinstance(item, PreparedScan):
            last = poses.get((item.core.sensor, item.previous)) if item.previous else None
            if last is not None and item.previous is not None and stamp not in states:
                assert item.T_previous_current is not None
                pose = normalise(last.compose(item.T_previous_current))
                velocity = moved.velocity
                if not velocity_known:
                    passed = (stamp - item.previous) / NANOSECONDS
                    velocity = (pose.translation() - last.translation()) / passed
                moved = State(stamp, pose, velocity, current.bias)
            poses[item.core.sensor, stamp] = states.get(stamp, moved).pose
        states.setdefault(stamp, moved)
        current = states[stamp]
    return states
