"""The strategy that solves candidates and takes the lowest score: ``mom`` and ``min_solver_error``.

Enumerates or searches, filters by connectivity, solves the rest, scores them, and picks one
(paper, Algorithm 1, steps 3 to 5).
"""

import time
from collections.abc import Callable, Sequence
from functools import partial
from itertools import islice

import numpy as np

from incremental_mapper.candidates.enumeration import base_candidate
from incremental_mapper.candidates.local_moves import neighbours
from incremental_mapper.candidates.model import HEAD, Candidate
from incremental_mapper.candidates.time_shift_search import by_time_shift
from incremental_mapper.quantiles import chi_squared
from incremental_mapper.scoring import mom
from incremental_mapper.scoring.criteria import ByFunction, Criterion, Mom, Proposal, mom_criterion
from incremental_mapper.scoring.ties import agrees
from incremental_mapper.scoring.verification import verify
from incremental_mapper.selection.beam_search import MakeCriterion, beam_search
from incremental_mapper.selection.choice import Choice, Tried
from incremental_mapper.selection.selector import all_candidates, best_index, connected_candidates
from incremental_mapper.selection.stopwatch import Stopwatch
from incremental_mapper.selection.window_problem import WindowProblem
from incremental_mapper.smoothing.candidate_solver import CandidateSolver
from incremental_mapper.smoothing.gauss_newton import Solved

AT_ONCE = 6
"""Candidates that are solved between two looks at the clock."""
MOST_PREFIXES = 50_000
"""Prefixes that are followed in search of a connected candidate where the beam has none: half a
second. A window of ninety fixes has millions, and mostly it is its measurements that are wrong."""
PATIENCE = 60
"""Candidates whose single decisions are changed in vain before a search ends."""


def _nothing() -> None:
    pass


class LowestScore:
    """Solves the connected candidates and takes the one with the lowest score."""

    def __init__(
        self,
        make_criterion: MakeCriterion,
        warm_up: Callable[[], None] = _nothing,
        breaks_ties: bool = False,
    ) -> None:
        """A strategy out of a criterion.

        Args:
            make_criterion: Makes the criterion of a window from its problem and its proposals.
                With its third argument off, exact values are not needed yet.
            warm_up: Compiles or loads what the criterion needs.
            breaks_ties: Whether it goes by ``selection.tie_confidence``.
        """
        self._breaks_ties = breaks_ties
        self._make_criterion = make_criterion
        self._warm_up = warm_up

    @classmethod
    def of(cls, name: str, score: Callable[[Proposal], float]) -> 'LowestScore':
        """A strategy out of a function of one candidate.

        Args:
            name: What the score is, for the output.
            score: Score of a solved candidate; the lowest one wins.

        Returns:
            The strategy; name it in the entry-point group ``incremental_mapper.strategies``.
        """
        criterion = ByFunction(name, score)
        return cls(lambda *_: criterion)

    def select(self, problem: WindowProblem) -> Choice:
        """See Strategy."""
        return _Selection(problem, self._make_criterion, self._breaks_ties).run()

    def warm_up(self) -> None:
        """See Strategy."""
        self._warm_up()


def _make_mom(
    problem: WindowProblem, proposals: Sequence[Proposal], exact: bool = True
) -> Criterion:
    poses = [proposal.poses for proposal in proposals if len(proposal.poses)]
    local_map = problem.local_maps.local_map(poses) if poses else None
    config = problem.config
    return mom_criterion(local_map, config.mom, config.selection.direct, exact)


lowest_mom = LowestScore(_make_mom, mom.warm_up, breaks_ties=True)
"""The method of the paper."""


