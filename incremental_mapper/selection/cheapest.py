"""The strategies that solve no candidate: ``min_time_shift`` (paper) and ``fewest``."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import islice
from typing import TypeAlias

from incremental_mapper.candidates.model import Candidate
from incremental_mapper.candidates.partitions import Element
from incremental_mapper.candidates.spans import ImuStamps
from incremental_mapper.candidates.time_shift_search import by_time_shift, by_vertices
from incremental_mapper.scoring.criteria import TIME_SHIFT, VERTICES, ByFunction, Proposal
from incremental_mapper.selection.choice import Choice, Tried
from incremental_mapper.selection.selector import all_candidates, best_index, connected_candidates
from incremental_mapper.selection.stopwatch import Stopwatch
from incremental_mapper.selection.window_problem import WindowProblem

Search: TypeAlias = Callable[[Sequence[Element], int | None, ImuStamps, bool], Iterator[Candidate]]
"""Candidates of a window, by ascending score."""

LOOKED_AT, FOLLOWED = 5000, 300_000
"""Candidates, and prefixes of them, after which the search for the cheapest connected one gives
up: 5 s and 60 MB. Only windows of a hundred measurements, hardly any of them usable, have more."""


class _Cheapest:
    """Takes the connected candidate with the lowest score that is a sum over its parts.

    A window with too many candidates is not enumerated: the search yields them by ascending score,
    so that the optimum is exact.
    """

    def __init__(self, criterion: ByFunction, search: Search) -> None:
        self._criterion = criterion
        self._search = search

    def select(self, problem: WindowProblem) -> Choice:
        """See Strategy."""
        clock = Stopwatch()
        looked, cut = all_candidates(problem), False
        if looked is None:
            looked = [] if problem.apart else self._ascending(problem)
            cut = not problem.apart and (not looked or bool(problem.unconnected(looked[-1])))
        pool = connected_candidates(problem, looked)
        clock.lap('candidates')
        scores = self._scores(pool.eligible)
        clock.lap('score')
        best = best_index(scores, pool.eligible)
        judged = dict(zip(map(id, pool.eligible), scores, strict=True))
        return Choice(
            winner=None if best is None else pool.eligible[best],
            score=None if best is None else scores[best],
            score_name=self._criterion.name,
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

    def _scores(self, candidates: Sequence[Candidate]) -> list[float]:
        return self._criterion.scores([Proposal(item) for item in candidates])

    def _ascending(self, problem: WindowProblem) -> list[Candidate]:
        """Candidates by ascending score, up to the last of the cheapest connected ones.

        Exact: the search yields them in that order. At most LOOKED_AT are looked at.
        """
        for may_merge in (False, True)[int(problem.may_merge) :]:
            looked: list[Candidate] = []
            winners: list[Candidate] = []
            lowest = float('inf')
            search = self._search(problem.elements, problem.head, problem.imu, may_merge)
            for candidate in islice(search, LOOKED_AT):
                (score,) = self._scores([candidate])
                if score > lowest:
                    break
                looked.append(candidate)
                if not problem.unconnected(candidate):
                    winners.append(candidate)
                    lowest = score
            if winners:
                return [item for item in looked if item not in winners] + winners
        return looked


class LeastTimeShift(_Cheapest):
    """Takes the connected candidate with the least total time shift (paper)."""

    def __init__(self) -> None:
        super().__init__(TIME_SHIFT, partial(by_time_shift, most=FOLLOWED))


class FewestVertices(_Cheapest):
    """Takes the connected candidate with the fewest variables, then the least time shift.

    Nothing is measured of the map: what a metric is worth, it is worth beyond this.
    """

    def __init__(self) -> None:
        super().__init__(VERTICES, partial(by_vertices, most=FOLLOWED))
