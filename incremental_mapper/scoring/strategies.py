"""What makes one candidate better than another: the protocol, and the registry of strategies."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.candidates.model import Candidate
from incremental_mapper.config import MomSettings, Strategy
from incremental_mapper.errors import ConfigError
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.scoring.mom import (
    LocalMap,
    QueryPoints,
    choose_query_points,
    direct_score,
    fast_scores,
)


@dataclass(frozen=True, slots=True, eq=False)
class Proposal:
    """A connected candidate as a criterion sees it.

    ``solver_error`` is Σ‖h(x)−z‖²_Σ over the candidate's own factors; ``poses`` (S, 4, 4) are the
    solved T_map_base of the local_map's moving scans. Both are None where nothing was solved.
    """

    candidate: Candidate
    solver_error: float | None = None
    poses: NDArray[np.float64] | None = None


class Criterion(Protocol):
    """QueryPoints the candidates of one window; the lowest score wins."""

    @property
    def name(self) -> str:
        """What the score is, for the output."""

    def score(self, proposal: Proposal) -> float:
        """Score of one candidate; not comparable between windows."""


@runtime_checkable
class BatchCriterion(Criterion, Protocol):
    """A criterion that query_points many candidates for less than one by one."""

    def scores(self, proposals: Sequence[Proposal]) -> list[float]:
        """Scores of the candidates, in their order."""


def score_all(criterion: Criterion, proposals: Sequence[Proposal]) -> list[float]:
    """Scores of a window's candidates, in one go where the criterion can do that."""
    if isinstance(criterion, BatchCriterion):
        return criterion.scores(proposals)
    return [criterion.score(proposal) for proposal in proposals]


@dataclass(frozen=True, slots=True, eq=False)
class StrategyPlan:
    """How a strategy works: what it needs of each candidate, and its criterion.

    ``solve`` asks for solved candidates and ``local_map`` for a local_map to judge them on;
    ``only_base`` takes the conventional candidate, connected or not. ``by_time_shift`` says that
    the criterion is the time shift, whose optimum is found without enumerating.
    """

    make: Callable[[LocalMap | None, MomSettings, bool], Criterion]
    solve: bool = True
    local_map: bool = False
    only_base: bool = False
    by_time_shift: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class TimeShift:
    """Total time shift in seconds (paper, Minimum Time Shift)."""

    name: str = 'time_shift'

    def score(self, proposal: Proposal) -> float:
        """See Criterion."""
        return proposal.candidate.time_shift / NANOSECONDS


@dataclass(frozen=True, slots=True, eq=False)
class SolverError:
    """Squared Mahalanobis norm of the candidate's factors (paper, Minimum Solver Error)."""

    name: str = 'solver_error'

    def score(self, proposal: Proposal) -> float:
        """See Criterion."""
        return float('inf') if proposal.solver_error is None else proposal.solver_error


@dataclass(frozen=True, slots=True, eq=False)
class Mom:
    """MOM of the local map, or the time shift where the local_map has no plane at all.

    ``direct`` searches the neighbourhoods of every candidate again. Without ``exact`` candidates
    that the local_map did not foresee keep the neighbourhoods of those that it did.
    """

    local_map: LocalMap
    settings: MomSettings
    query_points: QueryPoints | None
    direct: bool = False
    exact: bool = True

    @property
    def name(self) -> str:
        """``mom_3`` (or ``_2``, ``_1`` families), ``plane_variance``, or ``time_shift``."""
        return 'time_shift' if self.query_points is None else self.query_points.score_name

    def score(self, proposal: Proposal) -> float:
        """See Criterion."""
        return self.scores([proposal])[0]

    def scores(self, proposals: Sequence[Proposal]) -> list[float]:
        """See BatchCriterion."""
        poses = [proposal.poses for proposal in proposals if proposal.poses is not None]
        if self.query_points is None or len(poses) < len(proposals):
            return [TimeShift().score(proposal) for proposal in proposals]
        if not self.direct:
            found = fast_scores(
                self.query_points, np.array(poses), self.local_map, self.settings, self.exact
            )
            return [float(score) for score in found]
        return [
            direct_score(self.query_points, pose, self.local_map, self.settings) for pose in poses
        ]


def _make_mom(local_map: LocalMap | None, settings: MomSettings, direct: bool) -> Criterion:
    if local_map is None:
        return TimeShift()
    return Mom(local_map, settings, choose_query_points(local_map, settings), direct)


_PLANS: dict[str, StrategyPlan] = {
    Strategy.MOM: StrategyPlan(make=_make_mom, local_map=True),
    Strategy.BASE: StrategyPlan(make=lambda *_: TimeShift(), solve=False, only_base=True),
    Strategy.MIN_TIME_SHIFT: StrategyPlan(
        make=lambda *_: TimeShift(), solve=False, by_time_shift=True
    ),
    Strategy.MIN_SOLVER_ERROR: StrategyPlan(make=lambda *_: SolverError()),
}


def register(name: str, plan: StrategyPlan) -> None:
    """Add a strategy under a new name; raises ConfigError where the name is taken."""
    if name in _PLANS:
        raise ConfigError(f'strategy {name!r} is already registered')
    _PLANS[name] = plan


def strategy_plan(name: str) -> StrategyPlan:
    """The strategy of that name; raises ConfigError with the known names."""
    try:
        return _PLANS[name]
    except KeyError:
        known = ', '.join(_PLANS)
        raise ConfigError(f'selection.strategy is {name!r}; known strategies: {known}') from None


def strategy_names() -> list[str]:
    """Names of all registered strategies."""
    return [str(name) for name in _PLANS]
