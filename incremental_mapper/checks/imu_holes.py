"""Holes between an IMU's samples, over which nothing is pre-integrated."""

from incremental_mapper.checks.finding import Finding, Severity

MOST = 0.5
"""Share of the drive in holes, from which on the IMU does not do what it is there for. The drives
here with 96 to 119 Hz have 0, the one with 10 Hz has 0.75."""
SLOW = 0.5
"""Seconds between two samples up to which an IMU is slow, and not silent."""


def check_holes(
    in_holes: float, seconds: float, longest: float, typical: float, max_gap: float
) -> Finding | None:
    """Hold the holes against the drive.

    Args:
        in_holes: Seconds between samples that are further apart than ``max_gap``.
        seconds: Length of the drive.
        longest: The longest hole, seconds.
        typical: Seconds between two samples, of nine in ten at most.
        max_gap: ``preintegration.max_gap``, seconds.

    Returns:
        A warning where most of the drive is in holes.
    """
    if seconds <= 0.0 or in_holes < MOST * seconds:
        return None
    slow = max_gap < typical < SLOW
    remedy = (
        f'preintegration.max_gap: {1.3 * typical:.2g} where the IMU is so slow'
        if slow
        else 'record its topic whole, or see what its driver or the recorder lost'
    )
    return Finding(
        'imu_holes',
        Severity.WARNING,
        'imu',
        f'{100.0 * in_holes / seconds:.0f} % of {seconds:.1f} s lie in holes of more than '
        f'{max_gap:g} s between samples (the longest has {longest:.2f} s): no IMU factor spans '
        'them',
        remedy,
        {'preintegration': {'max_gap': float(f'{1.3 * typical:.2g}')}} if slow else {},
    )
