"""The continuous frame: what moves the map does not move the car in it."""

from dataclasses import replace

import gtsam
import numpy as np
import pymap3d
import pytest
import turning_car as car
from test_georeferencing import EPOCH, SECOND, SPEED, drive, truth

from incremental_mapper.config import OdometrySettings
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.mapping.newest_state import NewestState
from incremental_mapper.mapping.odometry_frame import OdometryFrame
from incremental_mapper.measurements import GnssFix
from incremental_mapper.settings import make_config

HEADING = 0.8


def driven(shift, from_fix=3):
    """T_map_base and the odometry of every window, where every other fix is shifted (m)."""
    config = make_config(
        {
            'selection': {'strategy': 'min_time_shift'},
            'lidars': {'names': ['left']},
            'gnss': {'T_base_sensor': [-0.3, 0.4, 1.2, 0, 0, 0, 1]},
            'graph': {'lag': 0.5},
        }
    )
    mapper, frame, found, fixes = (
        Mapper(config, ['left', 'gps', 'imu']),
        OdometryFrame(config.odometry),
        [],
        0,
    )
    for item in drive(HEADING, seconds=4.0):
        if isinstance(item, GnssFix):
            fixes += 1
            if fixes > from_fix and fixes % 2 == 0:
                place = (item.latitude, item.longitude, item.altitude)
                latitude, longitude, altitude = map(float, pymap3d.enu2geodetic(*shift, *place))
                item = replace(item, latitude=latitude, longitude=longitude, altitude=altitude)
        for window in mapper.push(item):
            if window.clusters:
                newest = mapper.newest()
                found.append((newest, frame.follow(mapper.state, newest)))
    assert mapper.state.georeferenced
    return found


def step_errors(stamps, poses):
    """By how far each step is off the truth, metres."""
    exact = [truth((stamp - EPOCH) / SECOND, HEADING) for stamp in stamps]
    return np.array(
        [
            np.linalg.norm(a.between(b).between(c.between(d)).translation())
            for a, b, c, d in zip(exact, exact[1:], poses, poses[1:], strict=False)
        ]
    )


def test_neither_the_turn_into_enu_nor_fixes_that_jump_move_the_car_in_odom():
    found = driven(shift=(0.0, 0.0, 0.0)), driven(shift=(0.7, 0.7, 0.3))
    for run in found:
        stamps = [newest.stamp for newest, _ in run]
        assert step_errors(stamps, [odometry.pose for _, odometry in run]).max() < 0.08
        # The map turns by 0.8 rad where it becomes ENU, some way from its origin.
        assert step_errors(stamps, [newest.pose for newest, _ in run]).max() > 0.5
        for newest, odometry in run:
            assert odometry.T_map_odom.compose(odometry.pose).equals(newest.pose, 1e-9)
    assert SPEED * 0.1 > 0.3  # a step is longer than what it may be off


def placed(state, stamp, pose):
    return NewestState(stamp, pose, None, np.zeros(3))


def test_covariance_is_what_samples_of_the_added_steps_have():
    settings = OdometrySettings(sigma_translation=0.05, sigma_rotation=0.01)
    frame, state = OdometryFrame(settings), car.known_state()
    first = frame.follow(state, placed(state, 0, state.pose(state.frontier.newest)))
    assert not first.covariance.any()
    step = gtsam.Pose3(gtsam.Rot3.Yaw(0.3), np.array([2.0, 0.0, 0.0]))
    newest = state.pose(state.frontier.newest).compose(step)
    # The state stays as it is, so every step is the same one.
    for number in range(1, 6):
        found = frame.follow(state, placed(state, number * SECOND // 10, newest))
    rng = np.random.default_rng(3)
    sigmas = np.array([0.01] * 3 + [0.05] * 3)
    ends = []
    for _ in range(20_000):
        end = gtsam.Pose3()
        for _ in range(5):
            end = end.compose(step.retract(rng.normal(size=6) * sigmas))
        ends.append(end)
    exact = gtsam.Pose3()
    for _ in range(5):
        exact = exact.compose(step)
    measured = np.cov(np.array([exact.localCoordinates(end) for end in ends]).T)
    assert np.abs(measured - found.covariance).max() < 0.04 * np.abs(measured).max()


def test_a_step_over_a_hole_is_as_uncertain_as_it_is_long():
    frame, state = OdometryFrame(OdometrySettings()), car.known_state()
    pose = state.pose(state.frontier.newest)
    frame.follow(state, placed(state, 0, pose))
    found = frame.follow(state, placed(state, 10 * SECOND, pose))
    assert np.sqrt(found.covariance[5, 5]) == pytest.approx(100 * 0.03)
