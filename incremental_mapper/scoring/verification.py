"""Verification: fast MOM against direct MOM, in one window and over a run."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from incremental_mapper.scoring.criteria import Mom, Proposal
from incremental_mapper.scoring.mom import direct_score, fast_scores

NEARLY = 0.005
"""A winner whose direct score is worse by no more than this share counts as agreement."""


@dataclass(frozen=True, slots=True, eq=False)
class Verification:
    """Fast against direct MOM in one window.

    Attributes:
        same_winner: Whether both have the same lowest score.
        regret: Direct score of the fast winner over the best direct score, minus one.
        fast_seconds: For all candidates together.
        direct_seconds: For all candidates together.
        setup_seconds: What scoring took before, query points included.
        scored: How many candidates there were.
    """

    same_winner: bool
    regret: float
    fast_seconds: float
    direct_seconds: float
    setup_seconds: float
    scored: int


def verify(criterion: Mom, proposals: Sequence[Proposal], setup_seconds: float) -> Verification:
    """Score every candidate by both evaluations.

    Args:
        criterion: The window's criterion.
        proposals: Its candidates, at least one.
        setup_seconds: What scoring took before.

    Returns:
        Whether the two agree, and what each costs.
    """
    points, local_map, settings = criterion.query_points, criterion.local_map, criterion.settings
    poses = [proposal.poses for proposal in proposals]
    began = time.perf_counter()
    fast = fast_scores(points, np.array(poses), local_map, settings).tolist()
    between = time.perf_counter()
    direct = [direct_score(points, pose, local_map, settings) for pose in poses]
    ended = time.perf_counter()
    pairs = list(zip(fast, direct, strict=True))
    pick = min(range(len(pairs)), key=lambda i: pairs[i][0])
    best = min(range(len(pairs)), key=lambda i: pairs[i][1])
    floor = pairs[best][1]
    return Verification(
        same_winner=pick == best,
        regret=pairs[pick][1] / floor - 1.0 if floor > 0 else 0.0,
        fast_seconds=between - began,
        direct_seconds=ended - between,
        setup_seconds=setup_seconds,
        scored=len(pairs),
    )


def verification_summary(verifications: Sequence[Verification]) -> dict[str, Any]:
    """How often fast and direct MOM agree over a run, and what each costs: plain numbers."""
    judged = [item for item in verifications if item.scored > 1]
    agreeing = [item for item in judged if item.same_winner or item.regret <= NEARLY]
    scored = sum(item.scored for item in verifications)
    fast = sum(item.fast_seconds for item in verifications)
    direct = sum(item.direct_seconds for item in verifications)
    setup = sum(item.setup_seconds for item in verifications)
    return {
        'windows_with_a_choice': len(judged),
        'same_winner': sum(item.same_winner for item in judged),
        'same_or_within_half_percent': len(agreeing),
        'agreement_percent': 100.0 * len(agreeing) / max(len(judged), 1),
        'worst_regret_percent': 100.0 * max((item.regret for item in judged), default=0.0),
        'candidates_scored': scored,
        'fast_ms_per_candidate': 1e3 * fast / max(scored, 1),
        'direct_ms_per_candidate': 1e3 * direct / max(scored, 1),
        'setup_and_fast_ms_per_candidate': 1e3 * setup / max(scored, 1),
        'direct_over_fast': direct / fast if fast > 0 else None,
    }
