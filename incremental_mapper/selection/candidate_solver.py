"""Solving a window's candidates, which have most of their factors in common."""

from collections.abc import Mapping

from incremental_mapper.candidates.model import Candidate
from incremental_mapper.frontend.dead_reckoning import State
from incremental_mapper.selection.window_problem import Task
from incremental_mapper.smoothing.gauss_newton import SharedProblem, Solved


class CandidateSolver:
    """Solves candidates, one after the other.

    The first one starts from the predicted states; the others, where that one put the car.
    """

    def __init__(self, task: Task) -> None:
        self._factors = task.factors
        self._problem = SharedProblem(task.prior, task.max_iterations)
        self._states: Mapping[int, State] | None = None

    def solve(self, candidate: Candidate) -> Solved | None:
        """The candidate's optimum, as exact as a comparison asks; None where there is none."""
        self._factors.add_initial(candidate, self._problem.values, self._states)
        made = [factor.factor for factor in self._factors.factors(candidate)]
        solved = self._problem.solve_next(made)
        if self._states is None and solved is not None:
            self._states = self._factors.warm_start(candidate, solved.own())
        return solved

    def refine(self, candidate: Candidate, solved: Solved) -> Solved | None:
        """The candidate's solution with its true error, as it may be appended."""
        made = [factor.factor for factor in self._factors.factors(candidate)]
        return self._problem.refine(solved, made)
