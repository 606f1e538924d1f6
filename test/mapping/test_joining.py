"""What a vehicle measures while it stands joins the newest cluster of G(t)."""

import gtsam
import numpy as np
import pytest
from turning_car import ARM, ENU_OFFSET, MS, START, fix, known_state, scan, settings

from incremental_mapper.frontend.front_end import PreparedFix
from incremental_mapper.graph.factors import FactorKind
from incremental_mapper.mapping.joining import STANDING_SIGMA, join, joinable
from incremental_mapper.variables import velocity_key

SAMPLES = np.arange(0, 60_000, 10) * MS
"""Stamps of an IMU of 100 Hz."""


def fix_at(stamp, apart=(0.0, 0.0, 0.0), sigma=0.05):
    """A fix of a car that has stood at START since stamp 0."""
    item = fix(stamp, sigma)
    antenna = START.transformFrom(ARM)
    return PreparedFix(item.core, antenna - ENU_OFFSET + apart, np.eye(3) * sigma**2)


def standing_state(sigma=1e-3):
    state = known_state(sigma=sigma)
    state.georeferenced = True
    return state


def test_variables_stay_and_the_frontier_goes_on():
    state = standing_state()
    items = [scan(100 * MS, 'left', 0), fix_at(120 * MS), scan(130 * MS, 'right', -30 * MS)]
    assert joinable(state)
    join(state, items, settings(), SAMPLES)
    assert len(state.clusters) == 1 and len(state.scans) == 2
    assert state.clusters[0].joined == tuple(item.core for item in items)
    assert state.clusters[0].stood == (130 * MS,)
    frontier = state.frontier
    assert frontier.newest_stamp == 130 * MS
    assert frontier.chains == {'left': (0, 100 * MS), 'right': (0, 130 * MS)}
    assert all(offset.equals(gtsam.Pose3(), 1e-12) for offset in state.scan_offsets.values())
    assert state.factor_counts[FactorKind.GNSS] == 1


def test_the_span_to_come_starts_where_the_vehicle_stood_for_certain():
    """It is noticed late that one sets off: its velocity is zero half a second before that."""
    state = standing_state()
    for end, start in ((100, 0), (400, 0), (600, 100), (900, 400)):
        join(state, [scan(end * MS, 'left', (end - 100) * MS)], settings(), SAMPLES)
        assert state.frontier.head_stamp == state.frontier.inertial_stamp == start * MS
        assert state.frontier.newest_stamp == end * MS


@pytest.mark.parametrize(
    ('missing', 'start'), [((700, 760), 400), ((500, 700), 700), ((500, 900), 900), ((0, 900), 900)]
)
def test_no_span_starts_before_a_hole_that_it_could_not_cross(missing, start):
    state = standing_state()
    hole = slice(missing[0] // 10, missing[1] // 10)
    samples = np.delete(SAMPLES, hole)
    join(state, [scan(900 * MS, 'left', 800 * MS)], settings(), samples)
    assert state.frontier.head_stamp == state.frontier.inertial_stamp == start * MS


def test_the_average_of_many_fixes_is_where_it_stands():
    rng, state = np.random.default_rng(0), standing_state(sigma=5.0)
    state.fixes.clear()
    for second in range(1, 41):
        join(state, [fix_at(second * 1000 * MS, rng.normal(0.0, 0.5, 3), 0.5)], settings(), SAMPLES)
    apart = state.pose(0).transformFrom(ARM) - START.transformFrom(ARM)
    assert np.linalg.norm(apart) < 4 * 0.5 / np.sqrt(40)
    assert len(state.fixes) == 40 and state.factor_counts[FactorKind.GNSS] == 40
    assert all(state.factors[item.factor].stamps == (item.stamp,) for item in state.fixes)


def test_its_velocity_is_zero_and_that_is_said_once():
    state = known_state(sigma=1.0)
    for step in range(1, 4):
        join(state, [scan(step * 100 * MS, 'left', (step - 1) * 100 * MS)], settings(), SAMPLES)
    assert state.factor_counts[FactorKind.PRIOR_VELOCITY] == 2  # with that of ``known_state``
    covariance = state.prior.covariance(velocity_key(0))
    assert np.sqrt(covariance.diagonal()) == pytest.approx(STANDING_SIGMA, rel=0.01)


def test_a_fix_that_is_elsewhere_is_not_joined_and_nothing_changes():
    state = standing_state()
    before = (state.frontier, state.clusters[0], len(state.factors), state.prior)
    assert join(state, [fix_at(100 * MS, (3.0, 0.0, 0.0))], settings(), SAMPLES) is None
    assert before == (state.frontier, state.clusters[0], len(state.factors), state.prior)


def test_no_cluster_that_spans_cannot_start_from_is_joined():
    assert not joinable(known_state(head_inertial=False))


def test_a_lidar_that_falls_silent_keeps_where_it_was():
    state = standing_state()
    before = state.scan_offsets['right', -30 * MS]
    join(state, [scan(100 * MS, 'left', 0)], settings(), SAMPLES)
    assert state.scan_offsets['right', -30 * MS].equals(before, 0.0)


def test_one_that_crept_is_matched_from_where_it_came_to():
    state = standing_state()
    join(state, [scan(100 * MS, 'left', 0)], settings(), SAMPLES)
    way = gtsam.Pose3(gtsam.Rot3(), np.array([0.04, 0.0, 0.0]))
    state.creep({'left': way, 'unknown': way})
    assert state.scan_offsets['left', 100 * MS].equals(way, 0.0)
    assert set(state.scan_offsets) == {('left', 100 * MS), ('right', -30 * MS)}
