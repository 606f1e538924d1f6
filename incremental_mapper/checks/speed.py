"""Whether a map moves as vehicles can."""

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.measurements import NANOSECONDS

FASTEST = 100.0
"""m/s that no vehicle on the ground drives. Drives here have at most 20; trains reach 90."""
OVER = 0.5
"""Seconds, at least, over which a speed is measured."""


def speed_findings(stamps: NDArray[np.int64], positions: NDArray[np.float64]) -> list[Finding]:
    """Say where a solved map moves faster than anything does.

    Args:
        stamps: Of its poses (K,), ns, in time order.
        positions: Of them (K, 3), metres.

    Returns:
        ``impossible_speed``, an error; nothing where all is possible.
    """
    later = np.searchsorted(stamps, stamps + round(OVER * NANOSECONDS))
    first = np.flatnonzero(later < len(stamps))
    if not len(first):
        return []
    last = later[first]
    metres = np.linalg.norm(positions[last] - positions[first], axis=1)
    speeds = metres / ((stamps[last] - stamps[first]) / NANOSECONDS)
    worst = int(np.argmax(speeds))
    if not speeds[worst] > FASTEST:
        return []
    return [
        Finding(
            'impossible_speed',
            Severity.ERROR,
            '',
            f'the map moves by {speeds[worst]:.0f} m/s after {stamps[first[worst]]}, which no '
            'vehicle does',
            'see whether stamps come in bursts or step, and whether scans are matched wrongly '
            '(surroundings that repeat, clouds of two LiDARs)',
        )
    ]
