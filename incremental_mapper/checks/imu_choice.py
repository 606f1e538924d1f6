"""Which of several IMUs a recording means."""

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.imu_gravity import check_gravity, measure_gravity
from incremental_mapper.config import Imu

FEWEST = 4
"""Usable messages of the first ones, below which nothing speaks for an IMU."""


def implausible_imu(
    stamps: NDArray[np.int64],
    gyro: NDArray[np.float64],
    acceleration: NDArray[np.float64],
    gravity: float,
) -> str | None:
    """Say why the first samples of an IMU are not those of a sound one.

    Args:
        stamps: Of the samples (N,), ns, in time order.
        gyro: Rates (N, 3).
        acceleration: Accelerations (N, 3), of any unit.
        gravity: Magnitude of gravity, m/s^2; where it is 0, none is expected.

    Returns:
        What is wrong, in words that follow the topic; None where nothing is.
    """
    if len(stamps) < FEWEST:
        return 'has no usable messages at first'
    if not np.ptp(gyro, axis=0).any():
        lives = bool(np.ptp(acceleration, axis=0).any())
        return 'has one angular rate only' if lives else 'repeats one sample'
    found = measure_gravity(stamps, acceleration)
    wrong = None if found is None else check_gravity(found, Imu(), gravity)
    if wrong is not None and wrong.rule == 'imu_without_gravity':
        return 'has no gravity in its accelerations'
    return None
