"""Solving a window's candidates, which have most of their factors in common."""

from collections.abc import Mapping

from incremental_mapper.candidates.model import Candidate
from incremental_mapper.frontend.dead_reckoning import State
from incremental_mapper.graph.factor_builder import FactorBuilder
from incremental_mapper.graph.initial_guess import InitialGuess
from incremental_mapper.smoothing.gauss_newton import SharedProblem, Solved
from incremental_mapper.smoothing.marginal_prior import MarginalPrior


class CandidateSolver:
    """Solves candidates, one after the other.

    The first one starts from the predicted states; the others, where that one put the car.
    """

    def __init__(
        self,
        prior: MarginalPrior,
        factors: FactorBuilder,
        guess: InitialGuess,
        max_iterations: int,
    ) -> None:
        """Nothing is solved yet.

        Args:
            prior: What G(t-1) says of its frontier.
            factors: Builds the candidates' factors.
            guess: The values from which they are solved.
            max_iterations: Of one solve.
        """
        self._factors = factors
        self._guess = guess
        self._shared = SharedProblem(prior, max_iterations)
        self._states: Mapping[int, State] | None = None

    def solve(self, candidate: Candidate) -> Solved | None:
        """Solve a candidate on top of G(t-1) (paper, Algorithm 1, step 5).

        Args:
            candidate: A connected candidate.

        Returns:
            Its optimum, as exact as a comparison asks; None where there is none.
        """
        self._guess.add(candidate, self._shared.values, self._states)
        made = [factor.factor for factor in self._factors.factors(candidate)]
        solved = self._shared.solve_next(made)
        if self._states is None and solved is not None:
            self._states = self._guess.warm_start(candidate, solved.own())
        return solved

    def refine(self, candidate: Candidate, solved: Solved) -> Solved | None:
        """Go on from a candidate's optimum until it has truly converged.

        Args:
            candidate: The winner.
            solved: What ``solve`` gave for it.

        Returns:
            The solution with its true error, as it may be appended; None where there is none.
        """
        made = [factor.factor for factor in self._factors.factors(candidate)]
        return self._shared.refine(solved, made)
