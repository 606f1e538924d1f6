"""Whether a LiDAR's stamps keep the even beat of what turns: they do not if taken on arrival."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.measurements import NANOSECONDS

FEWEST = 12
"""Consecutive stamps that show a beat."""
RUNS = 3
"""Such runs that make a judgement; half of them must scatter."""
UNEVEN = 0.005
"""Seconds by which stamps scatter around their beat, at least, where they are told. VLP-16 of KAIST
Urban and the HDL-64 of KITTI: 0.00001 to 0.0009. At 10 m/s it is 5 cm, half a window's worth."""
REGULAR = 0.7
"""Share of the steps within half of the usual one, at least, where there is a beat at all:
keyframes have none."""
WHOLE = 0.2
"""Beats by which a step may be off a whole number of them, where scans are lost."""
SHORTEST, LONGEST = 0.02, 0.5
"""Seconds from sweep to sweep of what turns."""


def beat_scatter(stamps: NDArray[np.int64]) -> float | None:
    """How far consecutive stamps are off an even beat.

    Args:
        stamps: Of one LiDAR (K,), ns, ascending; some may be missing.

    Returns:
        Standard deviation in seconds; None where there is no beat, or too little of it.
    """
    if len(stamps) < FEWEST:
        return None
    steps = np.diff(stamps) / NANOSECONDS
    passed = (stamps - stamps[0]) / NANOSECONDS
    # Where every third scan is lost the median lies between one beat and two.
    usual, short = (float(step) for step in np.quantile(steps, (0.5, 0.2)))
    found = []
    if SHORTEST < usual < LONGEST and np.mean(np.abs(steps / usual - 1.0) < 0.5) >= REGULAR:
        found.append(_around(passed, usual))
    if SHORTEST < short < LONGEST:
        beats = steps / short
        if np.mean(np.abs(beats - np.round(beats)) < WHOLE) >= REGULAR:
            found.append(_around(passed, short))
    return min(found, default=None)


def _around(passed: NDArray[np.float64], usual: float) -> float:
    """Scatter (s) of times around a beat of about ``usual`` seconds."""
    # Steps that scatter have a median of their own; how many beats there were tells the true one.
    count = round(float(passed[-1]) / usual)
    beats = np.arange(count - 2, count + 3, dtype=float)[:, None]
    numbers = np.round(passed * beats / passed[-1])
    # A straight line through each, in closed form: polyfit takes ten times as long.
    numbers -= numbers.mean(axis=1, keepdims=True)
    centred = passed - passed.mean()
    slopes = numbers @ centred / np.maximum(np.square(numbers).sum(axis=1), 1e-12)
    rest = centred - slopes[:, None] * numbers
    return float(np.sqrt(np.square(rest).mean(axis=1)).min())


def beat_finding(lidar: str, scatters: Sequence[float]) -> Finding | None:
    """Say where stamps keep no beat.

    Args:
        lidar: Whose they are.
        scatters: What ``beat_scatter`` returned for several runs, seconds.

    Returns:
        ``uneven_stamps``, or None.
    """
    if len(scatters) < RUNS:
        return None
    usual = float(np.median(scatters))
    if usual < UNEVEN:
        return None
    return Finding(
        'uneven_stamps',
        Severity.WARNING,
        lidar,
        f'its stamps scatter by {1000.0 * usual:.0f} ms around their beat, although a LiDAR turns '
        'evenly: they are times of arrival, and its scans are taken for that much earlier or later',
        'let the driver stamp by the sensor (PTP, or its own time with a time_offset)',
    )
