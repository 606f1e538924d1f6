"""The strategy ``base``: the conventional graph, connected or not (paper, Base)."""

from incremental_mapper.candidates.enumeration import base_candidate
from incremental_mapper.selection.choice import Choice, Tried
from incremental_mapper.selection.stopwatch import Stopwatch
from incremental_mapper.selection.window_problem import WindowProblem


class BaseGraph:
    """One cluster an element, consecutive connections where IMU samples allow.

    A regularising prior at the predicted pose keeps each unconnected component well posed.
    """

    def select(self, problem: WindowProblem) -> Choice:
        """See Strategy."""
        clock = Stopwatch()
        base = base_candidate(problem.elements, problem.head, problem.imu)
        unconnected = problem.unconnected(base)
        clock.lap('candidates')
        return Choice(
            winner=base,
            score=None,
            score_name='base',
            enumerated=1,
            connected=int(not unconnected),
            solved=0,
            cut=False,
            seconds=clock.seconds,
            tried=(Tried(base, not unconnected),),
            extra=tuple(problem.factors.regularising_prior(part[0]) for part in unconnected),
            consecutive=True,
        )

    def warm_up(self) -> None:
        """See Strategy."""
