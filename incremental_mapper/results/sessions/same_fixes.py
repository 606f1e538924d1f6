"""Sessions that are one drive: twice the same measurements tell nothing new, and count double."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from incremental_mapper.graph.factors import FactorKind
from incremental_mapper.mapping.result import MapResult

SAME = 0.01
"""Metres between two fixes of one stamp that are one: no two antennas are so near each other."""
SHARE = 0.5
"""Share of the fixes of the shorter session from which on it is the other one, or a part of it.
Recordings that were split with a second in both are not."""


def measured_twice(sessions: Sequence[MapResult]) -> tuple[int, int, int] | None:
    """Two sessions that are one drive; None where all of them are different ones.

    Args:
        sessions: In one frame.

    Returns:
        Their places among the sessions, and how many of their fixes are the same.
    """
    fixes = [_places(session) for session in sessions]
    same: Counter[tuple[int, int]] = Counter()
    seen: dict[int, list[int]] = {}
    for number, own in enumerate(fixes):
        for stamp, place in own.items():
            before = seen.setdefault(stamp, [])
            for other in before:
                if np.linalg.norm(fixes[other][stamp] - place) < SAME:
                    same[other, number] += 1
            before.append(number)
    for (one, other), count in same.items():
        if count >= SHARE * min(len(fixes[one]), len(fixes[other])):
            return one, other, count
    return None


def _places(session: MapResult) -> dict[int, np.ndarray]:
    """Positions (3,) of the antenna in the map by stamp, ns."""
    return {
        factor.stamps[0]: np.array(factor.data['position'])
        for factor in session.factors
        if factor.kind is FactorKind.GNSS
    }
