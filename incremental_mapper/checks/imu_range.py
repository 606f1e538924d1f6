"""What an IMU's numbers say of themselves: the end of its range, and axes that are stuck."""

from itertools import product

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.config import Imu
from incremental_mapper.measurements import NANOSECONDS

FEWEST = 200
"""Samples that tell."""
SHORTEST = 2.0
"""Seconds of them."""
SAME = 1e-6
"""Relative difference of two values that are the same: scaled ones are rounded."""
PILE = 40
"""Samples at the largest value of an axis that make a pile; a knock is shorter."""
OUTWEIGHS = 4.0
"""How many times as many as there are in the tenth below it, of the way from the median. What ends
by itself thins out towards its end: on all drives here the largest value stands alone."""
LEVELS = 50
"""Values that an axis has at least: one that is told in a few steps piles up in each of them."""
SMALL = 0.05
"""rad/s and m/s^2 of a stuck axis that may be what a simulator without noise says of a plane."""
GRAVITY_RANGE = (0.9, 1.1)
"""Share of gravity that such a simulator says of its upward axis."""
BELOW = 0.999
"""Of the end of the range, from where on samples are left out."""
AXES = 'xyz'


def check_range(
    stamps: NDArray[np.int64],
    gyro: NDArray[np.float64],
    force: NDArray[np.float64],
    settings: Imu,
    gravity: float,
) -> Finding | None:
    """Look for an axis that is stuck, and for values that pile up at the end of a range.

    Args:
        stamps: Of the samples (N,), ns, in time order.
        gyro: Angular rates (N, 3), rad/s, along the IMU's axes.
        force: Accelerations (N, 3), m/s^2.
        settings: Those of the IMU, which are in force.
        gravity: Magnitude of gravity in the accelerations, m/s^2.

    Returns:
        What is wrong, None where nothing is or where too little is known.
    """
    if len(stamps) < FEWEST or int(stamps[-1] - stamps[0]) < SHORTEST * NANOSECONDS:
        return None
    stuck = _stuck(gyro, 'angular rate', 'rad/s', 0.0) or _stuck(
        force, 'acceleration', 'm/s^2', gravity
    )
    if stuck is not None:
        return stuck
    return _clipped(
        'imu_rate_clipped', gyro, 'angular rates', 'rad/s', 'max_rate', settings.max_rate
    ) or _clipped(
        'imu_acceleration_clipped',
        force,
        'accelerations',
        'm/s^2',
        'max_acceleration',
        settings.max_acceleration,
    )


def _stuck(values: NDArray[np.float64], what: str, unit: str, gravity: float) -> Finding | None:
    still = np.ptp(values, axis=0) == 0.0
    if not still.any() or still.all():  # a whole sensor that is stuck is another matter
        return None
    for axis in np.flatnonzero(still).tolist():
        value = float(values[0, axis])
        if (
            abs(value) < SMALL
            or GRAVITY_RANGE[0] < abs(value) / max(gravity, 1e-9) < (GRAVITY_RANGE[1])
        ):
            continue
        return Finding(
            'imu_axis_stuck',
            Severity.WARNING,
            'imu',
            f'all {len(values)} samples have the {what} {value:.4g} {unit} on axis {AXES[axis]}, '
            'while the other axes live',
            'it is not used (imu.enabled: false)',
            {'imu': {'enabled': False}},
            in_force=True,
        )
    return None


def _clipped(
    rule: str, values: NDArray[np.float64], what: str, unit: str, key: str, known: float
) -> Finding | None:
    middle = np.median(values, axis=0)
    for axis, sign in product(range(3), (1.0, -1.0)):
        outwards = sign * values[:, axis]
        end, usual = float(outwards.max()), sign * float(middle[axis])
        if end >= known or end <= 0.0:
            continue  # the settings leave these out
        at_end = outwards > end * (1.0 - SAME)
        near = (outwards > end - 0.1 * (end - usual)) & ~at_end
        piled = int(at_end.sum())
        if piled < PILE or piled < OUTWEIGHS * near.sum():
            continue
        if len(np.unique(values[:, axis])) < LEVELS:
            continue
        limit = float(f'{BELOW * end:.5g}')
        return Finding(
            rule,
            Severity.WARNING,
            'imu',
            f'{piled} of {len(values)} {what} on axis {AXES[axis]} stand at {sign * end:.4g} '
            f'{unit}, the end of what the IMU can tell: it moves faster than that',
            f'these are left out, with imu.{key}: {limit:g}; set a larger range in its driver',
            {'imu': {key: limit}},
            in_force=True,
        )
    return None
