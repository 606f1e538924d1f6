"""IMUs that clip or have a stuck axis, and sound ones that only look so."""

import numpy as np
import pytest

from incremental_mapper.checks.finding import Severity
from incremental_mapper.checks.imu_range import check_range
from incremental_mapper.config import Imu

COUNT = 1000
STAMPS = np.arange(COUNT, dtype=np.int64) * 10**7
RNG = np.random.default_rng(3)


def drive(**changes):
    """Rates and accelerations (N, 3) of bends, each a sine with noise; axes may be replaced."""
    swing = np.sin(np.arange(COUNT) / 60.0)[:, None]
    gyro = swing * (0.05, 0.05, 0.4) + RNG.normal(0, 0.003, (COUNT, 3))
    force = swing * (1.0, 2.0, 0.1) + (0.0, 0.0, 9.81) + RNG.normal(0, 0.05, (COUNT, 3))
    for name, value in changes.items():
        (gyro if name[0] == 'g' else force)[:, 'xyz'.index(name[1])] = value
    return gyro, force


def look(gyro, force, gravity=9.81, **settings):
    return check_range(STAMPS[: len(gyro)], gyro, force, Imu(**settings), gravity)


def test_a_sound_imu():
    assert look(*drive()) is None


def test_a_gyroscope_that_clips_in_bends():
    gyro, force = drive()
    found = look(np.clip(gyro, -0.25, 0.25), force)
    assert found.rule == 'imu_rate_clipped' and found.in_force
    assert 'axis z stand at' in found.text and '0.25 rad/s' in found.text
    limit = found.settings['imu']['max_rate']
    assert 0.24 < limit < 0.25
    assert look(np.clip(gyro, -0.25, 0.25), force, max_rate=limit) is None, 'it is told once'


def test_an_accelerometer_that_clips():
    gyro, force = drive()
    found = look(gyro, np.clip(force, -9.82, 9.82))
    assert found.rule == 'imu_acceleration_clipped' and 'axis z' in found.text


def test_values_in_few_steps_are_no_end_of_a_range():
    """A gyroscope at rest that tells 0, 1 and 2 units has its largest value again and again."""
    gyro, force = drive()
    assert look(np.round(gyro / 0.1) * 0.1, force) is None


def test_a_knock_is_no_end_of_a_range():
    gyro, force = drive()
    gyro[400:420, 2] = 20.0
    assert look(gyro, force) is None


@pytest.mark.parametrize('axis, what', [('fx', 'acceleration 3'), ('gy', 'angular rate 0.2')])
def test_an_axis_that_is_stuck_switches_the_imu_off(axis, what):
    found = look(*drive(**{axis: float(what.split()[-1])}))
    assert found.rule == 'imu_axis_stuck' and what in found.text
    assert found.severity is Severity.WARNING and found.in_force
    assert found.settings == {'imu': {'enabled': False}}


def test_a_simulator_of_a_plane_has_no_stuck_axis():
    """It says 0 of roll and pitch, and gravity upwards, bit for bit."""
    assert look(*drive(gx=0.0, gy=0.0, fz=9.81)) is None
    assert look(*drive(gx=0.0, gy=0.0, fz=0.0), gravity=0.0) is None


def test_too_few_samples_tell_nothing():
    gyro, force = drive(fx=3.0)
    assert look(gyro[:150], force[:150]) is None
