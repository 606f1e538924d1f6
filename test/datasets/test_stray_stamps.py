"""Stray stamps of a bag, beside messages that came late."""

import pytest

from incremental_mapper.datasets.stray_stamps import StrayStamps
from incremental_mapper.measurements import NANOSECONDS

LAG = NANOSECONDS // 20
"""Nanoseconds from stamp to record time, as they are usual here."""


def strays(lags, period=0.1, usual=LAG):
    """Which of some messages with these lags beyond the usual one (s) are stray, one a period."""
    watch = StrayStamps({'left': usual})
    times = [round((100.0 + period * number) * NANOSECONDS) for number in range(len(lags))]
    return [
        watch.is_stray('left', time - round(lag * NANOSECONDS) - LAG, time)
        for time, lag in zip(times, lags, strict=True)
    ]


@pytest.mark.parametrize('behind', [1.6, 2.3, 4.9, 60.0, -1.5, -60.0])
@pytest.mark.parametrize('place', [0, 1, 10, 19])
def test_one_stray_stamp_is_found_wherever_it_is(behind, place):
    lags = [0.0] * 20
    lags[place] = behind
    assert strays(lags) == [number == place for number in range(20)]


def test_strays_that_are_most_of_the_messages_are_found():
    lags = [2.3, 0.0, 3.1, 1.7, 0.0, 4.4, 2.0, 0.0]
    assert strays(lags) == [lag > 1.0 for lag in lags]


def test_a_backlog_comes_in_the_order_of_stamps_and_passes():
    """The recorder stands for 3 s, and then gets at once what waited."""
    times = [0.1 * number for number in range(20)] + [5.0 + 0.001 * n for n in range(30)]
    stamps = [0.1 * number for number in range(50)]
    watch = StrayStamps({'left': 0})
    found = [
        watch.is_stray('left', round(stamp * NANOSECONDS), round(time * NANOSECONDS))
        for stamp, time in zip(stamps, times, strict=True)
    ]
    assert not any(found)


def test_messages_out_of_order_within_the_latency_pass():
    assert not any(strays([0.0, 0.5, 0.2, 0.9, 0.0]))


def test_nothing_is_said_where_no_lag_is_usual():
    watch = StrayStamps({})
    assert not watch.is_stray('left', 0, 100 * NANOSECONDS)
