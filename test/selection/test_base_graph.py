"""The conventional graph: connected or not, and what holds what is not."""

import pytest
from turning_car import MS, imu_series, problem_of

from incremental_mapper.candidates.enumeration import base_candidate
from incremental_mapper.selection.base_graph import BaseGraph
from incremental_mapper.variables import pose_key

WINDOW = {40 * MS: {'left'}, 62 * MS: {'gps'}, 97 * MS: {'right'}}


@pytest.mark.parametrize('samples', [True, False])
def test_base_graph_is_taken_whether_it_is_connected_or_not(samples):
    series = imu_series(-50 * MS, 200 * MS) if samples else imu_series(0, 0)
    problem = problem_of(WINDOW, series=series)
    choice = BaseGraph().select(problem)
    assert choice.winner == base_candidate(problem.elements, problem.head, problem.imu)
    assert choice.consecutive and not choice.cut
    assert (choice.enumerated, choice.solved, choice.score_name) == (1, 0, 'base')
    assert choice.score is None and choice.solution is None
    (tried,) = choice.tried
    assert tried.candidate == choice.winner
    assert tried.connected == samples and choice.connected == int(samples)
    # Without samples nothing connects the fix, which a prior holds.
    alone = problem.partitions.number(choice.winner.clusters[1])
    assert [factor.keys for factor in choice.extra] == ([] if samples else [(pose_key(alone),)])
    assert BaseGraph().warm_up() is None
