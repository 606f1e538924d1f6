"""An IMU that samples at 10 Hz or less reaches over its own gaps, and is believed less."""

import numpy as np
import pytest

from incremental_mapper.checks.finding import Severity
from incremental_mapper.checks.slow_imu import check_slow
from incremental_mapper.config import ImuSettings


def driven(hertz, seconds=10.0):
    """Stamps, rates and accelerations of a car that sways and swerves."""
    times = np.arange(0.0, seconds, 1.0 / hertz)
    gyro = np.column_stack([0.0 * times, 0.0 * times, 0.3 * np.sin(2.0 * times)])
    force = np.column_stack(
        [2.0 * np.sin(3.0 * times), 3.0 * np.cos(3.0 * times), np.full(len(times), 9.81)]
    )
    return (1e9 * times).astype(np.int64), gyro, force


@pytest.mark.parametrize('hertz', [5.0, 10.0])
def test_a_slow_imu_reaches_over_its_gaps_and_is_believed_less(hertz):
    found = check_slow(*driven(hertz), ImuSettings())
    assert found.rule == 'slow_imu' and found.severity is Severity.MENDED
    mended = found.settings['preintegration']
    assert 1.2 / hertz < mended['max_gap'] < 2.0 / hertz
    assert mended['accelerometer_noise'] > 2.0 * ImuSettings().accelerometer_noise
    assert mended['gyroscope_noise'] > ImuSettings().gyroscope_noise
    assert f'{hertz:g} Hz' in found.text


@pytest.mark.parametrize('hertz', [100.0, 400.0, 2.0])
def test_a_quick_one_is_sound_and_one_of_two_samples_a_second_of_no_use(hertz):
    assert check_slow(*driven(hertz, 60.0), ImuSettings()) is None


def test_few_samples_tell_nothing():
    assert check_slow(*driven(10.0, 2.0), ImuSettings()) is None


def test_what_a_user_has_set_stays():
    chosen = ImuSettings(max_gap=0.1, accelerometer_noise=0.02)
    assert set(check_slow(*driven(10.0), chosen).settings['preintegration']) == {'gyroscope_noise'}
    chosen = ImuSettings(max_gap=0.1, accelerometer_noise=0.02, gyroscope_noise=0.001)
    assert check_slow(*driven(10.0), chosen) is None
