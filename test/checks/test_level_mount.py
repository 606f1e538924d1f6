"""How a LiDAR is turned by the ground and by the way."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from incremental_mapper.checks.ground import GroundLook, see_ground
from incremental_mapper.checks.level_mount import level_mount

RNG = np.random.default_rng(2)
TILT = Rotation.from_euler('zyx', [110, 15, 42], degrees=True)
"""From the LiDAR to the car."""


def street(height=1.8):
    """Ground and two walls around a LiDAR, in the axes of the car."""
    ground = np.column_stack([RNG.uniform(-15, 15, (1500, 2)), np.full(1500, -height)])
    walls = [
        np.column_stack([RNG.uniform(-15, 15, 400), np.full(400, y), RNG.uniform(-height, 6, 400)])
        for y in (-8.0, 9.0)
    ]
    return np.vstack([ground, *walls]) + RNG.normal(scale=0.01, size=(2300, 3))


def look(mount, height=1.8):
    clouds = [mount.inv().apply(street(height)).astype(np.float32) for _ in range(4)]
    return see_ground(GroundLook('front', np.zeros(3), clouds))


def moves(mount, way=(1.0, 0.0, 0.0), count=20):
    return mount.inv().apply(np.tile(way, (count, 1)) + RNG.normal(scale=0.02, size=(count, 3)))


@pytest.mark.parametrize('degrees', [(110, 15, 42), (0, 30, 0), (0, 0, 90), (45, -60, 10)])
def test_the_turn_is_found(degrees):
    mount = Rotation.from_euler('zyx', degrees, degrees=True)
    found = level_mount(look(mount), moves(mount), None, True)
    assert found is not None and found.rule == 'tilted_mount' and found.changes
    numbers = found.settings['lidars']['front']['T_base_sensor']
    off = Rotation.from_quat(numbers[3:]) * mount.inv()
    assert np.degrees(off.magnitude()) < 2.0
    assert 'imu' not in found.settings


def test_an_imu_in_the_same_housing_is_turned_with_it():
    gravity = TILT.inv().apply([0.0, 0.0, 9.8])
    found = level_mount(look(TILT), moves(TILT), gravity, True)
    assert found.settings['imu'] == found.settings['lidars']['front']
    for force, unplaced in ((np.array([0.0, 0.0, 9.8]), True), (gravity, False)):
        assert 'imu' not in level_mount(look(TILT), moves(TILT), force, unplaced).settings


def test_nothing_is_said_of_a_level_lidar():
    yaw = Rotation.from_euler('z', 90, degrees=True)
    assert level_mount(look(yaw), moves(yaw), None, True) is None


def test_nothing_is_said_where_the_way_contradicts_the_ground():
    # What looks like ground is a wall, or the car stands, or turns on the spot.
    assert level_mount(look(TILT), moves(TILT, (1.0, 0.0, 0.3)), None, True) is None
    assert level_mount(look(TILT), moves(TILT, count=3), None, True) is None
    there = moves(TILT)
    assert level_mount(look(TILT), np.vstack([there, -there]), None, True) is None
    assert level_mount(look(TILT, height=9.0), moves(TILT), None, True) is None
