"""Criteria: one by one or many at once, and those of a user."""

from functools import cache

import pytest
from room_scene import SETTINGS, jittered, room_scene

from incremental_mapper.scoring.mom import (
    choose_query_points,
)
from incremental_mapper.scoring.strategies import Mom, Proposal, score_all


@cache
def mom_criterion(direct):
    local_map = jittered(room_scene(4), 6, 0.05, 2e-3)
    return Mom(local_map, SETTINGS, choose_query_points(local_map, SETTINGS), direct)


@pytest.mark.parametrize('direct', [False, True])
def test_batch_of_proposals_scores_as_each_does(direct):
    criterion = mom_criterion(direct)
    proposals = [Proposal(None, poses=poses) for poses in criterion.local_map.poses]
    together = score_all(criterion, proposals)
    assert together == pytest.approx([criterion.score(one) for one in proposals], rel=1e-12)
    assert together == pytest.approx(score_all(mom_criterion(not direct), proposals), rel=1e-9)
    assert all(type(score) is float for score in together)
    assert score_all(criterion, []) == []


def test_criterion_of_a_user_is_asked_one_by_one():
    class Worst:
        name = 'worst'

        def score(self, proposal):
            return -proposal.solver_error

    proposals = [Proposal(None, solver_error=error) for error in (1.0, 3.0, 2.0)]
    assert score_all(Worst(), proposals) == [-1.0, -3.0, -2.0]
