"""Search of windows that are too large to enumerate, against the enumeration of smaller ones."""

from dataclasses import replace

import numpy as np
import pytest

import incremental_mapper.mapping.mapper as mapper_module
from incremental_mapper.candidates.enumeration import candidates
from incremental_mapper.datasets.open import open_source
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.results.opened_drive import effective_config
from incremental_mapper.scoring.criteria import SOLVER_ERROR
from incremental_mapper.selection.beam_search import beam_search
from incremental_mapper.selection.strategies import find_strategy

UNLIMITED = 1e6


@pytest.fixture
def tasks(monkeypatch, light_drive):
    """Maps a drive and hands over what each window's choice was made of, and the settings."""

    def collect(duration, strategy):
        tree = {
            'window': {'duration': duration},
            'selection': {'strategy': strategy},
            'odometry': {'method': 'gicp'},
            'graph': {'motion_compensation': True},
            'mom': {'max_points': 150},
        }
        source = open_source(light_drive, tree)
        config = effective_config(source, tree, 'test')
        seen = []

        class Watching:
            def __init__(self, name):
                self._strategy = find_strategy(name)

            def warm_up(self):
                self._strategy.warm_up()

            def select(self, problem):
                # The state behind a problem moves on, so what is asked of it is asked here.
                choice = self._strategy.select(problem)
                seen.append((problem, choice, questions(problem) if questions else None))
                return choice

        questions = collect.questions
        monkeypatch.setattr(mapper_module, 'find_strategy', Watching)
        mapper = Mapper(config, list(source.info.counts))
        for measurement in source.measurements():
            mapper.push(measurement)
        mapper.finish()
        return seen

    collect.questions = None
    return collect


def with_selection(problem, **changes):
    """The same window under other settings of the selection."""
    selection = problem.config.selection.model_copy(update=changes)
    return replace(problem, config=problem.config.model_copy(update={'selection': selection}))


def connected(task):
    every = candidates(task.elements, task.head, task.imu)
    reachable = [item for item in every if not task.unconnected(item)]
    if not task.may_merge:
        return [item for item in reachable if not item.merges]
    return reachable


def test_beam_that_never_drops_a_prefix_finds_every_connected_candidate(tasks):
    def everything(task):
        if len(task.elements) > 3:
            return None
        return beam_search(task, lambda *_: SOLVER_ERROR, 1000, UNLIMITED)

    tasks.questions = everything
    compared = 0
    for task, _, found in tasks(0.15, 'min_solver_error'):
        if found is not None:
            assert len(set(found)) == len(found)
            assert set(connected(task)) <= set(found)
            assert set(found) <= set(candidates(task.elements, task.head, task.imu))
            compared += len(found)
    assert compared > 20


@pytest.mark.parametrize('strategy', ['mom', 'min_solver_error'])
def test_search_finds_the_winner_of_the_enumeration(tasks, strategy):
    def search(task):
        changed = with_selection(task, max_candidates=1, time_budget=UNLIMITED)
        return find_strategy(strategy).select(changed)

    tasks.questions = search
    same, windows = 0, 0
    for task, exhaustive, searched in tasks(0.2, strategy):
        if len(task.elements) > 7 or exhaustive.winner is None:
            continue
        scores = {item.candidate: item.score for item in exhaustive.tried}
        windows += 1
        same += searched.winner == exhaustive.winner
        assert searched.winner in scores
        assert scores[searched.winner] <= 1.02 * exhaustive.score
    assert windows > 8
    assert same >= 0.9 * windows


def test_least_time_shift_is_found_without_enumerating(tasks):
    def search(task):
        return find_strategy('min_time_shift').select(with_selection(task, max_candidates=20))

    tasks.questions = search
    searched_windows = 0
    for _, exhaustive, searched in tasks(0.3, 'min_time_shift'):
        if exhaustive.cut or exhaustive.winner is None:
            continue
        searched_windows += len(searched.tried) < len(exhaustive.tried)
        assert not searched.cut
        assert searched.winner == exhaustive.winner
    assert searched_windows > 2


@pytest.mark.parametrize(
    ('strategy', 'ate'),
    [('mom', 0.11), ('min_solver_error', 0.19), ('min_time_shift', 0.26)],
)
def test_windows_of_seconds_are_mapped(map_light, light_drive, strategy, ate):
    text = 'window:\n  duration: 2.0\nselection:\n  beam_width: 2\nmom:\n  max_points: 100\n'
    run = map_light(light_drive, config=text, strategy=strategy)
    assert run.status == 0
    assert run.stats['components'] == 1
    assert run.stats['ate_rmse_m'] < ate  # half as much again as is measured
    assert max(int(row['core']) for row in run.rows) > 20
    # The time shift is exact whatever the size; the others say that they did not see everything.
    assert (run.stats['cut_windows'] > 0) == (strategy != 'min_time_shift')


def test_little_time_makes_the_beam_narrow_and_still_gives_a_result(map_light, light_drive):
    text = 'window:\n  duration: 2.0\nselection:\n  time_budget: 0.001\n'
    run = map_light(light_drive, config=text, strategy='min_solver_error')
    assert run.status == 0
    assert run.stats['components'] == 1


@pytest.mark.parametrize(('strategy', 'metres'), [('mom', 0.11), ('min_solver_error', 0.24)])
def test_scan_that_is_no_start_for_the_next_one_is_searched_around(
    map_light, light_copy, strategy, metres
):
    # A sliver of a sweep has too few points to be matched: the next scan is matched to the one
    # before it, whose pose must still be there when that scan is placed.
    paths = sorted((light_copy / 'sensor_data' / 'VLP_left').glob('*.bin'))
    for path in paths[3::7]:
        np.fromfile(path, dtype='<f4').reshape(-1, 4)[:60].tofile(path)
    text = 'window:\n  duration: 0.5\n'
    run = map_light(light_copy, config=text, strategy=strategy)
    assert run.status == 0
    assert run.stats['cut_windows'] > 0
    assert run.stats['notes']['left: too few points to match'] == len(paths[3::7])
    assert run.stats['components'] == 1
    # Half as much again as measured: 0.074 m and 0.155 m.
    assert run.stats['ate_rmse_m'] < metres
