"""What scan matching and an IMU see of a car that turns, pitches and changes its speed."""

import numpy as np
from scipy.spatial.transform import Rotation

from incremental_mapper.checks.imu_motion import MotionEvidence
from incremental_mapper.config import Imu

START = 1_700_000_000_000_000_000
GRAVITY = 9.81


def rates(t):
    """Angular velocity (N, 3) in base_link, rad/s."""
    return np.stack(
        [0.03 * np.sin(9.0 * t), 0.03 * np.sin(7.3 * t + 1.0), 0.2 * np.sin(0.9 * t)], axis=1
    )


def velocities(t):
    """Velocity (N, 3) in base_link, m/s."""
    return np.stack([10.0 + 2.0 * np.sin(0.7 * t), 0 * t, 0 * t], axis=1)


def forces(t):
    """Specific force (N, 3) in base_link, m/s^2."""
    change = np.stack([1.4 * np.cos(0.7 * t), 0 * t, 0 * t], axis=1)
    return change + np.cross(rates(t), velocities(t)) + (0.0, 0.0, GRAVITY)


def samples(seconds=10.0, rate=100.0, seed=0):
    """Stamps (K,) ns, rates and forces (K, 3) in base_link, with noise."""
    t = np.arange(round(seconds * rate)) / rate
    noise = np.random.default_rng(seed).normal(size=(2, len(t), 3))
    stamps = START + np.rint(t * 1e9).astype(np.int64)
    return stamps, rates(t) + 0.005 * noise[0], forces(t) + 0.2 * noise[1]


def evidence(turn=None, settings=None, rate=1.0, force=1.0, late=0.0, seconds=10.0, seed=1):
    """Matches at 10 Hz and an IMU of which something is wrong.

    Args:
        turn: Rotation (3, 3) from base_link to where the IMU's axes really are.
        settings: What is believed of it.
        rate: Factor of its rates.
        force: Factor of its accelerations.
        late: Seconds that its stamps are too large.
        seconds: Length of the drive.
        seed: Of the noise.
    """
    settings = Imu() if settings is None else settings
    starts = np.arange(0.2, seconds - 0.3, 0.1)
    middle = starts + 0.05
    noise = np.random.default_rng(seed).normal(size=(2, len(starts), 3))
    turns = rates(middle) * 0.1 + 0.001 * noise[0]
    stamps, gyro, acceleration = samples(seconds, seed=seed)
    turn = np.eye(3) if turn is None else turn
    believed = settings.matrix()[:3, :3] @ turn.T
    return MotionEvidence(
        spans=START + np.rint(np.stack([starts, starts + 0.1], axis=1) * 1e9).astype(np.int64),
        turns=turns,
        shifts=velocities(middle) * 0.1 + 0.01 * noise[1],
        stamps=stamps + round(late * 1e9),
        gyro=settings.rate_scale * rate * gyro @ believed.T,
        force=settings.acceleration_scale * force * acceleration @ believed.T,
        gravity=GRAVITY,
    )


def quarter(axis, degrees=90.0):
    """A rotation (3, 3) about an axis."""
    return Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
