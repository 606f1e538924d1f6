"""The strategy that solves candidates: what it looks at, and what it says of them."""

from dataclasses import replace

import numpy as np
import pytest
from turning_car import MS, imu_series, known_state, problem_of
from turning_car import settings as car_settings

from incremental_mapper.candidates.enumeration import base_candidate, candidates
from incremental_mapper.candidates.local_moves import neighbours
from incremental_mapper.selection import lowest_score
from incremental_mapper.selection.cheapest import LeastTimeShift
from incremental_mapper.selection.lowest_score import LowestScore, lowest_mom
from incremental_mapper.variables import pose_key

WINDOW = {40 * MS: {'left'}, 62 * MS: {'gps'}, 97 * MS: {'right'}, 140 * MS: {'left'}}
LARGE = {**WINDOW, 165 * MS: {'gps'}, 197 * MS: {'right'}, 240 * MS: {'left'}}
SMALL_BEAM = {'max_candidates': 1, 'beam_width': 1, 'time_budget': 60.0}


def all_candidates(problem):
    return list(candidates(problem.elements, problem.head, problem.imu))


def by_number(wanted):
    """A criterion that is 0 at one candidate, and the larger the more decisions differ."""

    def score(proposal):
        found = proposal.candidate
        own = {(cluster.first, cluster.last) for cluster in found.clusters}
        best = {(cluster.first, cluster.last) for cluster in wanted.clusters}
        links = {(link.start_stamp, link.end_stamp) for link in found.connections}
        others = {(link.start_stamp, link.end_stamp) for link in wanted.connections}
        return float(len(own ^ best) + len(links ^ others))

    return LowestScore.of('distance', score)


@pytest.mark.parametrize('number', [0, 3, 11, -1])
def test_small_window_is_enumerated_and_the_lowest_score_wins(number):
    problem = problem_of(WINDOW)
    every = [item for item in all_candidates(problem) if not problem.unconnected(item)]
    wanted = every[number]
    choice = by_number(wanted).select(problem)
    assert choice.winner == wanted
    assert choice.score == 0.0 and choice.score_name == 'distance'
    assert not choice.cut
    assert choice.enumerated == len(choice.tried) == len(all_candidates(problem))
    assert choice.connected == choice.solved == len(every)
    assert choice.extra == () and not choice.consecutive
    for item in choice.tried:
        assert item.connected == (not problem.unconnected(item.candidate))
        assert (item.score is None) == (item.solver_error is None) == (not item.connected)
    assert choice.solution.graph is not None
    key = pose_key(problem.partitions.number(wanted.clusters[-1]))
    assert choice.solution.pose(key) is not None
    assert {'candidates', 'solve', 'score'} <= set(choice.seconds)


def test_large_window_is_searched_and_decisions_are_changed_until_none_is_better():
    config = car_settings(selection=SMALL_BEAM)
    problem = problem_of(LARGE, config=config)
    wanted = next(LeastTimeShift().select(problem_of(LARGE)).winner for _ in range(1))
    choice = by_number(wanted).select(problem)
    # One decision after the other leads from wherever the beam ends to the best of all.
    assert choice.winner == wanted and choice.score == 0.0
    assert choice.cut
    tried = [item.candidate for item in choice.tried]
    assert len(set(tried)) == len(tried) == choice.enumerated
    assert tried[0] == base_candidate(problem.elements, problem.head, problem.imu)
    judged = {item.candidate: item.score for item in choice.tried if item.score is not None}
    assert choice.solved == len(judged)
    around = neighbours(choice.winner, problem.elements, problem.head, problem.imu)
    for other in around:
        if not problem.unconnected(other):
            assert judged[other] >= choice.score
    assert choice.connected == sum(item.connected for item in choice.tried)


def test_no_time_means_no_change_of_decisions():
    config = car_settings(selection={**SMALL_BEAM, 'time_budget': 0.001})
    choice = by_number(all_candidates(problem_of(LARGE))[-1]).select(
        problem_of(LARGE, config=config)
    )
    assert choice.winner is not None and choice.cut
    assert choice.enumerated < 60


