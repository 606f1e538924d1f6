"""Samples as they are used: scaled, and without what no IMU measures."""

import numpy as np
import pytest

from incremental_mapper.config import Imu
from incremental_mapper.mapping.imu_intake import ImuIntake
from incremental_mapper.measurements import ImuSample

MS = 1_000_000


def sample(stamp, gyro=(0.01, 0.0, 0.2), force=(0.1, 0.0, 9.8)):
    return ImuSample(stamp, 'imu', np.array(gyro), np.array(force))


def test_a_good_sample_is_used_as_it_is():
    one = sample(1)
    assert ImuIntake(Imu(), 9.81).take(one) is one


def test_scales_are_applied():
    taken = ImuIntake(Imu(acceleration_scale=-9.8, rate_scale=0.5), 9.81).take(sample(1))
    np.testing.assert_allclose(taken.acceleration, [-0.98, 0.0, -96.04])
    np.testing.assert_allclose(taken.gyro, [0.005, 0.0, 0.1])


@pytest.mark.parametrize('absurd', [{'gyro': (0, 1e300, 0)}, {'force': (1e5, 0, 0)}])
def test_what_no_imu_measures_is_counted(absurd):
    intake = ImuIntake(Imu(), 9.81)
    assert intake.take(sample(1, **absurd)) is None
    assert intake.take(sample(2)) is not None
    assert intake.drops == {('imu', 'implausible'): 1}


def test_bounds_are_those_of_scaled_numbers():
    raw = sample(1, gyro=(0, 0, 100.0), force=(0, 0, 16384.0))
    assert ImuIntake(Imu(), 9.81).take(raw) is None
    scaled = Imu(acceleration_scale=9.81 / 16384, rate_scale=0.0175)
    assert ImuIntake(scaled, 9.81).take(raw) is not None


def test_a_sample_that_is_repeated_for_long_is_frozen():
    intake = ImuIntake(Imu(), 9.81)
    taken = [intake.take(sample(k * 10 * MS)) for k in range(100)]
    assert sum(one is not None for one in taken) == 51
    assert intake.drops == {('imu', 'frozen'): 49}
    assert intake.take(sample(2000 * MS, gyro=(0.02, 0.0, 0.2))) is not None


def test_rest_without_noise_is_not_frozen_but_zeros_are():
    rest = ImuIntake(Imu(), 9.81)
    for k in range(200):
        assert rest.take(sample(k * 10 * MS, (0, 0, 0), (0, 0, 9.81))) is not None
    dead = ImuIntake(Imu(), 9.81)
    assert dead.take(sample(0, (0, 0, 0), (0, 0, 0))) is not None
    assert dead.take(sample(600 * MS, (0, 0, 0), (0, 0, 0))) is None


def test_switched_off_nothing_is_used():
    intake = ImuIntake(Imu(enabled=False), 9.81)
    assert intake.take(sample(1)) is None
    assert intake.drops == {('imu', 'switched_off'): 1}
