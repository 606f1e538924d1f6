"""The unit of accelerations, and gravity in them."""

import numpy as np
import pytest
from imu_rig import GRAVITY, samples
from scipy.spatial.transform import Rotation

from incremental_mapper.checks.finding import Severity
from incremental_mapper.checks.imu_gravity import check_gravity, measure_gravity
from incremental_mapper.config import Imu


def check(seconds, change=lambda force: force, settings=None, gravity=GRAVITY):
    stamps, _, force = samples(seconds)
    found = measure_gravity(stamps, change(force))
    return check_gravity(found, Imu() if settings is None else settings, gravity)


@pytest.mark.parametrize('seconds', [0.6, 3.0, 20.0])
def test_nothing_is_said_of_a_good_imu(seconds):
    assert check(seconds) is None


@pytest.mark.parametrize(
    ('factor', 'rule', 'scale'),
    [
        (1 / 9.80665, 'imu_in_g', 9.80665),
        (1000 / 9.80665, 'imu_in_g', 0.00980665),
        (100.0, 'imu_acceleration_unit', 0.01),
        (-1 / 9.80665, 'imu_in_g', 9.80665),
    ],
)
def test_a_unit_is_known_after_half_a_second(factor, rule, scale):
    found = check(0.6, lambda force: factor * force)
    assert (found.rule, found.severity) == (rule, Severity.MENDED)
    assert found.settings['imu']['acceleration_scale'] == pytest.approx(scale)
    mended = Imu(acceleration_scale=scale)
    assert check(0.6, lambda force: scale * factor * force, mended) is None


def test_raw_counts_are_scaled_by_gravity():
    found = check(3.0, lambda force: 4096 / GRAVITY * force)
    assert (found.rule, found.severity) == ('imu_acceleration_scale', Severity.MENDED)
    assert found.settings['imu']['acceleration_scale'] == pytest.approx(GRAVITY / 4096, rel=0.03)


def test_accelerations_without_gravity_are_used_without_it():
    def without(force):
        return force - (0.0, 0.0, GRAVITY)

    found = check(3.0, without)
    assert (found.rule, found.severity) == ('imu_without_gravity', Severity.MENDED)
    less = {'gravity': 0.0, 'accelerometer_noise': 0.1}
    assert found.settings == {'preintegration': less}
    assert check(3.0, without, gravity=0.0) is None
    assert check(1.0, without) is None  # half a second of it may be anything


def test_a_car_that_speeds_up_without_gravity_is_not_in_g():
    def steady(force):
        return 0.1 * (force - (0.0, 0.0, GRAVITY)) + (1.0, 0.0, 0.0)

    assert check(1.0, steady) is None


def test_g_on_any_axis_is_known_once_it_is_steady():
    def turned(force):
        return force / GRAVITY @ Rotation.from_euler('y', 90, degrees=True).as_matrix()

    assert check(1.0, turned) is None
    assert check(6.0, turned).rule == 'imu_in_g'


def test_a_scale_that_is_somewhat_off_is_told_but_not_used():
    assert check(3.0, lambda force: 1.15 * force) is None
    found = check(6.0, lambda force: 1.15 * force)
    assert found.rule == 'imu_acceleration_scale'
    assert found.settings['imu']['acceleration_scale'] == pytest.approx(1 / 1.15, rel=0.05)


def on_a_mast(factor=1.0, rate=1.0):
    """A boat that rolls by 15 degrees once a second, with an IMU 1.7 m above its axis."""
    t = np.arange(2000) / 100.0
    roll, sway = np.radians(15.0) * np.sin(2 * np.pi * t), 2 * np.pi
    rates = np.stack([np.radians(15.0) * sway * np.cos(sway * t), 0.0 * t, 0.0 * t], axis=1)
    aside, inwards = 1.7 * sway**2 * roll, -1.7 * rates[:, 0] ** 2
    up = GRAVITY * np.stack([0.0 * t, np.sin(roll), np.cos(roll)], axis=1)
    force = factor * (up + np.stack([0.0 * t, aside, inwards], axis=1))
    found = measure_gravity(np.rint(t * 1e9).astype(np.int64), force, rate * rates)
    return check_gravity(found, Imu(), GRAVITY)


def test_a_mast_that_sways_is_no_unit():
    assert on_a_mast() is None
    # A unit that is wrong is told all the same, and nothing is excused by rates that are wrong.
    assert on_a_mast(1.5).rule == 'imu_acceleration_scale'
    assert on_a_mast(rate=10.0).rule == 'imu_acceleration_scale'


def test_hardly_any_samples_say_nothing():
    assert measure_gravity(np.arange(3), np.ones((3, 3))) is None


def test_a_quarter_of_absurd_samples_says_nothing_of_the_unit():
    stamps, _, force = samples(6.0)
    rng = np.random.default_rng(0)
    absurd = rng.random(len(stamps)) < 0.25
    force[absurd] = rng.choice([500.0, 1e4, 1e5], (int(absurd.sum()), 3))
    for count in (60, 250, 600):
        found = measure_gravity(stamps[:count], force[:count])
        assert found is not None
        assert check_gravity(found, Imu(), GRAVITY) is None
