"""What time it is by the first measurements: strays may come before all others."""

from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise

from incremental_mapper.measurements import NANOSECONDS, Measurement

FIRST = 5
"""Measurements that tell what time it is: in order, or of one moment."""
MOMENT = 5 * NANOSECONDS
"""What is no further apart is of one moment."""
MOST_FIRST = 60
"""So many are waited for at the most where they contradict each other, a third of them with stamps
of their own: a driver that starts may repeat one for seconds."""


def moments(items: Sequence[Measurement]) -> Sequence[int]:
    """The stamps (ns) of measurements in their order, each of a sensor once."""
    return sorted(stamp for _, stamp in {(item.sensor, item.stamp) for item in items})


def largest(stamps: Sequence[int]) -> Sequence[int]:
    """The largest group of sorted stamps (ns) within ``MOMENT``."""
    groups = [
        stamps[begin : bisect_right(stamps, stamp + MOMENT)] for begin, stamp in enumerate(stamps)
    ]
    return max(groups, key=len)


def tell_the_time(items: Sequence[Measurement]) -> bool:
    """Whether the first measurements suffice: strays go anywhere, and keyframes in order."""
    stamps = moments(items)
    if len(stamps) < FIRST:
        return len(items) >= MOST_FIRST
    if len(stamps) >= MOST_FIRST // 3 or len(items) >= MOST_FIRST:
        return True
    in_order = all(before.stamp <= after.stamp for before, after in pairwise(items))
    return in_order or len(largest(stamps)) >= FIRST
