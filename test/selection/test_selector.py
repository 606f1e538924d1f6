"""Which candidates may win, and which one does where scores agree."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from turning_car import MS, imu_series, problem_of, settings

from incremental_mapper.candidates.enumeration import candidates
from incremental_mapper.candidates.model import CoreKind
from incremental_mapper.graph.connectivity import Partitions
from incremental_mapper.selection.cheapest import FewestVertices, LeastTimeShift
from incremental_mapper.selection.lowest_score import LowestScore
from incremental_mapper.selection.selector import best_index, connected_candidates

WINDOW = {40 * MS: {'left'}, 62 * MS: {'gps'}, 97 * MS: {'right'}, 140 * MS: {'left'}}


def all_candidates(problem):
    return list(candidates(problem.elements, problem.head, problem.imu))


def cuts(candidate):
    return [cluster.last for cluster in candidate.clusters]


EVERY = all_candidates(problem_of(WINDOW))


def test_lowest_finite_score_wins():
    assert best_index([3.0, 1.0, 2.0], EVERY[:3]) == 1
    assert best_index([np.nan, np.inf, 2.0, -np.inf], EVERY[:4]) == 2
    assert best_index([np.nan, np.inf], EVERY[:2]) is None
    assert best_index([], []) is None


@given(st.lists(st.sampled_from(EVERY), min_size=2, max_size=8, unique_by=id))
def test_equal_scores_go_to_fewer_vertices_then_to_more_clusters_then_to_earlier_cuts(some):
    winner = some[best_index([1.0] * len(some), some)]
    for other in some:
        assert winner.vertices <= other.vertices
        if winner.vertices == other.vertices:
            assert len(winner.clusters) >= len(other.clusters)
            if len(winner.clusters) == len(other.clusters):
                assert cuts(winner) <= cuts(other)


def test_every_step_of_the_order_decides_somewhere():
    pairs = [(one, other) for one in EVERY for other in EVERY if one is not other]
    fewer = [p for p in pairs if p[0].vertices < p[1].vertices]
    # More clusters, but as many variables: the chain visits fewer of them.
    finer = [
        (one, other)
        for one, other in pairs
        if one.vertices == other.vertices and len(one.clusters) > len(other.clusters)
    ]
    earlier = [
        (one, other)
        for one, other in pairs
        if one.vertices == other.vertices
        and len(one.clusters) == len(other.clusters)
        and cuts(one) < cuts(other)
    ]
    for some in (fewer, finer, earlier):
        assert some
        for one, other in some:
            assert best_index([5.0, 5.0], [other, one]) == 1
            assert best_index([5.0, 5.0], [one, other]) == 0


def test_equal_candidates_are_told_apart_by_their_connections():
    same = [
        (one, other)
        for one in EVERY
        for other in EVERY
        if one.clusters == other.clusters
        and one.vertices == other.vertices
        and one.connections < other.connections
    ]
    assert same
    for one, other in same:
        assert best_index([0.0, 0.0], [other, one]) == 1


def sparse_problem(**kwargs):
    """A window in which many candidates leave the fix or more unconnected."""
    return problem_of(WINDOW, series=imu_series(-50 * MS, 45 * MS), **kwargs)


def test_only_what_is_connected_may_win():
    problem = sparse_problem()
    every = all_candidates(problem)
    pool = connected_candidates(problem, every)
    expected = [item for item in every if not problem.unconnected(item)]
    assert 0 < len(expected) < len(every)
    assert pool.eligible == expected
    assert pool.found == len(expected)
    assert pool.connected == {id(item) for item in expected}
    assert not pool.limited


@pytest.mark.parametrize('limit', [1, 2, 5, 1000])
def test_limit_leaves_the_least_shifted_candidates(limit):
    problem = problem_of(WINDOW, limit=limit)
    every = all_candidates(problem)
    pool = connected_candidates(problem, every)
    connected = [item for item in every if not problem.unconnected(item)]
    assert pool.found == len(connected)
    assert pool.limited == (limit < len(connected))
    assert len(pool.eligible) == min(limit, len(connected))
    kept = {id(item) for item in pool.eligible}
    worst = max(item.time_shift for item in pool.eligible)
    assert all(item.time_shift >= worst for item in connected if id(item) not in kept)
    assert pool.connected == {id(item) for item in connected}


def test_limit_that_is_just_reached_leaves_nothing_out():
    problem = problem_of(WINDOW)
    every = all_candidates(problem)
    found = connected_candidates(problem, every).found
    exact = connected_candidates(problem_of(WINDOW, limit=found), every)
    assert exact.found == len(exact.eligible) == found
    assert not exact.limited


@pytest.mark.parametrize('limit', [1, 3])
def test_strategies_judge_the_least_shifted_candidates_only(limit):
    """Under load no others are solved, and none is changed afterwards."""
    problem = problem_of(WINDOW, limit=limit)
    connected = [item for item in all_candidates(problem) if not problem.unconnected(item)]
    least = sorted(item.time_shift for item in connected)[:limit]
    # The most shifted one would win, if it were among them.
    strategy = LowestScore.of('shifted', lambda proposal: -proposal.candidate.time_shift)
    for found in (strategy.select(problem), LeastTimeShift().select(problem)):
        judged = [item.candidate.time_shift for item in found.tried if item.score is not None]
        assert sorted(judged) == least
        assert found.cut
        assert found.connected == len(connected)
    assert strategy.select(problem).winner.time_shift == least[-1]
    assert strategy.select(problem).solved == limit


def test_merging_is_the_last_resort_while_the_velocity_is_unknown():
    problem = problem_of(WINDOW)
    every = all_candidates(problem)
    careful = replace(problem, may_merge=False)
    pool = connected_candidates(careful, every)
    assert pool.eligible and not any(item.merges for item in pool.eligible)
    assert len(pool.eligible) < pool.found + 1 <= len(every)
    assert any(item.merges for item in every if id(item) in pool.connected)
    only = [item for item in every if item.merges]
    assert connected_candidates(careful, only).eligible == [
        item for item in only if not careful.unconnected(item)
    ]


def test_a_cluster_on_weak_matches_alone_is_the_last_resort():
    problem = problem_of(WINDOW)
    for core, item in problem.inputs.prepared.items():
        if core.kind is CoreKind.LIDAR:
            problem.inputs.prepared[core] = replace(item, covariance=np.eye(6))
    problem = replace(
        problem, partitions=Partitions(problem.inputs.prepared, problem.inputs.frontier)
    )
    every = all_candidates(problem)
    pool = connected_candidates(problem, every, held_first=True)
    assert 0 < len(pool.eligible) < pool.found
    ends = [{link.end for link in item.connections} for item in pool.eligible]
    whole = [set(range(len(item.clusters))) for item in pool.eligible]
    assert ends == whole
    assert len(connected_candidates(problem, every).eligible) == pool.found
    loose = [item for item in every if not item.connections]
    assert connected_candidates(problem, loose, held_first=True).eligible == [
        item for item in loose if not problem.unconnected(item)
    ]


@pytest.mark.parametrize('most', [1, 1000])
@pytest.mark.parametrize(
    ('strategy', 'cost'),
    [
        (LeastTimeShift(), lambda item: item.time_shift),
        (FewestVertices(), lambda item: (item.vertices, item.time_shift)),
    ],
)
def test_cheapest_connected_candidate_wins_enumerated_or_searched(strategy, cost, most):
    problem = problem_of(WINDOW, config=settings(selection={'max_candidates': most}))
    connected = [item for item in all_candidates(problem) if not problem.unconnected(item)]
    found = strategy.select(problem)
    assert cost(found.winner) == min(map(cost, connected))
    assert not found.cut and found.solved == 0
