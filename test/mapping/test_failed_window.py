"""A window whose choice raises: it costs that window, and the map goes on."""

import logging
from itertools import count

import numpy as np
import pytest

from incremental_mapper.errors import InputError, OutputError
from incremental_mapper.selection import strategies
from incremental_mapper.selection.window_record import load_window, reselect_window


class Raising:
    """Chooses as ``min_time_shift`` does, and raises in some windows."""

    def __init__(self, error, *windows):
        self._error, self._windows, self._number = error, windows, count(1)

    def warm_up(self):
        pass

    def select(self, problem):
        if next(self._number) in self._windows:
            raise self._error
        return strategies.find_strategy('min_time_shift').select(problem)


@pytest.fixture
def map_raising(map_light, light_drive, monkeypatch):
    def run(error, *windows):
        monkeypatch.setitem(strategies.BUILT_IN, 'raising', Raising(error, *windows))
        text = 'graph:\n  motion_compensation: true\n'
        return map_light(light_drive, config=text, strategy='raising')

    return run


def test_it_costs_the_window_and_is_counted(map_raising, caplog):
    with caplog.at_level(logging.ERROR, logger='incremental_mapper'):
        run = map_raising(KeyError('x12'), 6, 7, 15)
    assert run.status == 0
    assert run.stats['failed_windows'] == 3
    lost = sum(reasons['window_failed'] for reasons in run.stats['dropped'].values())
    assert 3 <= lost <= 9
    assert run.stats['components'] == 1 and run.stats['bridges'] == 0
    # A whole drive has 0.05 m; the scans after a hole of two windows hang on the IMU alone.
    assert run.stats['ate_rmse_m'] < 0.1
    assert 'windows failed' in run.out
    # Logged once, with what would be needed to find the cause.
    told = [record for record in caplog.records if 'is left out' in record.getMessage()]
    assert len(told) == 1
    assert 'window 5' in told[0].getMessage() and told[0].exc_info[0] is KeyError


def test_first_window_may_fail_too(map_raising):
    run = map_raising(RuntimeError('no values'), 1)
    assert run.status == 0
    assert run.stats['failed_windows'] == 1
    assert run.stats['components'] == 1


def test_what_a_user_must_be_told_is_not_taken_for_a_fault_of_one_window(map_raising):
    run = map_raising(OutputError('the map cannot be kept on disk'), 3)
    run.assert_refused('cannot be kept on disk')


def test_its_inputs_are_saved_and_fail_again(map_raising):
    run = map_raising(KeyError('x12'), 6, 7, 15, 16)
    kept = sorted(run.folder.glob('failed_window_*.npz'))
    assert [path.name for path in kept] == [f'failed_window_{n}.npz' for n in (14, 5, 6)]
    strategies.BUILT_IN['raising'] = Raising(KeyError('x12'), 1)
    with pytest.raises(KeyError, match='x12'):
        reselect_window(kept[0])


def test_a_recorded_window_is_the_window(map_raising, monkeypatch):
    """What is loaded gives the choice that the strategy would have made in the run."""
    choices = []

    class Choosing(Raising):
        def select(self, problem):
            choices.append(strategies.find_strategy('mom').select(problem))
            return super().select(problem)

    monkeypatch.setattr('test_failed_window.Raising', Choosing)
    run = map_raising(KeyError('x12'), 12)
    problem = load_window(run.folder / 'failed_window_11.npz')
    again = strategies.find_strategy('mom').select(problem)
    there = choices[11]
    assert again.winner == there.winner
    assert (again.score, again.enumerated) == (there.score, there.enumerated)
    assert [item.solver_error for item in again.tried] == [
        item.solver_error for item in there.tried
    ]


def test_what_is_no_record_is_refused(tmp_path):
    path = tmp_path / 'failed_window_1.npz'
    np.savez(path, text=np.array('{"format": 1, "items": {"is": "record", "of": ["os:x", {}]}}'))
    with pytest.raises(InputError, match='no record of a failed window'):
        load_window(path)
    with pytest.raises(InputError, match='no record of a failed window'):
        reselect_window(tmp_path / 'none.npz')
