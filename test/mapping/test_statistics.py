"""Numbers of a window and of a run: sums and percentages of known graphs."""

from collections import Counter
from dataclasses import replace

import pytest
from turning_car import MS, known_state, problem_of
from turning_car import settings as car_settings

from incremental_mapper.candidates.model import CoreKind, CoreMeasurement
from incremental_mapper.frontend.gnss import Datum
from incremental_mapper.mapping.base_count import BaseCount
from incremental_mapper.mapping.commit import commit
from incremental_mapper.mapping.statistics import Totals, map_statistics, window_row
from incremental_mapper.scoring.verification import Verification
from incremental_mapper.selection.cheapest import LeastTimeShift
from incremental_mapper.selection.choice import Choice
from incremental_mapper.settings import to_tree

WINDOW = {40 * MS: {'left'}, 62 * MS: {'gps'}, 97 * MS: {'right'}, 140 * MS: {'left'}}
CORE = [
    CoreMeasurement(40, 'left', CoreKind.LIDAR),
    CoreMeasurement(62, 'gps', CoreKind.GNSS),
    CoreMeasurement(140, 'left', CoreKind.LIDAR),
]


def choice_of(stamps=None):
    problem = problem_of(WINDOW if stamps is None else stamps)
    return LeastTimeShift().select(problem), problem


NO_WINNER = Choice(None, None, 'mom_3', 9, 4, 2, True, {}, ())


def test_totals_are_sums_over_windows():
    totals = Totals()
    choice, _ = choice_of()
    totals.add_choice(choice)
    totals.add_choice(replace(choice, score_name='other', cut=True))
    totals.add_choice(NO_WINNER)
    assert totals.enumerated == 2 * choice.enumerated + 9
    assert totals.connected == 2 * choice.connected + 4
    assert totals.solved == 2
    assert totals.cut_windows == 2
    assert totals.carried_windows == 1
    assert totals.time_shift == 2 * choice.winner.time_shift > 0
    assert totals.scores == {'time_shift': 1, 'other': 1}
    assert totals.verifications == []
    totals.add_seconds({'solve': 0.5})
    totals.add_seconds({'solve': 0.25, 'append': 1.0})
    assert totals.seconds == {'solve': 0.75, 'append': 1.0}


def test_row_of_a_window_says_what_was_chosen():
    choice, _ = choice_of()
    seconds = {'front_end': 0.1, 'solve': 0.2, 'verify': 5.0}
    row = window_row(3, (10, 90), CORE, 17, choice, 2.5, seconds)
    assert (row['window'], row['start_ns'], row['end_ns']) == (3, 10, 90)
    assert (row['core'], row['imu'], row['sensors']) == (3, 17, 'gps:1 left:2')
    winner = choice.winner
    assert row['clusters'] == len(winner.clusters)
    assert row['connections'] == len(winner.connections)
    assert row['members'] == '|'.join(
        '+'.join(member.sensor for member in cluster.members) for cluster in winner.clusters
    )
    assert row['score_name'] == 'time_shift' and row['score'] == choice.score
    assert row['time_shift_s'] == winner.time_shift / 1e9
    assert row['solver_error'] == 2.5
    assert (row['candidates_enumerated'], row['candidates_connected']) == (
        choice.enumerated,
        choice.connected,
    )
    assert (row['candidates_solved'], row['cut']) == (0, 0)
    assert row['front_end_s'] == 0.1 and row['solve_s'] == 0.2 and row['append_s'] == 0.0
    # Checking the fast score is no part of what a window takes.
    assert row['window_s'] == pytest.approx(0.3)


def test_row_of_a_window_without_a_winner_or_a_choice():
    row = window_row(0, (0, 1), CORE, 0, NO_WINNER, 0.0, {})
    assert row['candidates_enumerated'] == 9 and row['cut'] == 1
    assert (row['clusters'], row['connections'], row['members']) == (0, 0, '')
    assert (row['score_name'], row['score'], row['time_shift_s']) == ('', None, 0.0)
    empty = window_row(0, (0, 1), [], 5, None, 0.0, {})
    assert (empty['core'], empty['sensors'], empty['imu']) == (0, '', 5)
    assert (empty['candidates_enumerated'], empty['candidates_solved'], empty['cut']) == (0, 0, 0)


def stats_of(state, base, totals, **changes):
    known = {'drops': Counter(), 'notes': Counter(), 'late': 0, 'unused': [], 'datum': None}
    made = map_statistics(to_tree(car_settings()), state, base, totals, **{**known, **changes})
    return made.to_tree()


