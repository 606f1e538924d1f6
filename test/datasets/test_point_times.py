"""Times of points that cannot be those of a sweep."""

import numpy as np
import pytest

from incremental_mapper.datasets.point_times import point_times

RNG = np.random.default_rng(8)
COUNT = 1800
TURN = np.linspace(0.0, 2.0 * np.pi, COUNT, endpoint=False)
POINTS = np.stack([9.0 * np.cos(TURN), 9.0 * np.sin(TURN), np.ones(COUNT)], axis=1)
SWEEP = 0.1 * TURN / (2.0 * np.pi)


def found(times, points=POINTS):
    table = np.zeros(len(times), dtype=[('time', '<f4')])
    table['time'] = times
    return point_times(table, 1_500_000_000_000_000_000, points.astype(np.float32))


def test_a_sweep_is_no_noise_in_any_order():
    assert found(SWEEP).seconds == pytest.approx(SWEEP, abs=1e-6)
    order = RNG.permutation(COUNT)
    shuffled = found(SWEEP[order], POINTS[order])
    assert shuffled.remarks == ()
    assert shuffled.seconds == pytest.approx(SWEEP[order], abs=1e-6)


def test_a_scan_that_does_not_turn_is_no_noise():
    """Times go with the order of the points where directions tell nothing, as of a rosette."""
    anywhere = RNG.normal(size=(COUNT, 3)) * 9.0
    assert found(SWEEP, anywhere).remarks == ()


def test_times_by_chance_are_not_used_and_it_is_said():
    noise = found(RNG.uniform(0.0, 0.1, COUNT))
    assert noise.seconds is None
    assert [remark.reason for remark in noise.remarks] == ['not_deskewed']
    assert 'noise' in noise.note
