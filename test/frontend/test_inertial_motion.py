"""Motion around a sweep by the IMU: as the truth has it, and only where samples cover it."""

import gtsam
import numpy as np
import pytest

from incremental_mapper.datasets.simulated.handheld import T_BASE_IMU, Walk
from incremental_mapper.frontend.imu_guide import HARDEST
from incremental_mapper.frontend.imu_preintegration import ImuSeries
from incremental_mapper.frontend.inertial_motion import make_strip
from incremental_mapper.geometry import pose_matrix

ARM = np.array(T_BASE_IMU[:3])
TURN = pose_matrix(T_BASE_IMU)[:3, :3]
START, STAMP = 5.0, 1_700_000_005_000_000_000
MOMENTS = (-0.07, 0.0, 0.05, 0.1)


@pytest.fixture(scope='module')
def walk():
    return Walk(3)


def series(walk, times):
    gyro, force = walk.true_samples(START + times)
    stamps = STAMP + np.rint(times * 1e9).astype(np.int64)
    return ImuSeries(stamps, gyro @ TURN.T, force @ TURN.T)


def pose(walk, seconds):
    position, rotation = walk.poses(np.array([START + seconds]))
    return gtsam.Pose3(gtsam.Rot3(rotation.as_matrix()[0]), position[0])


def known(walk, seconds):
    """Velocity of the IMU and gravity in base_link's axes."""
    h = 1e-4
    places = [pose(walk, seconds + shift).transformFrom(ARM) for shift in (-h, h)]
    rotation = pose(walk, seconds).rotation()
    velocity = (places[1] - places[0]) / (2.0 * h)
    return rotation.unrotate(velocity), rotation.unrotate(np.array([0.0, 0.0, -9.81]))


@pytest.mark.parametrize('moment', MOMENTS)
def test_motion_by_a_perfect_imu_beside_the_centre_is_the_true_one(walk, moment):
    strip = make_strip(series(walk, np.arange(-0.1, 0.12, 0.005)), STAMP, MOMENTS, ARM, 0.1)
    motion = strip.motion(moment, *known(walk, moment))
    for start, end in ((-0.07, 0.05), (0.0, 0.1), (0.05, 0.0)):
        apart = pose(walk, start).between(pose(walk, end)).between(motion.between(start, end))
        assert np.linalg.norm(apart.translation()) < 5e-4
        assert np.linalg.norm(gtsam.Rot3.Logmap(apart.rotation())) < 5e-4


def test_points_are_moved_each_by_the_motion_since_its_own_time(walk):
    strip = make_strip(series(walk, np.arange(-0.1, 0.12, 0.005)), STAMP, MOMENTS, ARM, 0.1)
    motion = strip.motion(0.05, *known(walk, 0.05))
    rng = np.random.default_rng(1)
    rows, times = rng.uniform(-10.0, 10.0, (3, 50)), rng.uniform(-0.07, 0.1, 50)
    for moment in (0.05, 0.0):
        there = pose(walk, moment)
        expected = [
            there.between(pose(walk, time)).transformFrom(point)
            for point, time in zip(rows.T, times, strict=True)
        ]
        assert motion.moved(rows, times, moment) == pytest.approx(np.array(expected).T, abs=6e-3)


def test_way_of_a_leap_is_what_velocity_and_gravity_leave(walk):
    strip = make_strip(series(walk, np.arange(-0.1, 0.12, 0.005)), STAMP, MOMENTS, ARM, 0.1)
    leap = strip.leap(0.0, 0.1)
    velocity, gravity = known(walk, 0.0)
    way = velocity * 0.1 + 0.5 * gravity * 0.01 + leap.position
    places = [pose(walk, moment).transformFrom(ARM) for moment in (0.0, 0.1)]
    expected = pose(walk, 0.0).rotation().unrotate(places[1] - places[0])
    assert way == pytest.approx(expected, abs=5e-4)
    now = leap.rotation.T @ (velocity + gravity * 0.1 + leap.velocity)
    assert now == pytest.approx(known(walk, 0.1)[0], abs=5e-3)


@pytest.mark.parametrize(
    'times',
    [
        np.append(np.arange(-0.1, -0.05, 0.005), np.arange(0.06, 0.12, 0.005)),
        np.arange(0.05, 0.12, 0.005),
        np.arange(-0.1, -0.02, 0.005),
        np.zeros(0),
    ],
    ids=['hole', 'late', 'ends', 'none'],
)
def test_samples_that_do_not_cover_the_sweep_tell_nothing(walk, times):
    assert make_strip(series(walk, times), STAMP, MOMENTS, ARM, 0.1) is None


@pytest.mark.parametrize(('samples', 'felt'), [(1, False), (8, True)], ids=['one', 'a_knock'])
def test_a_force_is_felt_that_lasts_and_not_that_of_a_single_sample(samples, felt):
    stamps = np.arange(0, 210_000_000, 10_000_000)
    forces = np.tile([0.0, 0.0, 9.81], (len(stamps), 1))
    forces[5 : 5 + samples, 0] = 100.0
    series = ImuSeries(stamps, np.zeros((len(stamps), 3)), forces)
    strip = make_strip(series, 0, (0.0, 0.2), np.zeros(3), 0.1)
    assert strip is not None and (strip.hardest() > HARDEST) == felt
