"""Criteria: what makes one candidate better than another; the lowest score wins."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.candidates.model import Candidate
from incremental_mapper.config import MomSettings
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.scoring.mom import (
    LocalMap,
    QueryPoints,
    choose_query_points,
    direct_score,
    direct_variances,
    fast_variances,
    weighted,
)
from incremental_mapper.scoring.ties import planes_of, ties


def _no_scans() -> NDArray[np.float64]:
    """Poses where there is no scan to place."""
    return np.zeros((0, 4, 4))


@dataclass(frozen=True, eq=False)
class Proposal:
    """A connected candidate as a criterion sees it.

    Attributes:
        candidate: Its clusters and connections.
        solver_error: Σ‖h(x)−z‖²_Σ over its own factors, None where it was not solved.
        locate: Computes ``poses``; called once, and only where a criterion asks for them.
    """

    candidate: Candidate
    solver_error: float | None = None
    locate: Callable[[], NDArray[np.float64]] = _no_scans

    @cached_property
    def poses(self) -> NDArray[np.float64]:
        """T_map_base (S, 4, 4) of the window's new scans, then of recent ones that move along."""
        return self.locate()


class Criterion(Protocol):
    """Judges the candidates of one window."""

    @property
    def name(self) -> str:
        """What the score is, for the output."""

    def scores(self, proposals: Sequence[Proposal]) -> list[float]:
        """Judge the candidates of one window.

        Args:
            proposals: Connected candidates; what was not solved has no error and no poses.

        Returns:
            Their scores in their order, the lowest best; not comparable between windows. What is
            not finite never wins.
        """


@dataclass(frozen=True, slots=True, eq=False)
class ByFunction:
    """A criterion that is a function of one candidate.

    Attributes:
        name: What the score is, for the output.
        score: Score of a candidate; infinity where it must not win.
    """

    name: str
    score: Callable[[Proposal], float]

    def scores(self, proposals: Sequence[Proposal]) -> list[float]:
        """See Criterion."""
        return [self.score(proposal) for proposal in proposals]


def _time_shift(proposal: Proposal) -> float:
    return proposal.candidate.time_shift / NANOSECONDS


def _solver_error(proposal: Proposal) -> float:
    return float('inf') if proposal.solver_error is None else proposal.solver_error


TIME_SHIFT = ByFunction('time_shift', _time_shift)
"""Total time shift in seconds (paper, Minimum Time Shift)."""
VERTICES = ByFunction('vertices', lambda item: item.candidate.vertices + 1e-3 * _time_shift(item))
"""Number of variables; where it is the same, the total time shift in thousands of seconds."""
SOLVER_ERROR = ByFunction('solver_error', _solver_error)
"""Squared Mahalanobis norm of the candidate's factors (paper, Minimum Solver Error)."""


@dataclass(frozen=True, slots=True, eq=False)
class Mom:
    """MOM of the local map (paper, Evaluation Metric).

    Attributes:
        local_map: What the window's candidates are judged on.
        settings: Radius, thresholds and sizes.
        query_points: Where they are judged.
        direct: Search the neighbourhoods of every candidate again.
        exact: Do so for candidates that the local map did not foresee; else these keep the
            neighbourhoods of those that it did.
    """

    local_map: LocalMap
    settings: MomSettings
    query_points: QueryPoints
    direct: bool = False
    exact: bool = True
    # The proposals that were judged last, and their variances.
    _judged: list[tuple[tuple[Proposal, ...], NDArray[np.float64]]] = field(
        default_factory=list, init=False, repr=False
    )

    @property
    def name(self) -> str:
        """``mom_3`` (or ``_2``, ``_1`` families) or ``plane_variance``."""
        return self.query_points.score_name

    def scores(self, proposals: Sequence[Proposal]) -> list[float]:
        """See Criterion."""
        points, local_map, settings = self.query_points, self.local_map, self.settings
        if self.direct:
            return [direct_score(points, item.poses, local_map, settings) for item in proposals]
        scores: list[float] = weighted(points, self._variances(proposals)).tolist()
        return scores

    def ties(
        self, proposals: Sequence[Proposal], best: int, confidence: float
    ) -> NDArray[np.bool_]:
        """Tell which candidates cannot be told from the best, see ``scoring.ties``.

        Args:
            proposals: Candidates with finite scores (C).
            best: Index of the one with the lowest.
            confidence: At which a difference counts.

        Returns:
            Whether each ties with the best (C,).
        """
        points, local_map, settings = self.query_points, self.local_map, self.settings
        if self.direct:
            each = [direct_variances(points, item.poses, local_map, settings) for item in proposals]
            variances = np.array(each)
        else:
            variances = self._variances(proposals)
        planes = planes_of(points.points, points.family, points.axes, settings.radius)
        return ties(variances, best, points.weights, planes, confidence)

    def _variances(self, proposals: Sequence[Proposal]) -> NDArray[np.float64]:
        """Plane variances (C, P), computed once where the same proposals are asked for again."""
        asked = tuple(proposals)
        if self._judged and self._judged[0][0] == asked:
            return self._judged[0][1]
        poses = np.array([proposal.poses for proposal in proposals])
        variances = fast_variances(
            self.query_points, poses, self.local_map, self.settings, self.exact
        )
        self._judged[:] = [(asked, variances)]
        return variances


def mom_criterion(
    local_map: LocalMap | None, settings: MomSettings, direct: bool = False, exact: bool = True
) -> Criterion:
    """MOM, or the time shift where there is nothing to judge a map by.

    Args:
        local_map: What candidates are judged on; None where there is no scan, new or recent.
        settings: Those of MOM.
        direct: See ``Mom``.
        exact: See ``Mom``.

    Returns:
        The criterion; it is the time shift where the local map has no plane at all.
    """
    points = None if local_map is None else choose_query_points(local_map, settings)
    if local_map is None or points is None:
        return TIME_SHIFT
    return Mom(local_map, settings, points, direct, exact)
