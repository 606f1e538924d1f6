"""Seconds of a window's stages."""

import time

from incremental_mapper.selection import stopwatch
from incremental_mapper.selection.stopwatch import Stopwatch


def test_laps_of_a_stage_add_up(monkeypatch):
    moments = iter([10.0, 11.0, 13.5, 14.0])
    monkeypatch.setattr(stopwatch.time, 'perf_counter', lambda: next(moments))
    clock = Stopwatch()
    assert clock.began == 10.0
    assert [clock.lap('solve'), clock.lap('score'), clock.lap('solve')] == [1.0, 2.5, 0.5]
    assert clock.seconds == {'solve': 1.5, 'score': 2.5}


def test_clock_is_the_real_one():
    clock, began = Stopwatch(), time.perf_counter()
    assert 0.0 <= clock.lap('solve') <= time.perf_counter() - began + 0.1
