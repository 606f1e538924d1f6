"""Whether an IMU is as quiet as the settings say: engines and cheap sensors are not."""

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.config import ImuSettings, Tree
from incremental_mapper.measurements import NANOSECONDS

FEWEST = 150
"""Samples that tell."""
SLOWEST = 50.0
"""Hz; of slower ones the second differences are motion. At 10 Hz KITTI's IMU seems 20 times as
noisy as at 100 Hz."""
LOUDER = 3.0
"""So many times the settings' density an IMU has at least where it is told. With the defaults it is
0.1 to 1.7 for KITTI's, an Ouster's, S3E's, and simulated ones."""
SAME = 8
"""Samples for each number that they are, at least, where they come in steps."""
LOOKED_AT = 2000
"""Samples, the newest, in which steps are looked for."""
HELD = 0.25
"""Seconds for which the error of a step stays the same: a vehicle turns on within one."""
NORMAL = 0.6745
"""Median size of a normal number in its standard deviations."""
NAMES = ('accelerometer_noise', 'gyroscope_noise')


def noise_density(stamps: NDArray[np.int64], values: NDArray[np.float64]) -> float | None:
    """White noise of samples, by their second differences; single absurd ones do not matter.

    Args:
        stamps: Of the samples (N,), ns, in time order.
        values: Rates or accelerations (N, 3).

    Returns:
        Density, the samples' unit by sqrt(Hz), root mean square of the axes; None where the
        samples are too few or too slow.
    """
    if len(stamps) < FEWEST:
        return None
    step = float(np.median(np.diff(stamps))) / NANOSECONDS
    if not 0.0 < step < 1.0 / SLOWEST:
        return None
    return float(scatter(values) * np.sqrt(step))


def scatter(values: NDArray[np.float64]) -> float:
    """Standard deviation of samples by their second differences, root mean square of the axes.

    Args:
        values: Rates or accelerations (N, 3), in time order; absurd ones do not matter.
    """
    seconds = values[:-2] - 2.0 * values[1:-1] + values[2:]
    sizes = np.median(np.abs(seconds - np.median(seconds, axis=0)), axis=0)
    sigmas = sizes / NORMAL / np.sqrt(6.0)  # 1 + 4 + 1 variances
    return float(np.sqrt(np.mean(np.square(sigmas))))


def step_density(values: NDArray[np.float64]) -> float:
    """What samples that come in steps lack, as white noise.

    Args:
        values: Rates or accelerations (N, 3).

    Returns:
        Density, the samples' unit by sqrt(Hz), root mean square of the axes; 0 without steps.
    """
    if len(values) < FEWEST:
        return 0.0
    values = values[-LOOKED_AT:]
    steps = np.zeros(values.shape[1])
    for axis, column in enumerate(values.T):
        levels = np.unique(column)
        if 3 <= len(levels) <= len(values) // SAME:
            steps[axis] = np.median(np.diff(levels))
    return float(np.sqrt(np.mean(np.square(steps)) * HELD / 12.0))


def check_noise(
    stamps: NDArray[np.int64],
    gyro: NDArray[np.float64],
    force: NDArray[np.float64],
    settings: ImuSettings,
) -> Finding | None:
    """Hold the noise of an IMU against the settings.

    Args:
        stamps: Of the samples (N,), ns, in time order.
        gyro: Angular rates (N, 3), rad/s.
        force: Accelerations (N, 3), m/s^2.
        settings: Those in force; what a user has set is not changed.

    Returns:
        ``imu_noise``, None where the IMU is as quiet as the settings say, or nothing is known.
    """
    louder: Tree = {}
    stepped = False
    for name, values in zip(NAMES, (force, gyro), strict=True):
        scattered, by_step = noise_density(stamps, values) or 0.0, step_density(values)
        density = max(scattered, by_step)
        if density > LOUDER * getattr(settings, name):
            louder[name] = float(f'{density:.2g}')
            stepped |= by_step > scattered
    if not louder:
        return None
    lines = ', '.join(f'preintegration.{name}: {value:g}' for name, value in louder.items())
    said = ', '.join(f'{getattr(settings, name):g}' for name in louder)
    chosen = settings.model_fields_set & louder.keys()
    return Finding(
        'imu_noise',
        Severity.WARNING if chosen else Severity.MENDED,
        'imu',
        f'its samples {"come in steps that are" if stepped else "scatter"} far more than the '
        f'settings say ({said}), as on an engine or of a cheap sensor',
        f'set {lines}' if chosen else f'believed less; {lines}',
        {} if chosen else {'preintegration': louder},
    )
