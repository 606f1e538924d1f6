"""Closures as a set: those that contradict their neighbours, or have none, are left out."""

from collections.abc import Sequence

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.closures.local_maps import LocalMap
from incremental_mapper.closures.verification import Closure

NEIGHBOURHOOD = 120.0
"""Metres of way, at both ends, within which closures are held against each other."""
DRIFT, TURN = 0.01, 0.0005
"""How far the way between two closures may be off, for each metre of it: metres and radians."""
SLACK_TRANSLATION, SLACK_ROTATION = 0.3, 0.01
"""Metres and radians by which two closures may disagree in any case."""


def consistent_set(
    closures: Sequence[Closure], maps: Sequence[LocalMap]
) -> tuple[list[Closure], list[Closure], list[Closure]]:
    """Closures that agree with all of their neighbours, and have one at least.

    Two closures and the two ways between their ends are a loop; going round it must lead back.

    Args:
        closures: Verified ones.
        maps: The local maps.

    Returns:
        Those that hold, those that contradict others, and those that nothing confirms.
    """
    agree = np.zeros((len(closures), len(closures)), dtype=np.int8)
    for one, a in enumerate(closures):
        for other in range(one):
            agree[one, other] = agree[other, one] = _agreement(a, closures[other], maps)
    left = np.ones(len(closures), dtype=bool)
    refused: list[int] = []
    while True:
        against = (agree[:, left] < 0).sum(axis=1) * left
        if not against.any():
            break
        # The one with most against it, and least for it, goes first.
        backed = (agree[:, left] > 0).sum(axis=1)
        worst = int(np.lexsort((backed, -against))[0])
        left[worst] = False
        refused.append(worst)
    backed = (agree[:, left] > 0).sum(axis=1)
    held = [closure for i, closure in enumerate(closures) if left[i] and backed[i] > 0]
    alone = [closure for i, closure in enumerate(closures) if left[i] and backed[i] == 0]
    return held, [closures[i] for i in refused], alone


def _agreement(a: Closure, b: Closure, maps: Sequence[LocalMap]) -> int:
    """1 where two closures agree, -1 where they do not, 0 where they tell nothing of each other."""
    ends = ((maps[a.first], maps[b.first]), (maps[a.second], maps[b.second]))
    if any(one.run != other.run for one, other in ends):
        return 0
    ways = [abs(one.travelled - other.travelled) for one, other in ends]
    if max(ways) > NEIGHBOURHOOD:
        return 0
    there = maps[a.second].T_map_base.between(maps[b.second].T_map_base)
    back = maps[b.first].T_map_base.between(maps[a.first].T_map_base)
    round_trip = a.T_first_second.compose(there).compose(b.T_first_second.inverse()).compose(back)
    apart: NDArray[np.float64] = gtsam.Pose3.Logmap(round_trip)
    way = sum(ways)
    turned, moved = np.linalg.norm(apart[:3]), np.linalg.norm(apart[3:])
    agrees = bool(turned < SLACK_ROTATION + TURN * way and moved < SLACK_TRANSLATION + DRIFT * way)
    if not agrees:
        return -1
    # The same local map against two that lie side by side is one witness, not two.
    return 1 if a.second != b.second and a.first != b.first else 0
