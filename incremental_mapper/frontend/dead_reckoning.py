"""Where the car probably is at each stamp of a window: initial values, never measurements."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.frontend.front_end import Prepared
from incremental_mapper.frontend.imu_preintegration import ImuSeries, integrate
from incremental_mapper.frontend.prepared_scan import PreparedScan
from incremental_mapper.measurements import NANOSECONDS

REACH = 300_000_000
"""Nanoseconds from the middle of a match within which its rate of turn is believed."""
CATCH_UP = 0.3
"""Share of the difference by which a velocity follows a match where no IMU carries it: with two
LiDARs at 10 Hz it follows within 0.15 s, and the noise of a match, 0.3 m/s, is halved."""


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Pose T_map_base, velocity (3,) in the map (m/s) and IMU bias at a stamp (ns).

    ``unseen`` is for how many seconds of the way to it there was no IMU.
    """

    stamp: int
    pose: gtsam.Pose3
    velocity: NDArray[np.float64]
    bias: gtsam.imuBias.ConstantBias
    unseen: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Turns:
    """Rates of turn (M, 3) in base_link, rad/s, at the middle stamps (M,) of matches, ns."""

    stamps: NDArray[np.int64]
    rates: NDArray[np.float64]

    def between(self, start: int, end: int) -> NDArray[np.float64]:
        """Mean rate (3,) between two stamps (ns); zero where no match is near."""
        middle = (start + end) // 2
        if len(self.stamps) == 0 or int(np.abs(self.stamps - middle).min()) > REACH:
            return np.zeros(3)
        since = (self.stamps - middle) / NANOSECONDS
        return np.array([np.interp(0.0, since, column) for column in self.rates.T])


def turns_of(prepared: Sequence[Prepared]) -> Turns:
    """How the car turned, by the matches of a window."""
    found: dict[int, list[NDArray[np.float64]]] = {}
    for item in prepared:
        if isinstance(item, PreparedScan) and item.previous and item.T_previous_current:
            passed = (item.core.stamp - item.previous) / NANOSECONDS
            rate = gtsam.Rot3.Logmap(item.T_previous_current.rotation()) / passed
            found.setdefault((item.core.stamp + item.previous) // 2, []).append(rate)
    stamps = sorted(found)
    rates = np.array([sum(found[stamp]) / len(found[stamp]) for stamp in stamps]).reshape(-1, 3)
    return Turns(np.array(stamps, dtype=np.int64), rates)


NO_TURNS = turns_of(())


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
    turns: Turns = NO_TURNS,
) -> State:
    """Carry a state to another stamp: by the IMU where it covers the time, else by its velocity.

    Args:
        state: Pose T_map_base, velocity in the map and IMU bias at a stamp.
        stamp: Where to carry it, ns; it may lie before the state.
        series: IMU samples; where none lies between, the nearest one stands for them.
        parameters: Noise and gravity of the pre-integration.
        max_gap: Longest hole, ns, that the IMU is used across.
        turns: How the car turned, for the holes.

    Returns:
        The state at ``stamp``.
    """
    samples = series.within(state.stamp, stamp)
    if len(samples.stamps) == 0 and stamp > state.stamp:
        nearest = series.nearest(state.stamp)
        ends = np.array([state.stamp, stamp])
        if len(nearest.stamps) and np.abs(ends - nearest.stamps).max() <= max_gap:
            return _carry(state, stamp, nearest, parameters)
    if len(samples.stamps) == 0:
        return _coast(state, stamp, turns)
    # Runs of samples without a hole, and between them what the car does by itself.
    moments = [state.stamp, *samples.stamps.tolist(), stamp]
    low = 0
    for hole, (first, second) in enumerate(pairwise(moments)):
        if second - first <= max_gap:
            continue
        # Samples [low, hole) come before it.
        if hole > low:
            state = _carry(state, first, samples.part(low, hole), parameters)
        state = _coast(state, second, turns)
        low = hole
    if low < len(samples.stamps):
        run = samples.part(low, len(samples.stamps)) if low else samples
        state = _carry(state, stamp, run, parameters)
    return state


def _carry(
    state: State, stamp: int, samples: ImuSeries, parameters: gtsam.PreintegrationCombinedParams
) -> State:
    """By samples that cover the time."""
    # How the bias may walk does not matter here, and is most of the work.
    span = integrate(samples, state.stamp, stamp, parameters, state.bias, constant_bias=True)
    moved = span.predict(gtsam.NavState(state.pose, state.velocity), state.bias)
    return State(stamp, normalise(moved.pose()), moved.velocity(), state.bias, state.unseen)


def _coast(state: State, stamp: int, turns: Turns) -> State:
    """With the velocity that it has, which turns with the car."""
    passed = (stamp - state.stamp) / NANOSECONDS
    rate = turns.between(state.stamp, stamp)
    before = state.pose.rotation()
    turn = gtsam.Pose3.Expmap(np.concatenate([rate, before.unrotate(state.velocity)]) * passed)
    velocity = state.velocity
    if rate.any():
        velocity = before.compose(turn.rotation()).rotate(before.unrotate(velocity))
    pose = normalise(state.pose.compose(turn))
    return State(stamp, pose, velocity, state.bias, state.unseen + abs(passed))


def predict(
    prepared: Sequence[Prepared],
    start: State,
    scan_poses: Mapping[tuple[str, int], gtsam.Pose3],
    series: ImuSeries,
    parameters: gtsam.PreintegrationCombinedParams,
    max_gap: int,
    velocity_known: bool,
    turns: Turns | None = None,
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
        turns: How the car turned by the measurements, where that is known already.

    Returns:
        The states by stamp (ns), in time order.
    """
    poses = dict(scan_poses)
    turns = turns_of(prepared) if turns is None else turns
    states: dict[int, State] = {}
    current = start
    for item in prepared:
        stamp = item.core.stamp
        moved = propagate(current, stamp, series, parameters, max_gap, turns)
        if isinstance(item, PreparedScan):
            last = poses.get((item.core.sensor, item.previous)) if item.previous else None
            if last is not None and item.previous is not None and stamp not in states:
                assert item.T_previous_current is not None
                pose = normalise(last.compose(item.T_previous_current))
                velocity = moved.velocity
                if not velocity_known or moved.unseen > current.unseen:
                    passed = (stamp - item.previous) / NANOSECONDS
                    seen = (pose.translation() - last.translation()) / passed
                    velocity = velocity + (CATCH_UP if velocity_known else 1.0) * (seen - velocity)
                moved = State(stamp, pose, velocity, current.bias, moved.unseen)
            poses[item.core.sensor, stamp] = states.get(stamp, moved).pose
        states.setdefault(stamp, moved)
        current = states[stamp]
    return states
