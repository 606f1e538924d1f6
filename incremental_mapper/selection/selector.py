"""Which of a window's candidates may win, and which of them does (paper, Algorithm 1, step 5)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from incremental_mapper.candidates.model import Candidate
from incremental_mapper.selection.window_problem import WindowProblem


@dataclass(frozen=True, slots=True, eq=False)
class Pool:
    """The connected ones of some candidates.

    Attributes:
        eligible: Those that may win, in the order of their enumeration unless ``limited``.
        found: How many of them there were before the limit.
        connected: The ``id`` of every connected candidate, whether it may win or not.
        limited: Whether load shedding left some out.
    """

    eligible: list[Candidate]
    found: int
    connected: set[int]
    limited: bool


def connected_candidates(problem: WindowProblem, candidates: Sequence[Candidate]) -> Pool:
    """Filter candidates by union-find, before anything is solved.

    Args:
        problem: The window; its ``limit`` keeps the least shifted candidates only.
        candidates: What was enumerated or found.

    Returns:
        The candidates that may win. Where ``may_merge`` is off, those that merge may do so only
        if no other is connected.
    """
    eligible = [item for item in candidates if not problem.unconnected(item)]
    connected = set(map(id, eligible))
    if not problem.may_merge:
        eligible = [item for item in eligible if not item.merges] or eligible
    found, limit = len(eligible), problem.limit
    limited = limit is not None and found > limit
    if limited:
        eligible = sorted(eligible, key=lambda item: item.time_shift)[:limit]
    return Pool(eligible, found, connected, limited)


def best_index(scores: Sequence[float], candidates: Sequence[Candidate]) -> int | None:
    """Index of the candidate that wins.

    Args:
        scores: Lower is better; what is not finite never wins.
        candidates: The candidates of the scores.

    Returns:
        The lowest score; among equal ones the fewest vertices, then the finer partition. None
        where no score is finite.
    """
    finite = [i for i, score in enumerate(scores) if np.isfinite(score)]
    return min(finite, key=lambda i: (scores[i], *_simplicity(candidates[i])), default=None)


def _simplicity(candidate: Candidate) -> tuple[Any, ...]:
    """Orders candidates that score alike: fewer vertices, finer partition, earlier cuts."""
    cuts = tuple(cluster.last for cluster in candidate.clusters)
    return candidate.vertices, -len(candidate.clusters), cuts, candidate.connections
