"""Which of a window's candidates may win, and which of them does (paper, Algorithm 1, step 5)."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

from incremental_mapper.candidates.enumeration import candidates, upper_bound
from incremental_mapper.candidates.model import Candidate
from incremental_mapper.selection.window_problem import WindowProblem


@dataclass(frozen=True, slots=True, eq=False)
class Pool:
    """The connected ones of some candidates.

    Attributes:
        eligible: Those that may win, in the order of their enumeration unless ``limited``.
        found: How many connected ones there are, whether they may win or not.
        connected: The ``id`` of every connected candidate, whether it may win or not.
        limited: Whether load shedding left some out.
    """

    eligible: list[Candidate]
    found: int
    connected: set[int]
    limited: bool


def all_candidates(problem: WindowProblem) -> list[Candidate] | None:
    """Every candidate of a window, None where there may be more than the settings allow.

    Args:
        problem: The window; ``selection.max_candidates`` bounds 3^(N-1), or half of it without a
            cluster of G(t-1) to connect from.
    """
    bound = upper_bound(len(problem.elements), problem.head is not None)
    if bound > problem.config.selection.max_candidates:
        return None
    return list(candidates(problem.elements, problem.head, problem.imu))


def connected_candidates(
    problem: WindowProblem, looked: Sequence[Candidate], held_first: bool = False
) -> Pool:
    """Filter candidates by union-find, before anything is solved.

    Args:
        problem: The window; its ``limit`` keeps the least shifted candidates only.
        looked: What was enumerated or found.
        held_first: Whether one with a cluster that hangs on weak matches may win only if all have
            one.

    Returns:
        The candidates that may win. Where ``may_merge`` is off, those that merge may do so only
        if no other is connected.
    """
    eligible = [item for item in looked if not problem.unconnected(item)]
    connected, found = set(map(id, eligible)), len(eligible)
    if not problem.may_merge:
        eligible = [item for item in eligible if not item.merges] or eligible
    if held_first:
        eligible = [item for item in eligible if problem.held(item)] or eligible
    limit = problem.limit
    limited = limit is not None and len(eligible) > limit
    if limited:
        eligible = sorted(eligible, key=lambda item: item.time_shift)[:limit]
    return Pool(eligible, found, connected, limited)


def best_index(scores: Sequence[float], scored: Sequence[Candidate]) -> int | None:
    """Index of the candidate that wins.

    Args:
        scores: Lower is better; what is not finite never wins.
        scored: The candidates of the scores.

    Returns:
        The lowest score; among equal ones the fewest vertices, then the finer partition. None
        where no score is finite.
    """
    lowest = min((score for score in scores if isfinite(score)), default=None)
    alike = [i for i, score in enumerate(scores) if score == lowest]
    return min(alike, key=lambda i: _simplicity(scored[i]), default=None)


def _simplicity(candidate: Candidate) -> tuple[Any, ...]:
    """Orders candidates that score alike: fewer vertices, finer partition, earlier cuts."""
    cuts = tuple(cluster.last for cluster in candidate.clusters)
    return candidate.vertices, -len(candidate.clusters), cuts, candidate.connections
