"""Where the ground is by each LiDAR's clouds."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from incremental_mapper.checks.finding import Severity
from incremental_mapper.checks.ground import GroundLook, ground_findings

HEIGHT = 1.9
PLACE = np.array([0.0, 0.0, HEIGHT])


def street(seed=0, ground=1500, walls=900):
    """Points in base_link: a road, and house fronts 8 m to both sides."""
    random = np.random.default_rng(seed)
    flat = random.uniform(-18, 18, (ground, 3))
    flat[:, 1] *= 0.4
    flat[:, 2] = random.normal(0.0, 0.03, ground)
    fronts = random.uniform(-18, 18, (walls, 3))
    fronts[:, 1] = np.where(random.random(walls) < 0.5, 8.0, -8.0)
    fronts[:, 2] = random.uniform(0.0, 9.0, walls)
    return np.vstack([flat, fronts])


def look(sensor='left', turn=None, lift=0.0, clouds=5, **options):
    """What a LiDAR shows whose extrinsics are wrong by a turn about itself and by a lift."""
    rotation = Rotation.identity() if turn is None else Rotation.from_euler(*turn, degrees=True)
    place = PLACE
    shown = [
        rotation.apply(street(seed, **options) - place) + place + [0.0, 0.0, lift]
        for seed in range(clouds)
    ]
    return GroundLook(sensor, np.array([0.0, 0.0, HEIGHT + lift]), shown)


def test_sound_lidars_see_one_level_ground():
    assert ground_findings([look('left'), look('right', ground=900, walls=1000)]) == []


@pytest.mark.parametrize(
    ('turn', 'severity'),
    [(('x', 5), Severity.WARNING), (('y', -6), Severity.WARNING), (('x', 14), Severity.ERROR)],
)
def test_grounds_that_are_turned_against_each_other(turn, severity):
    (found,) = ground_findings([look('left', turn), look('right')])
    assert (found.rule, found.sensor, found.severity) == ('grounds_differ', 'left', severity)


@pytest.mark.parametrize('turn', [('x', 90), ('y', 45), ('x', -60)])
def test_a_lidar_without_ground_beside_one_that_has_it(turn):
    (found,) = ground_findings([look('left', turn), look('right')])
    assert (found.rule, found.sensor) == ('grounds_differ', 'left')
    assert 'right sees' in found.text


@pytest.mark.parametrize(
    ('lift', 'severity'), [(0.6, Severity.WARNING), (-2.0, Severity.ERROR), (2.0, Severity.ERROR)]
)
def test_one_that_is_too_high_or_too_low(lift, severity):
    (found,) = ground_findings([look('left', lift=lift), look('right')])
    assert (found.rule, found.severity) == ('grounds_differ', severity)


def test_upside_down():
    both = [look(name, ('x', 180)) for name in ('left', 'right')]
    found = ground_findings(both)
    assert {(item.rule, item.severity) for item in found} == {('upside_down', Severity.ERROR)}
    # One of two may look at the ceiling of a car park.
    (one,) = ground_findings([look('left', ('x', 180)), look('right')])
    assert (one.rule, one.sensor, one.severity) == ('upside_down', 'left', Severity.WARNING)


def test_under_a_ceiling_nothing_is_upside_down():
    random = np.random.default_rng(3)
    hall = random.uniform(-15, 15, (2000, 3))
    hall[:, 2] = np.where(random.random(2000) < 0.7, 3.0, 0.0)
    assert ground_findings([GroundLook('top', PLACE, [hall] * 5)]) == []


def test_a_tilted_single_lidar():
    (found,) = ground_findings([look('top', ('y', 12))])
    assert (found.rule, found.severity) == ('ground_tilted', Severity.WARNING)
    assert '12 degrees' in found.text


def test_walls_and_few_points_tell_nothing():
    alley = look('top', ground=100, walls=1500)
    assert ground_findings([alley]) == []
    assert ground_findings([look('top', ('x', 90), ground=40, walls=20)]) == []
    assert ground_findings([GroundLook('top', PLACE, [])]) == []
    assert ground_findings([GroundLook('top', PLACE, [np.zeros((0, 3))] * 5)]) == []


def test_rough_land_tells_nothing():
    random = np.random.default_rng(4)
    land = [random.normal(0.0, 4.0, (2000, 3)) for _ in range(5)]
    assert ground_findings([GroundLook('top', PLACE, land)]) == []
