"""A window whose choice raises: it costs that window, and the map goes on."""

import logging
from itertools import count

import pytest

from incremental_mapper.errors import OutputError
from incremental_mapper.selection import strategies


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
