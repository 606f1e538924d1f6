"""The strategy ``min_time_shift``: no candidate is solved (paper, Minimum Time Shift)."""

from itertools import islice

from incremental_mapper.candidates.model import Candidate
from incremental_mapper.candidates.time_shift_search import by_time_shift
from incremental_mapper.scoring.criteria import TIME_SHIFT, Proposal
from incremental_mapper.selection.choice import Choice, Tried
from incremental_mapper.selection.selector import all_candidates, best_index, connected_candidates
from incremental_mapper.selection.stopwatch import Stopwatch
from incremental_mapper.selection.window_problem import WindowProblem

LOOKED_AT = 5000
"""Candidates after which the search for the least shifted connected one gives up."""


class LeastTimeShift:
    """Takes the connected candidate with the least total time shift.

    A window with too many candidates is not enumerated: the search yields them by ascending time
    shift, so that the optimum is exact.
    """

    def select(self, problem: WindowProblem) -> Choice:
        """See Strategy."""
        clock = Stopwatch()
        looked, cut = all_candidates(problem), False
        if looked is None:
            looked = _least_shifted(problem)
            cut = not looked or bool(problem.unconnected(looked[-1]))
        pool = connected_candidates(problem, looked)
        clock.lap('candidates')
        scores = TIME_SHIFT.scores([Proposal(item) for item in pool.eligible])
        clock.lap('score')
        best = best_index(scores, pool.eligible)
        judged = dict(zip(map(id, pool.eligible), scores, strict=True))
        return Choice(
            winner=None if best is None else pool.eligible[best],
            score=None if best is None else scores[best],
            score_name=TIME_SHIFT.name,
            enumerated=len(looked),
            connected=pool.found,
            solved=0,
            cut=cut or pool.limited,
            seconds=clock.seconds,
            tried=tuple(
                Tried(item, id(item) in pool.connected, judged.get(id(item))) for item in looked
            ),
        )

    def warm_up(self) -> None:
        """See Strategy."""


def _least_shifted(problem: WindowProblem) -> list[Candidate]:
    """Candidates by ascending time shift, up to the last of the least shifted connected ones.

    Exact: the search yields them in that order. At most LOOKED_AT are looked at.
    """
    for may_merge in (False, True)[int(problem.may_merge) :]:
        looked: list[Candidate] = []
        winners: list[Candidate] = []
        search = by_time_shift(problem.elements, problem.head, problem.imu, may_merge)
        for candidate in islice(search, LOOKED_AT):
            if winners and candidate.time_shift > winners[0].time_shift:
                break
            looked.append(candidate)
            if not problem.unconnected(candidate):
                winners.append(candidate)
        if winners:
            return [item for item in looked if item not in winners] + winners
    return looked
