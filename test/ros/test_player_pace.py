"""The pace of a player, on a clock that the test moves."""

import math

import pytest

from incremental_mapper.ros.player.pace import Pace

START = 1_700_000_000_000_000_000
SECOND = 1_000_000_000


class Clock:
    now = 5 * SECOND

    def __call__(self):
        return self.now

    def pass_(self, seconds):
        self.now += round(seconds * SECOND)


@pytest.fixture
def clock():
    return Clock()


@pytest.mark.parametrize('rate', [0.1, 1.0, 2.5, 10.0])
def test_deadlines_are_absolute(clock, rate):
    pace = Pace(rate, START, clock)
    for number in range(1, 1000):
        stamp = START + number * 37_000_001
        clock.pass_(max(pace.left(stamp), 0.0) + 0.003)  # each is 3 ms late
        assert pace.left(stamp) == pytest.approx(-0.003, abs=1e-6)
    elapsed = (clock.now - Clock.now) / SECOND
    assert pace.stamp() == pytest.approx(START + elapsed * rate * SECOND, abs=rate * 1000)


def test_lateness_does_not_move_the_next_message(clock):
    pace = Pace(1.0, START, clock)
    clock.pass_(3.0)
    assert pace.left(START + SECOND) == -2.0
    assert pace.left(START + 4 * SECOND) == 1.0


def test_pause(clock):
    pace = Pace(2.0, START, clock)
    clock.pass_(1.0)
    pace.toggle()
    assert pace.paused
    clock.pass_(100.0)
    assert pace.left(START) == math.inf
    assert pace.stamp() == START + 2 * SECOND
    pace.toggle()
    assert not pace.paused
    assert pace.stamp() == START + 2 * SECOND
    assert pace.left(START + 3 * SECOND) == 0.5