def test_limit_under_load_allows_no_change_of_decisions():
    config = car_settings(selection=SMALL_BEAM)
    problem = problem_of(LARGE, config=config, limit=4)
    choice = by_number(all_candidates(problem)[-1]).select(problem)
    assert choice.solved <= 4
    assert choice.cut


def test_window_that_nothing_connects_has_no_winner():
    # A fix alone, and no IMU sample.
    problem = problem_of({40 * MS: {'gps'}})
    bare = problem_of({40 * MS: {'gps'}}, series=problem.inputs.series.part(0, 0))
    for strategy in (by_number(all_candidates(problem)[0]), LeastTimeShift()):
        choice = strategy.select(bare)
        assert choice.winner is None and choice.score is None and choice.solution is None
        assert choice.connected == choice.solved == 0
        assert [item.connected for item in choice.tried] == [False]


@pytest.mark.parametrize(
    'strategy', [LowestScore.of('any', lambda proposal: 0.0), LeastTimeShift()]
)
def test_nothing_is_searched_where_nothing_reaches_the_graph(strategy):
    # Fixes alone, and no sample between the graph and the first of them.
    stamps = {(40 + 9 * number) * MS: {'gps'} for number in range(12)}
    config = car_settings(selection={'max_candidates': 8}, preintegration={'max_gap': 0.03})
    far = problem_of(stamps, config=config, series=imu_series(35 * MS, 200 * MS, MS))
    assert far.apart
    choice = strategy.select(far)
    assert choice.winner is None and choice.enumerated <= 1 and not choice.cut
    near = problem_of(stamps, config=config, series=imu_series(-50 * MS, 200 * MS, MS))
    assert not near.apart and strategy.select(near).winner is not None


@pytest.mark.parametrize('first', [-50, 20, 35, 80])
@pytest.mark.parametrize('sensors', [('gps', 'gps'), ('left', 'gps'), ('gps', 'left', 'right')])
def test_where_all_are_apart_no_candidate_is_connected(first, sensors):
    stamps = {(40 + 9 * number) * MS: {name} for number, name in enumerate(sensors)}
    config = car_settings(preintegration={'max_gap': 0.03})
    problem = problem_of(stamps, config=config, series=imu_series(first * MS, 200 * MS, MS))
    connected = [not problem.unconnected(item) for item in all_candidates(problem)]
    assert problem.apart == (not any(connected))


def test_candidate_that_cannot_be_solved_is_left_out():
    problem = problem_of(WINDOW, known_state())
    (seen,) = [item for item in problem.inputs.prepared.values() if item.core.kind == 'gnss']
    seen.enu[0] = np.nan
    choice = by_number(all_candidates(problem)[0]).select(problem)
    assert choice.winner is None and choice.solved == 0
    assert choice.connected == sum(item.connected for item in choice.tried) > 0


def test_least_time_shift_is_exact_with_and_without_enumeration():
    enumerated = LeastTimeShift().select(problem_of(LARGE))
    config = car_settings(selection={'max_candidates': 1})
    searched = LeastTimeShift().select(problem_of(LARGE, config=config))
    assert searched.winner == enumerated.winner
    assert searched.score == enumerated.score == enumerated.winner.time_shift / 1e9
    assert not searched.cut and not enumerated.cut
    assert searched.enumerated < enumerated.enumerated
    assert searched.solved == enumerated.solved == 0
    assert enumerated.score_name == 'time_shift'


def test_search_goes_on_from_the_second_best_where_the_best_has_no_better_neighbour():
    config = car_settings(selection=SMALL_BEAM)
    problem = problem_of(LARGE, config=config)
    connected = [item for item in all_candidates(problem) if not problem.unconnected(item)]
    # As far from the conventional graph as it gets.
    wanted = min(connected, key=lambda item: (len(item.clusters), len(item.connections)))
    base = base_candidate(problem.elements, problem.head, problem.imu)
    bounds = {(cluster.first, cluster.last) for cluster in wanted.clusters}
    assert base != wanted

    def score(proposal):
        # The conventional graph looks as if nothing but the best of all were better.
        clusters = proposal.candidate.clusters
        if proposal.candidate == base:
            return 0.5
        # The beam is led to that end, too.
        if not clusters or clusters[-1].last < len(problem.elements) - 1:
            return -float(len(clusters))
        own = {(cluster.first, cluster.last) for cluster in proposal.candidate.clusters}
        links = {(link.start_stamp, link.end_stamp) for link in proposal.candidate.connections}
        others = {(link.start_stamp, link.end_stamp) for link in wanted.connections}
        return float(len(own ^ bounds) + len(links ^ others))

    assert LowestScore.of('deceptive', score).select(problem).winner == wanted


