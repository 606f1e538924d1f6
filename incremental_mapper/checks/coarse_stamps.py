"""Stamps that stand still from message to message, and then leap: whole seconds, a wrong unit."""

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding, Severity

FEWEST = 20
"""Consecutive messages that tell."""
STANDS = 0.1
"""Share of the time that passed by the record times, below which a stamp has not moved."""
TURN = 0.3
"""Share of the mean time between two records below which two messages came together: the second
is a copy of the first, or waited in the same queue."""
MOST = 0.5
"""Share of the stamps that may stand. Of whole seconds at 10 Hz 0.9 do, of samples that are stamped
ten at a time as well; of sound recordings none, and none of those with every message twice."""


def standing_steps(pairs: NDArray[np.int64]) -> int:
    """Count the stamps that hardly move while the record times do.

    Args:
        pairs: Record times and stamps (N, 2), ns, in the order of the former.
    """
    received, moved = np.diff(pairs, axis=0).T
    if not len(received):
        return 0
    apart = received > TURN * np.mean(received)
    return int((apart & (np.abs(moved) < STANDS * received)).sum())


def is_coarse(pairs: NDArray[np.int64]) -> bool:
    """Tell whether most stamps of consecutive messages stand.

    Args:
        pairs: See ``standing_steps``.
    """
    return len(pairs) >= FEWEST and standing_steps(pairs) > MOST * (len(pairs) - 1)


def coarse_finding(sensor: str, standing: int, count: int) -> Finding:
    """Stamps of a sensor stand still: record times stand in for them.

    Args:
        sensor: Its name.
        standing: How many stamps hardly moved.
        count: Of how many messages.
    """
    return Finding(
        'coarse_stamps',
        Severity.WARNING,
        sensor,
        f'{standing} of {count} consecutive stamps are hardly later than the ones before, while '
        'the messages were recorded one after the other: whole seconds, or nanoseconds in '
        'another unit',
        'the times at which they were recorded stand in for them; let the driver set full stamps',
    )
