"""Criteria: many proposals at once, a function of one candidate, and what is computed when."""

from functools import cache

import numpy as np
import pytest
from room_scene import SETTINGS, jittered, room_scene

from incremental_mapper.scoring.criteria import (
    SOLVER_ERROR,
    TIME_SHIFT,
    ByFunction,
    Mom,
    Proposal,
    mom_criterion,
)
from incremental_mapper.scoring.mom import LocalMap


@cache
def made(direct):
    local_map = jittered(room_scene(4), 6, 0.05, 2e-3)
    criterion = mom_criterion(local_map, SETTINGS, direct)
    assert isinstance(criterion, Mom)
    return criterion


@pytest.mark.parametrize('direct', [False, True])
def test_batch_of_proposals_scores_as_each_does(direct):
    criterion = made(direct)
    proposals = [
        Proposal(None, locate=lambda poses=poses: poses) for poses in criterion.local_map.poses
    ]
    together = criterion.scores(proposals)
    alone = [score for one in proposals for score in criterion.scores([one])]
    assert together == pytest.approx(alone, rel=1e-12)
    assert together == pytest.approx(made(not direct).scores(proposals), rel=1e-9)
    assert len(set(together)) == len(together)
    assert all(type(score) is float for score in together)


def test_function_is_asked_one_by_one_in_order():
    criterion = ByFunction('worst', lambda proposal: -proposal.solver_error)
    proposals = [Proposal(None, solver_error=error) for error in (1.0, 3.0, 2.0)]
    assert criterion.scores(proposals) == [-1.0, -3.0, -2.0]


def test_unsolved_candidate_never_wins_by_its_solver_error():
    assert SOLVER_ERROR.scores([Proposal(None), Proposal(None, 7.0)]) == [np.inf, 7.0]


def test_poses_are_computed_once_and_only_when_asked_for():
    asked = []

    def locate():
        asked.append(True)
        return np.zeros((1, 4, 4))

    proposal = Proposal(None, 1.0, locate)
    assert SOLVER_ERROR.scores([proposal]) == [1.0]
    assert not asked
    assert proposal.poses is proposal.poses
    assert len(asked) == 1


def test_without_anything_planar_the_time_shift_judges():
    assert mom_criterion(None, SETTINGS) is TIME_SHIFT
    cloud = np.random.default_rng(1).uniform(-9.0, 9.0, (300, 3))
    empty = LocalMap(np.zeros((0, 3)), [cloud], np.eye(4)[None, None], 1, np.zeros(3))
    assert mom_criterion(empty, SETTINGS) is TIME_SHIFT
