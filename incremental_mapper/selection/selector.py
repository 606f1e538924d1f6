"""One window's choice: enumerate, filter, solve, score (paper, Algorithm 1, steps 3 to 5)."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np

from incremental_mapper.candidates.enumeration import base_candidate, candidates, upper_bound
from incremental_mapper.candidates.local_moves import neighbours
from incremental_mapper.candidates.model import Candidate, Cluster
from incremental_mapper.candidates.time_shift_search import by_time_shift
from incremental_mapper.config import MomSettings, SelectionSettings
from incremental_mapper.scoring.mom import direct_score, fast_scores
from incremental_mapper.scoring.strategies import (
    Criterion,
    Mom,
    Proposal,
    StrategyPlan,
    score_all,
)
from incremental_mapper.selection.beam_search import beam_search
from incremental_mapper.selection.candidate_solver import CandidateSolver
from incremental_mapper.selection.window_problem import Task
from incremental_mapper.smoothing.gauss_newton import Solved

AT_ONCE = 6
"""Candidates that are solved between two looks at the clock."""
PATIENCE = 60
"""Candidates whose single decisions are changed in vain before a search ends."""
LOOKED_AT = 5000
"""Candidates after which the search for the least shifted connected one gives up."""


@dataclass(frozen=True, slots=True, eq=False)
class Verification:
    """Fast against direct MOM in one window.

    ``regret`` is the direct score of the fast winner over the best direct score, minus one;
    the times are seconds for all candidates together.
    """

    same_winner: bool
    regret: float
    fast_seconds: float
    direct_seconds: float
    setup_seconds: float
    scored: int


@dataclass(frozen=True, slots=True, eq=False)
class Tried:
    """One enumerated candidate; ``score`` and ``solver_error`` are None where it got none."""

    candidate: Candidate
    connected: bool
    score: float | None = None
    solver_error: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """The winner of a window and how it was found; ``winner`` is None where none connects.

    ``solution`` is the winner as it was judged, None where its strategy solves no candidates.

    ``tried`` are all candidates that were looked at, in the order of their enumeration.
    """

    winner: Candidate | None
    solution: Solved | None
    loose: tuple[tuple[Cluster, ...], ...]
    score: float | None
    score_name: str
    enumerated: int
    connected: int
    solved: int
    cut: bool
    seconds: dict[str, float]
    verification: Verification | None = None
    tried: tuple[Tried, ...] = ()


def choose(
    task: Task,
    plan: StrategyPlan,
    selection: SelectionSettings,
    mom: MomSettings,
    budget: int | None = None,
) -> Choice:
    """Pick the best connected candidate; ties go to fewer vertices, then to the finer partition.

    Of the connected candidates the ``budget`` least shifted ones are tried, by default all.
    """
    clock = _Clock()
    if plan.only_base:
        base = base_candidate(task.elements, task.head, task.imu)
        loose = tuple(tuple(part) for part in task.factors.components(base))
        clock.lap('candidates')
        return Choice(
            winner=base,
            solution=None,
            loose=loose,
            score=None,
            score_name='base',
            enumerated=1,
            connected=int(not loose),
            solved=0,
            cut=False,
            seconds=clock.seconds,
            tried=(Tried(base, not loose),),
        )
    enumerated, cut = _pool(task, plan, selection, mom, budget)
    connected = [item for item in enumerated if not task.factors.components(item)]
    reachable = set(map(id, connected))
    if not task.may_merge:
        connected = [item for item in connected if not item.merges] or connected
    found = len(connected)
    if budget is not None and found > budget:
        connected = sorted(connected, key=lambda item: item.time_shift)[:budget]
        cut = True
    clock.lap('candidates')
    solver = CandidateSolver(task)
    proposals = list(_propose(task, plan, solver, connected, clock))
    # Without a scan, new or recent, there is nothing to judge a map by.
    poses = [item.poses for item, _ in proposals if item.poses is not None and len(item.poses)]
    local_map = task.local_maps.local_map(poses) if poses else None
    criterion = plan.make(local_map, mom, selection.direct)
    scores = score_all(criterion, [proposal for proposal, _ in proposals])
    clock.lap('score')
    if cut and plan.solve and budget is None:
        refined = _refined(task, plan, solver, criterion, proposals, scores, selection, clock)
        enumerated += refined
        reachable |= set(map(id, refined))
        found += len(refined)
    verification = None
    if selection.verify and isinstance(criterion, Mom):
        verification = _verify(criterion, [proposal for proposal, _ in proposals], clock)
    judged = {
        id(proposal.candidate): (score, proposal.solver_error)
        for (proposal, _), score in zip(proposals, scores, strict=True)
    }
    tried = tuple(
        Tried(item, id(item) in reachable, *judged.get(id(item), (None, None)))
        for item in enumerated
    )
    best = _best(scores, [proposal.candidate for proposal, _ in proposals])
    winner, solution = (None, None) if best is None else _settled(solver, *proposals[best])
    clock.lap('solve')
    return Choice(
        winner=winner,
        solution=solution,
        loose=(),
        score=None if best is None else scores[best],
        score_name=criterion.name,
        enumerated=len(enumerated),
        connected=found,
        solved=len(proposals) if plan.solve else 0,
        cut=cut,
        seconds=clock.seconds,
        verification=verification,
        tried=tried,
    )


def _pool(
    task: Task,
    plan: StrategyPlan,
    selection: SelectionSettings,
    mom: MomSettings,
    budget: int | None,
) -> tuple[list[Candidate], bool]:
    """The candidates to choose from, and whether there may be better ones."""
    bound = upper_bound(len(task.elements), task.head is not None)
    if bound <= selection.max_candidates:
        return list(candidates(task.elements, task.head, task.imu)), False
    if plan.by_time_shift:
        least = _least_shifted(task)
        return least, not least or bool(task.factors.components(least[-1]))
    found: list[Candidate] = []
    if plan.solve:
        width = min(selection.beam_width, budget or selection.beam_width)
        # The conventional graph takes part as well, first as in an enumeration: what is found is
        # never worse than it, and the map is judged at the same points.
        base = base_candidate(task.elements, task.head, task.imu)
        searched = beam_search(task, plan, mom, width, selection.time_budget)
        found = [base, *(item for item in searched if item != base)]
    if not any(not task.factors.components(item) for item in found):
        found += islice(by_time_shift(task.elements, task.head, task.imu), selection.max_candidates)
    return found, True


def _least_shifted(task: Task) -> list[Candidate]:
    """Candidates by ascending time shift, up to the last of the least shifted connected ones.

    Exact: the search yields them in that order. At most LOOKED_AT are looked at.
    """
    for may_merge in (False, True)[int(task.may_merge) :]:
        looked: list[Candidate] = []
        winners: list[Candidate] = []
        search = by_time_shift(task.elements, task.head, task.imu, may_merge)
        for candidate in islice(search, LOOKED_AT):
            if winners and candidate.time_shift > winners[0].time_shift:
                break
            looked.append(candidate)
            if not task.factors.components(candidate):
                winners.append(candidate)
        if winners:
            return [item for item in looked if item not in winners] + winners
    return looked


def _best(scores: list[float], pool: list[Candidate]) -> int | None:
    finite = [i for i, score in enumerate(scores) if np.isfinite(score)]
    return min(finite, key=lambda i: (scores[i], *_simplicity(pool[i])), default=None)


def _simplicity(candidate: Candidate) -> tuple[Any, ...]:
    """Orders candidates that score alike: fewer vertices, finer partition, earlier cuts."""
    cuts = tuple(cluster.last for cluster in candidate.clusters)
    return candidate.vertices, -len(candidate.clusters), cuts, candidate.connections


def _refined(
    task: Task,
    plan: StrategyPlan,
    solver: CandidateSolver,
    criterion: Criterion,
    proposals: list[tuple[Proposal, Solved | None]],
    scores: list[float],
    selection: SelectionSettings,
    clock: '_Clock',
) -> list[Candidate]:
    """Change single decisions of the best candidates until PATIENCE of them gave nothing better.

    What is tried is added to ``proposals`` and ``scores``, and returned. Ends half a time budget
    after the beam had to, at the latest.
    """
    until = clock.began + 1.5 * selection.time_budget
    seen = {proposal.candidate for proposal, _ in proposals}
    added: list[Candidate] = []
    expanded: set[int] = set()
    idle = 0
    while idle < PATIENCE and time.perf_counter() < until:
        open_scores = [np.inf if i in expanded else score for i, score in enumerate(scores)]
        best = _best(open_scores, [proposal.candidate for proposal, _ in proposals])
        if best is None:
            break
        expanded.add(best)
        before = min(scores)
        centre = proposals[best][0].candidate
        around = dict.fromkeys(neighbours(centre, task.elements, task.head, task.imu))
        fresh = [
            item
            for item in around
            if item not in seen
            and (task.may_merge or not item.merges)
            and not task.factors.components(item)
        ]
        seen.update(around)
        for start in range(0, len(fresh), AT_ONCE):
            if time.perf_counter() >= until:
                break
            some = fresh[start : start + AT_ONCE]
            tried = list(_propose(task, plan, solver, some, clock))
            proposals += tried
            scores += score_all(criterion, [proposal for proposal, _ in tried])
            clock.lap('score')
            added += some
        idle = 0 if min(scores) < before else idle + 1
    return added


def _propose(
    task: Task,
    plan: StrategyPlan,
    solver: CandidateSolver,
    connected: list[Candidate],
    clock: '_Clock',
) -> Iterator[tuple[Proposal, Solved | None]]:
    """Solve the connected candidates; what cannot be solved is left out."""
    for candidate in connected:
        if not plan.solve:
            yield Proposal(candidate), None
            continue
        solved = solver.solve(candidate)
        if solved is None:
            continue
        poses = task.local_maps.poses(candidate, solved.pose) if plan.local_map else None
        clock.lap('solve')
        yield Proposal(candidate, solved.error, poses), solved


def _settled(
    solver: CandidateSolver, proposal: Proposal, solved: Solved | None
) -> tuple[Candidate, Solved | None]:
    """The winner and its true solution."""
    if solved is not None:
        solved = solver.refine(proposal.candidate, solved)
    return proposal.candidate, solved


def _verify(criterion: Mom, proposals: list[Proposal], clock: '_Clock') -> Verification | None:
    """Score every candidate by both evaluations."""
    query_points, local_map, settings = (
        criterion.query_points,
        criterion.local_map,
        criterion.settings,
    )
    if query_points is None:
        return None
    poses = [proposal.poses for proposal in proposals if proposal.poses is not None]
    clock.lap('verify')
    fast = fast_scores(query_points, np.array(poses), local_map, settings).tolist()
    fast_seconds = clock.lap('verify')
    direct = [direct_score(query_points, pose, local_map, settings) for pose in poses]
    direct_seconds = clock.lap('verify')
    pairs = list(zip(fast, direct, strict=True))
    pick = min(range(len(pairs)), key=lambda i: pairs[i][0])
    best = min(range(len(pairs)), key=lambda i: pairs[i][1])
    floor = pairs[best][1]
    return Verification(
        same_winner=pick == best,
        regret=pairs[pick][1] / floor - 1.0 if floor > 0 else 0.0,
        fast_seconds=fast_seconds,
        direct_seconds=direct_seconds,
        setup_seconds=clock.seconds.get('score', 0.0),
        scored=len(pairs),
    )


class _Clock:
    """Adds up the seconds of a window's stages."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = self.began = time.perf_counter()

    def lap(self, stage: str) -> float:
        """Charge the time since the last lap to a stage."""
        now = time.perf_counter()
        passed, self._last = now - self._last, now
        self.seconds[stage] = self.seconds.get(stage, 0.0) + passed
        return passed
