"""Whether an IMU is as quiet as the settings say."""

import numpy as np
import pytest

from incremental_mapper.checks.finding import Severity
from incremental_mapper.checks.imu_noise import check_noise, noise_density
from incremental_mapper.config import ImuSettings

S = 1_000_000_000


def samples(rate=100.0, force_noise=0.0, gyro_noise=0.0, seconds=5.0):
    """An IMU on a car that turns and brakes; noises are densities."""
    random = np.random.default_rng(1)
    times = np.arange(int(rate * seconds)) / rate
    waves = np.stack([np.sin(times), np.cos(2.0 * times), np.sin(3.0 * times)], axis=1)
    white = random.normal(size=(2, len(times), 3)) * np.sqrt(rate)
    force = 3.0 * waves + [0.0, 0.0, 9.81] + force_noise * white[0]
    return (times * S).astype(np.int64), 0.4 * waves + gyro_noise * white[1], force


@pytest.mark.parametrize('rate', [60.0, 100.0, 400.0])
@pytest.mark.parametrize('density', [0.02, 0.3])
def test_the_density_is_found_whatever_the_rate_and_the_motion(rate, density):
    stamps, _, force = samples(rate, density)
    assert noise_density(stamps, force) == pytest.approx(density, rel=0.15)


def test_single_absurd_samples_do_not_matter():
    stamps, _, force = samples(force_noise=0.02)
    force[::20] += 1e4
    assert noise_density(stamps, force) < 0.03


def test_a_quiet_imu_is_as_the_settings_say():
    assert check_noise(*samples(force_noise=0.02, gyro_noise=0.001), ImuSettings()) is None
    assert check_noise(*samples(), ImuSettings()) is None


def test_a_loud_one_is_believed_less():
    found = check_noise(*samples(force_noise=0.3, gyro_noise=0.001), ImuSettings())
    assert (found.rule, found.severity) == ('imu_noise', Severity.MENDED)
    set_to = found.settings['preintegration']
    assert set_to == {'accelerometer_noise': pytest.approx(0.3, rel=0.15)}
    assert check_noise(*samples(force_noise=0.3), ImuSettings(**set_to)) is None


def test_what_a_user_has_set_is_not_changed():
    settings = ImuSettings(accelerometer_noise=0.02)
    found = check_noise(*samples(force_noise=0.3), settings)
    assert found.severity is Severity.WARNING and not found.changes
    assert 'accelerometer_noise: 0.' in found.remedy


def test_motion_of_a_slow_imu_is_no_noise():
    assert check_noise(*samples(rate=10.0, force_noise=3.0, seconds=60.0), ImuSettings()) is None


def test_samples_in_steps_lack_what_is_between_them():
    stamps, gyro, force = samples(force_noise=0.02, gyro_noise=0.001)
    found = check_noise(stamps, gyro, np.round(force / 0.98) * 0.98, ImuSettings())
    assert found is not None and found.severity is Severity.MENDED and 'steps' in found.text
    density = found.settings['preintegration']['accelerometer_noise']
    assert density == pytest.approx(0.98 * np.sqrt(0.25 / 12.0), rel=0.05)


def test_the_steps_of_a_good_converter_are_no_matter():
    stamps, gyro, force = samples(force_noise=0.02, gyro_noise=0.001)
    counts = np.round(force / 0.0024) * 0.0024, np.round(gyro / 0.001) * 0.001
    assert check_noise(stamps, counts[1], counts[0], ImuSettings()) is None
