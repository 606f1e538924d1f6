"""Whether an IMU is so slow that nobody knows what happens between its samples."""

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.checks.imu_noise import NAMES, SLOWEST, scatter
from incremental_mapper.config import ImuSettings, Tree
from incremental_mapper.measurements import NANOSECONDS

FEWEST = 30
"""Samples that tell."""
SLOW = 0.35
"""Seconds between two samples up to which an IMU is slow, and not of no use."""
LONGER = 1.4
"""So many times its usual step a gap may be: stamps of 10 Hz differ by 0.10 to 0.11 s."""
UNKNOWN = 6.0
"""So many times the scatter of its samples an IMU's noise is then: what is not seen between samples
is alike for as long as a manoeuvre lasts, some ten of them, and the noise of a span is new at each.
3, 6 and 12 give KITTI 0013 without fixes an ATE of 0.298, 0.291 and 0.288 m by base, a simulated
street of 64 beams with fixes 13, 9 and 8 mm, one of KAIST's LiDARs without fixes 93, 74 and 49 mm,
and another one 34 mm with each; by mom that has 32, 22 and 26 mm."""


def check_slow(
    stamps: NDArray[np.int64],
    gyro: NDArray[np.float64],
    force: NDArray[np.float64],
    settings: ImuSettings,
) -> Finding | None:
    """Hold the step of an IMU against what its spans need.

    With 10 Hz each second gap is longer than ``preintegration.max_gap``, and no span reaches over
    it; and a span believes samples by their noise alone, though the car changes its motion between
    them. KITTI 0013, chosen by mom: ATE 0.085 m and turns from pose to pose 1.65 times as wrong as
    those of base; with longer gaps alone 0.112 m; with the wider noise as well 0.066 m and 1.03.

    Args:
        stamps: Of the samples (N,), ns, in time order.
        gyro: Angular rates (N, 3), rad/s.
        force: Accelerations (N, 3), m/s^2.
        settings: Those in force; what a user has set is not changed.

    Returns:
        ``slow_imu``; None where the IMU is quick, nothing is known, or the user has set it all.
    """
    if len(stamps) < FEWEST:
        return None
    gaps = np.diff(stamps) / NANOSECONDS
    step = float(np.median(gaps))
    if not 1.0 / SLOWEST <= step <= SLOW:
        return None
    wanted: Tree = {}
    longest = LONGER * step
    if longest > settings.max_gap:
        wanted['max_gap'] = float(f'{longest:.2g}')
    for name, values in zip(NAMES, (force, gyro), strict=True):
        density = UNKNOWN * scatter(values) * np.sqrt(step)
        if density > getattr(settings, name):
            wanted[name] = float(f'{density:.2g}')
    mended = {
        name: value for name, value in wanted.items() if name not in settings.model_fields_set
    }
    if not mended:
        return None
    lines = ', '.join(f'preintegration.{name}: {value:g}' for name, value in mended.items())
    return Finding(
        'slow_imu',
        Severity.MENDED,
        'imu',
        f'it samples at {1.0 / step:.3g} Hz: what the vehicle does in between is not known',
        f'its spans reach over that, and are believed less; {lines}',
        {'preintegration': mended},
    )