def committed():
    state = known_state()
    choice, problem = choice_of()
    problem = problem_of(WINDOW, state)
    choice = LeastTimeShift().select(problem)
    commit(state, 0, choice, problem)
    return state, choice.winner


def base_of(count):
    base = BaseCount(10**9)
    for index in range(count):
        base.add_element(index * 100 * MS, 1, 0, index > 0)
    return base


def test_run_counts_what_is_in_the_graph():
    state, winner = committed()
    totals = Totals(first_stamp=2 * 10**9, last_stamp=5 * 10**9, windows=4)
    stats = stats_of(state, base_of(9), totals)
    inertial = 1 + len(winner.inertial_clusters - {-1})
    clusters = 1 + len(winner.clusters)
    assert stats['clusters'] == clusters
    assert stats['vertices'] == clusters + inertial + 1
    kinds = {'pose': clusters, 'velocity': inertial, 'bias': 1}
    assert stats['vertices_by_kind'] == kinds
    assert stats['factors'] == len(state.factors) == sum(stats['factors_by_kind'].values())
    assert stats['factors_by_kind']['imu'] == len(winner.connections)
    assert list(stats['factors_by_kind']) == sorted(stats['factors_by_kind'])
    assert stats['components'] == 1 and stats['weak_priors'] == 0
    assert stats['drive_s'] == 3.0 and stats['windows'] == 4
    assert stats['base_clusters'] == 9
    assert stats['base_vertices'] == 27
    shares = [('vertices', 27), ('factors', base_of(9).total_factors), ('clusters', 9)]
    for name, base in shares:
        share = 100.0 * (1.0 - stats[name] / base)
        assert stats[f'compression_{name}_percent'] == pytest.approx(share)
    assert stats['base_factors'] == sum(stats['base_factors_by_kind'].values())
    assert 'verification' not in stats


def test_empty_run_has_numbers_too():
    stats = stats_of(type(known_state())(), BaseCount(10**9), Totals())
    assert (stats['vertices'], stats['factors'], stats['drive_s']) == (0, 0, 0.0)
    assert stats['compression_vertices_percent'] == 0.0
    assert (stats['weak_priors'], stats['components']) == (0, 0)


def test_run_tells_of_everything_that_was_not_used():
    state, _ = committed()
    drops = Counter({('left', 'late'): 2, ('gps', 'low_status'): 1, ('left', 'bad'): 3})
    weak = 'held weakly in some direction'
    notes = Counter({'left: match rejected': 4, f'left: {weak}': 2, f'right: {weak}': 1})
    totals = Totals(bridges=2, solver_failures=1, merged_windows=3, time_shift=2_500_000_000)
    totals.received.update({'left': 7})
    totals.add_seconds({'solve': 0.123456, 'verify': 9.0})
    stats = stats_of(state, base_of(2), totals, drops=drops, notes=notes, late=5, unused=CORE)
    assert stats['dropped'] == {'gps': {'low_status': 1}, 'left': {'bad': 3, 'late': 2}}
    assert stats['notes'] == notes and stats['weak_matches'] == 3
    assert stats['unused_measurements'] == 3 and stats['late_but_used'] == 5
    assert (stats['bridges'], stats['solver_failures'], stats['merged_windows']) == (2, 1, 3)
    assert stats['total_time_shift_s'] == 2.5
    assert stats['received'] == {'left': 7}
    assert stats['seconds_by_stage']['solve'] == 0.1235
    assert 'verify' not in stats['seconds_by_stage']
    assert stats['datum'] is None
    datum = Datum(36.5, 127.25, 50.0)
    assert stats_of(state, base_of(2), totals, datum=datum)['datum'] == [36.5, 127.25, 50.0]


def test_verified_windows_are_summed_up():
    state, _ = committed()
    totals = Totals()
    for same, regret, scored in ((True, 0.0, 4), (False, 0.02, 6), (False, 0.001, 1)):
        found = Verification(same, regret, 0.1, 0.4, 0.2, scored)
        totals.add_choice(replace(NO_WINNER, verification=found))
    found = stats_of(state, base_of(2), totals)['verification']
    assert found['windows_with_a_choice'] == 2 and found['same_winner'] == 1
    assert found['agreement_percent'] == 50.0
    assert found['worst_regret_percent'] == pytest.approx(2.0)
    assert found['candidates_scored'] == 11
    assert found['direct_over_fast'] == pytest.approx(4.0)


def test_a_hole_of_years_is_no_driving():
    totals = Totals()
    for first, last in [(10, 12), (13, 14), (1_500_000_000, 1_500_000_003)]:
        totals.add_stamps(first * 10**9, last * 10**9)
    assert totals.last_stamp - totals.first_stamp - totals.skipped == 7 * 10**9