def test_strategy_of_ones_own_is_warmed_up_by_what_it_brings_along():
    called = []
    criterion = LowestScore.of('none', lambda proposal: 0.0)
    assert criterion.warm_up() is None
    LowestScore(lambda *_: None, lambda: called.append(True)).warm_up()
    assert called == [True]


def test_window_whose_search_finds_nothing_connected_tries_the_least_shifted_candidates():
    selection = {'max_candidates': 8, 'beam_width': 1, 'time_budget': 0.001}
    config = car_settings(selection=selection, preintegration={'max_gap': 0.03})
    # The last fix is too far from any sample: only merged with the two before it is connected.
    series = imu_series(-50 * MS, 50 * MS, MS)
    stamps = {40 * MS: {'gps'}, 49 * MS: {'gps', 'left'}, 81 * MS: {'gps'}}
    problem = problem_of(stamps, config=config, series=series)
    # No prefix can be solved, so none gets through.
    for item in problem.inputs.prepared.values():
        if item.core.kind == 'gnss':
            item.enu[0] = np.nan
    choice = LowestScore.of('any', lambda proposal: 0.0).select(problem)
    assert choice.winner is None and choice.cut
    base = base_candidate(problem.elements, problem.head, problem.imu)
    assert choice.tried[0].candidate == base and not choice.tried[0].connected
    assert choice.connected >= 1


def test_search_ends_when_nothing_better_was_found_for_long_enough(monkeypatch):
    monkeypatch.setattr(lowest_score, 'PATIENCE', 2)
    config = car_settings(selection=SMALL_BEAM)
    problem = problem_of(LARGE, config=config)
    choice = LowestScore.of('same', lambda proposal: 1.0).select(problem)
    every = [item for item in all_candidates(problem) if not problem.unconnected(item)]
    # Two candidates were changed in vain: most of the others have not been looked at.
    assert len(choice.tried) < len(every) / 3


def test_finalists_of_the_beam_are_looked_at_behind_the_conventional_graph():
    selection = {'max_candidates': 1, 'beam_width': 3, 'time_budget': 60.0}
    problem = problem_of(LARGE, config=car_settings(selection=selection), limit=3)
    choice = by_number(LeastTimeShift().select(problem_of(LARGE)).winner).select(problem)
    tried = [item.candidate for item in choice.tried]
    assert len(tried) == len(set(tried)) > 4


STREET = {0: {'left'}, 30 * MS: {'right'}, 100 * MS: {'left'}, 130 * MS: {'right'}}


@pytest.mark.parametrize('may_merge', [True, False])
def test_a_winner_by_a_tie_leaves_no_lidar_without_an_end_of_a_span(may_merge):
    """Nothing else holds two LiDARs together; the map of a few scans does not show it."""
    stamps = {stamp + 5 * MS: sensors for stamp, sensors in STREET.items()}
    config = car_settings(
        selection={'tie_confidence': 0.999999}, mom={'min_family_points': 3, 'radius': 8.0}
    )
    problem = replace(problem_of(stamps, config=config), may_merge=may_merge)
    choice = lowest_mom.select(problem)
    smaller = [
        item.candidate
        for item in choice.tried
        if item.connected and item.candidate.vertices < choice.winner.vertices
    ]
    # Where scans may be merged, that links them and is smaller still.
    assert may_merge or any(not item.linked and not item.merges for item in smaller)
    assert choice.winner.linked
    # Without a rule for ties nothing is barred.
    free = replace(problem, config=car_settings(selection={'tie_confidence': 0.0}))
    scores = [item.score for item in lowest_mom.select(free).tried if item.score is not None]
    assert lowest_mom.select(free).score == min(scores)
