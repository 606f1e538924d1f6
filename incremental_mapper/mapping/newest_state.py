"""The newest pose and twist of G(t), each with what is known of its errors."""

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.config import Config
from incremental_mapper.frontend.imu_preintegration import ImuSeries
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.smoothing.graph_state import GraphState
from incremental_mapper.variables import bias_key, pose_key, velocity_key

ANGULAR_ACCELERATION = 1.0
"""rad/s^2 by which the rate may have changed since the nearest sample; a car that turns in."""
UNKNOWN_SPACING = 0.005
"""Seconds between two samples where there is only one; the closer they are, the noisier each is."""


@dataclass(frozen=True, slots=True, eq=False)
class NewestState:
    """Pose T_map_base and velocity (3,) m/s in the map at ``stamp`` (ns).

    Attributes:
        stamp: Of the newest cluster, ns.
        pose: T_map_base.
        covariance: Of the pose (6, 6), in base_link and in GTSAM's order, rotation before
            translation; None where the graph does not determine it.
        velocity: Of base_link (3,), m/s along the axes of the map.
        velocity_covariance: Of the velocity along the axes of base_link (3, 3), m^2/s^2; None
            where the graph holds no velocity at ``stamp``.
        rate: Angular velocity of base_link along its own axes (3,), rad/s, from the gyroscope
            without its bias; None where no sample is near.
        rate_covariance: Of the rate (3, 3), rad^2/s^2: noise of one sample and of the bias.
        bias: Of the IMU, m/s^2 and rad/s along its axes; None as long as the graph does not tell
            the velocity.
    """

    stamp: int
    pose: gtsam.Pose3
    covariance: NDArray[np.float64] | None
    velocity: NDArray[np.float64]
    velocity_covariance: NDArray[np.float64] | None = None
    rate: NDArray[np.float64] | None = None
    rate_covariance: NDArray[np.float64] | None = None
    bias: gtsam.imuBias.ConstantBias | None = None


def newest_state(state: GraphState, series: ImuSeries, config: Config) -> NewestState | None:
    """Tell of the newest cluster, at a cost that does not grow with the drive.

    Args:
        state: G(t).
        series: IMU samples, those around the newest cluster among them.
        config: All settings.

    Returns:
        Its state, None before the first window.
    """
    frontier, prior = state.frontier, state.prior
    cluster = frontier.newest
    if cluster is None:
        return None
    velocity = velocity_key(cluster)
    rate, rate_covariance = _rate(state, series, config)
    return NewestState(
        stamp=frontier.newest_stamp,
        pose=state.pose(cluster),
        covariance=prior.covariance(pose_key(cluster)),
        velocity=state.velocity(cluster) if state.has_inertial(cluster) else state.last_velocity,
        velocity_covariance=prior.covariance(velocity) if velocity in prior.keys else None,
        rate=rate,
        rate_covariance=rate_covariance,
        bias=state.last_bias if state.velocity_known else None,
    )


def _rate(
    state: GraphState, series: ImuSeries, config: Config
) -> tuple[NDArray[np.float64] | None, NDArray[np.float64] | None]:
    """Angular velocity of base_link at the newest stamp, and its covariance."""
    frontier, imu = state.frontier, config.preintegration
    near = series.nearest(frontier.newest_stamp)
    if len(near.stamps) == 0:
        return None, None
    gap = round(imu.max_gap * NANOSECONDS)
    apart = abs(int(near.stamps[0]) - frontier.newest_stamp)
    if apart > gap:
        return None, None
    R_base_imu = config.imu.matrix()[:3, :3]
    spacing = (
        float(np.median(np.diff(series.stamps))) / NANOSECONDS
        if len(series.stamps) > 1
        else UNKNOWN_SPACING
    )
    noise = np.eye(3) * imu.gyroscope_noise**2 / max(spacing, 1e-4)
    noise += np.eye(3) * (ANGULAR_ACCELERATION * apart / NANOSECONDS) ** 2
    key = None if frontier.bias is None else bias_key(frontier.bias)
    if key is not None and key in state.prior.keys:
        known = state.prior.covariance(key)
        noise = noise + (0.0 if known is None else known[3:, 3:])
    rate: NDArray[np.float64] = R_base_imu @ (near.gyro[0] - state.last_bias.gyroscope())
    return rate, R_base_imu @ noise @ R_base_imu.T