class _Selection:
    """One window's way to its choice."""

    def __init__(
        self, problem: WindowProblem, make_criterion: MakeCriterion, breaks_ties: bool
    ) -> None:
        self._problem = problem
        self._settings = problem.config.selection
        self._breaks_ties = breaks_ties and self._settings.tie_confidence > 0.0
        self._make_criterion = make_criterion
        self._clock = Stopwatch()
        self._proposals: list[Proposal] = []
        self._solved: list[Solved] = []
        self._scores: list[float] = []

    def run(self) -> Choice:
        clock, problem = self._clock, self._problem
        looked, cut = self._candidates()
        pool = connected_candidates(problem, looked, held_first=True)
        connected, found = pool.connected, pool.found
        cut |= pool.limited
        clock.lap('candidates')
        self._solver = CandidateSolver(
            problem.prior, problem.factors, problem.guess, problem.config.graph.max_iterations
        )
        eligible = self._linked_first(pool.eligible)
        careful = self._breaks_ties and not problem.may_merge
        self._all_linked = careful and all(item.linked for item in eligible)
        self._all_held = all(problem.held(item) for item in eligible)
        self._propose(eligible)
        criterion = self._make_criterion(problem, self._proposals, True)
        self._scores = criterion.scores(self._proposals)
        clock.lap('score')
        if cut and problem.limit is None:
            changed = self._change_decisions(criterion)
            looked += changed
            connected |= set(map(id, changed))
            found += len(changed)
        verification = None
        if self._settings.verify and isinstance(criterion, Mom):
            verification = verify(criterion, self._proposals, clock.seconds.get('score', 0.0))
            clock.lap('verify')
        best = self._best(self._scores)
        tied = self._tied(criterion, best)
        judged = {
            id(proposal.candidate): (
                self._scores[i],
                proposal.solver_error,
                None if tied is None else tied[i],
            )
            for i, proposal in enumerate(self._proposals)
        }
        lowest, best = best, self._smallest(best, tied)
        clock.lap('score')
        winner, solution, saved = None, None, 0
        if best is not None and lowest is not None:
            winner = self._proposals[best].candidate
            solution = self._solver.refine(winner, self._solved[best])
            saved = self._proposals[lowest].candidate.vertices - winner.vertices
        clock.lap('solve')
        return Choice(
            winner=winner,
            score=None if best is None else self._scores[best],
            score_name=criterion.name,
            enumerated=len(looked),
            connected=found,
            solved=len(self._proposals),
            cut=cut,
            seconds=clock.seconds,
            tried=tuple(
                Tried(item, id(item) in connected, *judged.get(id(item), (None, None, None)))
                for item in looked
            ),
            solution=solution,
            verification=verification,
            tied=sum(tied or []),
            saved=saved,
        )

    def _candidates(self) -> tuple[list[Candidate], bool]:
        """The candidates to choose from, and whether there may be better ones."""
        problem, settings = self._problem, self._settings
        every = all_candidates(problem)
        if every is not None:
            return every, False
        window = problem.elements, problem.head, problem.imu
        width = min(settings.beam_width, problem.limit or settings.beam_width)
        # The conventional graph takes part as well, first as in an enumeration: what is found is
        # never worse than it, and the map is judged at the same points.
        base = base_candidate(*window)
        if problem.apart:
            return [base], False  # until more comes, or a bridge is made
        searched = beam_search(problem, self._make_criterion, width, self._seconds())
        found = [base, *(item for item in searched if item != base)]
        if all(problem.unconnected(item) for item in found):
            others = by_time_shift(*window, most=MOST_PREFIXES)
            found += islice(others, settings.max_candidates)
        return found, True

    def _seconds(self) -> float:
        """How long the beam may take."""
        return self._settings.time_budget * self._problem.config.window.duration

    def _propose(self, some: Sequence[Candidate]) -> list[Proposal]:
        """Solve connected candidates; what cannot be solved is left out."""
        fresh: list[Proposal] = []
        for candidate in some:
            solved = self._solver.solve(candidate)
            if solved is not None:
                locate = partial(self._problem.local_maps.poses, candidate, solved.pose)
                fresh.append(Proposal(candidate, solved.error, locate))
                self._solved.append(solved)
            self._clock.lap('solve')
        self._proposals += fresh
        return fresh

    def _best(self, scores: Sequence[float]) -> int | None:
        return best_index(scores, [proposal.candidate for proposal in self._proposals])

    def _linked_first(self, eligible: Sequence[Candidate]) -> Sequence[Candidate]:
        """Before the velocity is known, those that are linked, where there are any.

        Then two LiDARs' scans may stand anywhere to each other within what the speed could be,
        which a map of so few scans does not show. Spans can tell it later, where there are any.
        """
        if self._problem.may_merge or not self._breaks_ties:
            return eligible
        return [item for item in eligible if item.linked] or eligible

    def _may_win(self, item: Candidate) -> bool:
        """Whether a candidate is what those that may win have all had to be."""
        problem = self._problem
        return (
            (problem.may_merge or not item.merges)
            and (not self._all_linked or item.linked)
            and (not self._all_held or problem.held(item))
        )

    def _tied(self, criterion: Criterion, best: int | None) -> list[bool] | None:
        """Which proposals cannot be told from the best; None where that is not asked."""
        if best is None or not isinstance(criterion, Mom) or not self._breaks_ties:
            return None
        confidence = self._settings.tie_confidence
        return [bool(tied) for tied in criterion.ties(self._proposals, best, confidence)]

    def _smallest(self, best: int | None, tied: list[bool] | None) -> int | None:
        """Of those that tie with the best the smallest that is consistent with the others."""
        if best is None or tied is None:
            return best
        even = [i for i, is_tied in enumerate(tied) if is_tied]
        candidates = [self._proposals[i].candidate for i in even]
        order = sorted(
            zip(even, candidates, strict=True),
            key=lambda pair: (pair[1].vertices, pair[1].time_shift, self._scores[pair[0]]),
        )
        least = min(even, key=lambda i: self._solved[i].cost)
        for i, candidate in order:
            if candidate.vertices >= self._proposals[best].candidate.vertices:
                break
            if candidate.linked and self._consistent(i, least):
                return i
        return best

    def _consistent(self, one: int, least: int) -> bool:
        """Whether a proposal contradicts its factors no more than the least contradicted one.

        And turns the scans no more than matching may be wrong: MOM does not see rotations (paper,
        end of Evaluation Metric).
        """
        config = self._problem.config
        confidence = config.selection.tie_confidence
        costs = [self._solved[i].cost for i in (one, least)]
        freedoms = [self._freedom(self._proposals[i].candidate) for i in (one, least)]
        if not agrees(costs[0], freedoms[0], costs[1], freedoms[1], confidence):
            return False
        ours, theirs = (self._proposals[i].poses[:, :3, :3] for i in (one, least))
        # A chord of the circle: for small angles the angle itself.
        angles = np.linalg.norm(ours - theirs, axis=(1, 2)) / np.sqrt(2.0)
        allowed = config.odometry.sigma_rotation * np.sqrt(chi_squared(confidence, 3))
        return bool((angles <= allowed).all())

    def _freedom(self, candidate: Candidate) -> int:
        """Degrees of freedom: dimensions of the factors less those of the variables."""
        factors = self._problem.factors.factors(candidate)
        inertial = len(candidate.inertial_clusters - {HEAD})
        biases = candidate.vertices - len(candidate.clusters) - inertial
        variables = 6 * len(candidate.clusters) + 3 * inertial + 6 * biases
        return sum(factor.factor.dim() for factor in factors) - variables

    def _change_decisions(self, criterion: Criterion) -> list[Candidate]:
        """Change single decisions of the best candidates until PATIENCE of them were in vain.

        Returns what was tried. Ends half a time budget after the beam had to, at the latest.
        """
        problem = self._problem
        until = self._clock.began + 1.5 * self._seconds()
        seen = {proposal.candidate for proposal in self._proposals}
        added: list[Candidate] = []
        expanded: set[int] = set()
        idle = 0
        while idle < PATIENCE and time.perf_counter() < until:
            best = self._best(
                [np.inf if i in expanded else score for i, score in enumerate(self._scores)]
            )
            if best is None:
                break
            expanded.add(best)
            before = min(self._scores)
            centre = self._proposals[best].candidate
            around = dict.fromkeys(neighbours(centre, problem.elements, problem.head, problem.imu))
            fresh = [
                item
                for item in around
                if item not in seen
                and self._may_win(item)
                and not problem.unconnected(item)
                and problem.held(item)
            ]
            seen.update(around)
            for start in range(0, len(fresh), AT_ONCE):
                if time.perf_counter() >= until:
                    break
                some = fresh[start : start + AT_ONCE]
                self._scores += criterion.scores(self._propose(some))
                self._clock.lap('score')
                added += some
            idle = 0 if min(self._scores) < before else idle + 1
        return added
