"""Sessions that are one drive: twice the same measurements tell nothing new, and count double."""

import numpy as np

from incremental_mapper.graph.factors import FactorKind
from incremental_mapper.mapping.result import MapResult

SAME = 0.01
"""Metres between two fixes of one stamp that are one: no two antennas are so near each other."""
SHARE = 0.5
"""Share of the fixes of the shorter session from which on it is the other one, or a part of it.
Recordings that were split with a second in both are not."""


def measured_twice(first: MapResult, second: MapResult) -> int:
    """How many fixes of two sessions are the same; 0 where these are two drives.

    Args:
        first: A session.
        second: Another one, in the same frame.
    """
    one, other = _places(first), _places(second)
    same = sum(
        bool(np.linalg.norm(one[stamp] - other[stamp]) < SAME)
        for stamp in one.keys() & other.keys()
    )
    return same if same and same >= SHARE * min(len(one), len(other)) else 0


def _places(session: MapResult) -> dict[int, np.ndarray]:
    """Positions (3,) of the antenna in the map by stamp, ns."""
    return {
        factor.stamps[0]: np.array(factor.data['position'])
        for factor in session.factors
        if factor.kind is FactorKind.GNSS
    }
