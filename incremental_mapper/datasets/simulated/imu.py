"""The simulated IMU: true angular rate and specific force, drifting biases and noise."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from incremental_mapper.datasets.simulated.motion import Drive
from incremental_mapper.datasets.simulated.sensors import T_BASE_IMU

Array = NDArray[np.float64]

GRAVITY = 9.81
RATE = 100.0
CHUNK = 1000
H = 1e-3
"""Half a difference in seconds. In double precision the second difference of a position of some
hundred metres is good to about 1e-6 m/s^2, far below any IMU."""

GYRO_NOISE = 0.0005
"""rad/s/sqrt(Hz)."""
FORCE_NOISE = 0.0015
"""m/s^2/sqrt(Hz)."""
GYRO_WALK = 2e-5
"""rad/s/sqrt(s)."""
FORCE_WALK = 2e-4
"""m/s^2/sqrt(s)."""
GYRO_BIAS = 0.002
"""Standard deviation of the bias at the start, rad/s."""
FORCE_BIAS = 0.02
"""The same, m/s^2."""
YAW_ERROR = 0.06
"""Standard deviation of the heading's error, radians, as of a magnetometer in a car."""
TILT_ERROR = 0.004
FIELD = np.array([-0.08, 0.6, -0.8])
"""Magnetic field in ENU, in units of its strength, as at the latitude of Korea."""
FIELD_NOISE = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class InertialSamples:
    """Consecutive samples: all arrays are (N, 3) in the IMU's frame.

    ``gyro`` is in rad/s, ``force`` in m/s^2 (+9.81 upwards at rest); ``attitude`` is T_enu_imu.
    """

    attitude: Rotation
    gyro: Array
    force: Array
    field: Array


def true_samples(drive: Drive, times: Array) -> InertialSamples:
    """What an ideal IMU at its place on the car measures at ``times`` (N,)."""
    before, now, after = (_imu_pose(drive, times + shift) for shift in (-H, 0.0, H))
    acceleration = (after[0] - 2.0 * now[0] + before[0]) / H**2
    gyro = (before[1].inv() * after[1]).as_rotvec() / (2.0 * H)
    force = now[1].inv().apply(acceleration + [0.0, 0.0, GRAVITY])
    field = now[1].inv().apply(np.tile(FIELD, (len(times), 1)))
    return InertialSamples(now[1], gyro, force, field)


def measured_samples(
    drive: Drive, times: Array, rng: np.random.Generator
) -> Iterator[InertialSamples]:
    """What the IMU reports at ``times`` (N,), in chunks so that memory stays constant."""
    gyro_bias = rng.normal(scale=GYRO_BIAS, size=3)
    force_bias = rng.normal(scale=FORCE_BIAS, size=3)
    tilt = rng.normal(scale=[TILT_ERROR, TILT_ERROR, YAW_ERROR])
    for start in range(0, len(times), CHUNK):
        chunk = times[start : start + CHUNK]
        truth = true_samples(drive, chunk)
        shape = (len(chunk), 3)
        gyro_drift = gyro_bias + np.cumsum(
            rng.normal(scale=GYRO_WALK / np.sqrt(RATE), size=shape), axis=0
        )
        force_drift = force_bias + np.cumsum(
            rng.normal(scale=FORCE_WALK / np.sqrt(RATE), size=shape), axis=0
        )
        gyro_bias, force_bias = gyro_drift[-1], force_drift[-1]
        wobble = rng.normal(scale=TILT_ERROR / 4.0, size=shape)
        yield InertialSamples(
            attitude=Rotation.from_rotvec(tilt + wobble) * truth.attitude,
            gyro=truth.gyro + gyro_drift + rng.normal(scale=GYRO_NOISE * np.sqrt(RATE), size=shape),
            force=truth.force
            + force_drift
            + rng.normal(scale=FORCE_NOISE * np.sqrt(RATE), size=shape),
            field=truth.field + rng.normal(scale=FIELD_NOISE, size=shape),
        )


def _imu_pose(drive: Drive, times: Array) -> tuple[Array, Rotation]:
    """T_world_imu at ``times`` (N,)."""
    position, rotation = drive.poses(times)
    arm, turn = T_BASE_IMU[:3, 3], Rotation.from_matrix(T_BASE_IMU[:3, :3])
    return position + rotation.apply(np.tile(arm, (len(times), 1))), rotation * turn
