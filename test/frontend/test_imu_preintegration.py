"""Pre-integration over whole spans against closed forms, and levelling by gravity."""

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from incremental_mapper.config import ImuSettings
from incremental_mapper.frontend.imu_preintegration import (
    EMPTY_SERIES,
    SMOOTHED,
    ImuSeries,
    level_rotation,
    preintegrate,
    preintegration_parameters,
)
from incremental_mapper.measurements import make_imu

SECOND = 1_000_000_000
EPOCH = 1_544_676_777_123_456_789
GRAVITY = 9.81
NO_BIAS = gtsam.imuBias.ConstantBias()


def parameters(T_base_imu=None):
    pose = np.eye(4) if T_base_imu is None else T_base_imu
    return preintegration_parameters(ImuSettings(gravity=GRAVITY), pose)


def series(stamps, gyro=(0.0, 0.0, 0.0), acceleration=(0.0, 0.0, GRAVITY)):
    count = len(stamps)
    return ImuSeries(
        np.array(stamps, dtype=np.int64),
        np.tile(np.array(gyro, dtype=float), (count, 1)),
        np.tile(np.array(acceleration, dtype=float), (count, 1)),
    )


spans = st.integers(1, 2 * SECOND).flatmap(
    lambda length: st.tuples(
        st.just(length),
        st.lists(st.integers(0, length - 1), min_size=1, max_size=20, unique=True).map(sorted),
    )
)


@settings(deadline=None)
@given(spans)
def test_span_is_covered_from_the_first_to_the_last_nanosecond(span):
    length, inside = span
    samples = series([EPOCH + t for t in inside])
    result = preintegrate(samples, EPOCH, EPOCH + length, parameters(), NO_BIAS)
    assert result.deltaTij() == pytest.approx(length / SECOND, rel=1e-12, abs=1e-15)


@settings(deadline=None)
@given(spans, st.randoms(use_true_random=False))
def test_every_sample_counts_once_for_the_time_nearest_to_it(span, random):
    length, inside = span
    force = np.array([[random.uniform(-5, 5) for _ in range(3)] for _ in inside])
    samples = ImuSeries(np.array([EPOCH + t for t in inside]), np.zeros((len(inside), 3)), force)
    weights = []
    for i, t in enumerate(inside):
        low = 0 if i == 0 else (inside[i - 1] + t) / 2
        high = length if i == len(inside) - 1 else (t + inside[i + 1]) / 2
        weights.append((high - low) / SECOND)
    result = preintegrate(samples, EPOCH, EPOCH + length, parameters(), NO_BIAS)
    assert result.deltaVij() == pytest.approx(np.array(weights) @ force, rel=1e-9, abs=1e-9)


@settings(deadline=None)
@given(spans)
def test_samples_outside_the_span_do_not_count(span):
    length, inside = span
    stamps = [-5, *inside, length, length + 3]
    force = np.zeros((len(stamps), 3))
    force[[0, -2, -1]] = 1000.0
    samples = ImuSeries(np.array(stamps) + EPOCH, np.zeros((len(stamps), 3)), force)
    result = preintegrate(samples, EPOCH, EPOCH + length, parameters(), NO_BIAS)
    assert result.deltaVij().tolist() == [0.0, 0.0, 0.0]


@settings(deadline=None)
@given(spans, st.tuples(*[st.floats(-5, 5)] * 3), st.tuples(*[st.floats(-20, 20)] * 3))
def test_constant_acceleration_is_predicted_exactly_whatever_the_stamps(span, push, speed):
    length, inside = span
    samples = series([EPOCH + t for t in inside], acceleration=np.add(push, (0, 0, GRAVITY)))
    result = preintegrate(samples, EPOCH, EPOCH + length, parameters(), NO_BIAS)
    end = result.predict(gtsam.NavState(gtsam.Pose3(), np.array(speed)), NO_BIAS)
    time = length / SECOND
    expected = np.array(speed) * time + np.array(push) * time**2 / 2
    assert end.velocity() == pytest.approx(np.array(speed) + np.array(push) * time, abs=1e-9)
    assert end.position() == pytest.approx(expected, abs=1e-9)
    assert end.attitude().matrix() == pytest.approx(np.eye(3), abs=1e-12)


@settings(deadline=None)
@given(spans, st.floats(-1.5, 1.5))
def test_constant_turn_is_predicted_exactly_whatever_the_stamps(span, rate):
    length, inside = span
    samples = series([EPOCH + t for t in inside], gyro=(0, 0, rate))
    result = preintegrate(samples, EPOCH, EPOCH + length, parameters(), NO_BIAS)
    end = result.predict(gtsam.NavState(gtsam.Pose3(), np.zeros(3)), NO_BIAS)
    assert end.attitude().yaw() == pytest.approx(rate * length / SECOND, abs=1e-9)
    assert end.position() == pytest.approx(np.zeros(3), abs=1e-9)


def test_circle_at_constant_speed_is_predicted():
    speed, rate, time = 5.0, 0.4, 1.0
    stamps = EPOCH + np.arange(2_500_000, SECOND, 5_000_000)
    samples = series(stamps, gyro=(0, 0, rate), acceleration=(0, speed * rate, GRAVITY))
    result = preintegrate(samples, EPOCH, EPOCH + SECOND, parameters(), NO_BIAS)
    end = result.predict(gtsam.NavState(gtsam.Pose3(), np.array([speed, 0, 0])), NO_BIAS)
    turned = rate * time
    radius = speed / rate
    circle = [radius * np.sin(turned), radius * (1 - np.cos(turned)), 0]
    heading = [speed * np.cos(turned), speed * np.sin(turned), 0]
    # GTSAM turns each sample by the rotation at the start of its 5 ms, half a step too little.
    push_error = speed * rate * (rate * 0.005 / 2)
    assert end.velocity() == pytest.approx(heading, abs=push_error * time)
    assert end.position() == pytest.approx(circle, abs=push_error * time**2 / 2)
    assert end.attitude().yaw() == pytest.approx(turned, abs=1e-9)


def test_imu_off_the_turning_centre_feels_the_pull_towards_it_and_base_link_stays():
    # base_link turns on the spot; the IMU, one and a half metres ahead, is pulled back.
    rate, ahead = 0.8, 1.5
    T_base_imu = np.eye(4)
    T_base_imu[0, 3] = ahead
    stamps = EPOCH + np.arange(0, SECOND, 10_000_000)
    samples = series(stamps, gyro=(0, 0, rate), acceleration=(-(rate**2) * ahead, 0, GRAVITY))
    result = preintegrate(samples, EPOCH, EPOCH + SECOND, parameters(T_base_imu), NO_BIAS)
    end = result.predict(gtsam.NavState(gtsam.Pose3(), np.zeros(3)), NO_BIAS)
    assert end.attitude().yaw() == pytest.approx(rate, abs=1e-9)
    assert end.position() == pytest.approx(np.zeros(3), abs=1e-9)
    assert end.velocity() == pytest.approx(np.zeros(3), abs=1e-9)


def test_imu_mounted_upside_down_measures_the_same_motion():
    T_base_imu = np.diag([1.0, -1.0, -1.0, 1.0])
    turned = T_base_imu[:3, :3].T
    push = np.array([0.7, -0.3, GRAVITY])
    stamps = EPOCH + np.arange(0, SECOND, 10_000_000)
    gyro = np.array([0.0, 0.0, 0.3])
    upright = preintegrate(series(stamps, gyro, push), EPOCH, EPOCH + SECOND, parameters(), NO_BIAS)
    inverted = preintegrate(
        series(stamps, turned @ gyro, turned @ push),
        EPOCH,
        EPOCH + SECOND,
        parameters(T_base_imu),
        NO_BIAS,
    )
    start = gtsam.NavState(gtsam.Pose3(), np.zeros(3))
    assert inverted.predict(start, NO_BIAS).equals(upright.predict(start, NO_BIAS), 1e-9)


def test_known_bias_is_taken_off():
    bias = gtsam.imuBias.ConstantBias(np.array([0.1, -0.2, 0.3]), np.array([0.01, 0.02, -0.03]))
    stamps = EPOCH + np.arange(0, SECOND, 10_000_000)
    samples = series(stamps, bias.gyroscope(), bias.accelerometer() + np.array([0.0, 0.0, GRAVITY]))
    result = preintegrate(samples, EPOCH, EPOCH + SECOND, parameters(), bias)
    end = result.predict(gtsam.NavState(gtsam.Pose3(), np.zeros(3)), bias)
    assert end.equals(gtsam.NavState(gtsam.Pose3(), np.zeros(3)), 1e-9)


def test_longer_span_is_less_certain_by_the_configured_noise():
    quiet, loud = (
        preintegration_parameters(ImuSettings(gyroscope_noise=noise), np.eye(4))
        for noise in (0.001, 0.01)
    )
    stamps = EPOCH + np.arange(0, SECOND, 10_000_000)

    def yaw_sigma(params, length):
        span = preintegrate(series(stamps), EPOCH, EPOCH + length, params, NO_BIAS)
        return np.sqrt(span.preintMeasCov()[2, 2])

    # A random walk: density times the root of the time.
    assert yaw_sigma(quiet, SECOND) == pytest.approx(0.001, rel=0.02)
    assert yaw_sigma(quiet, SECOND // 4) == pytest.approx(0.0005, rel=0.02)
    assert yaw_sigma(loud, SECOND) == pytest.approx(0.01, rel=0.02)


def test_span_without_a_sample_cannot_be_integrated():
    with pytest.raises(ValueError, match='no IMU sample'):
        preintegrate(series([EPOCH + 10]), EPOCH, EPOCH + 10, parameters(), NO_BIAS)


def test_series_grows_at_its_end_and_shrinks_at_its_start():
    samples = [make_imu(EPOCH + t, 'imu', np.full(3, t), np.full(3, -t)) for t in (0, 10, 20, 30)]
    grown = EMPTY_SERIES.joined(samples[:2]).joined(samples[2:]).joined([])
    assert grown.stamps.tolist() == [s.stamp for s in samples]
    assert grown.gyro[:, 0].tolist() == [0, 10, 20, 30]
    assert grown.acceleration[:, 2].tolist() == [0, -10, -20, -30]
    assert grown.since(EPOCH + 10).stamps.tolist() == [EPOCH + t for t in (10, 20, 30)]
    assert grown.since(EPOCH + 11).gyro[:, 0].tolist() == [20, 30]
    assert len(grown.since(EPOCH + 31).stamps) == 0


angles = st.floats(-1.2, 1.2)


@given(angles, angles, st.floats(-3.1, 3.1))
def test_levelled_rotation_turns_the_force_upwards_and_has_the_yaw(roll, pitch, yaw):
    truth = gtsam.Rot3.Ypr(yaw, pitch, roll)
    force = truth.unrotate(np.array([0.0, 0.0, GRAVITY]))
    assert level_rotation(force, yaw).matrix() == pytest.approx(truth.matrix(), abs=1e-9)


@pytest.mark.parametrize('force', [np.zeros(3), np.full(3, np.nan), np.array([0.1, 0.0, 0.0])])
def test_without_gravity_the_rotation_is_level_already(force):
    expected = gtsam.Rot3.Yaw(0.7).matrix()
    assert level_rotation(force, 0.7).matrix() == pytest.approx(expected, abs=1e-12)


def test_nearest_sample_is_the_one_whose_stamp_differs_least():
    samples = [
        make_imu(stamp, 'imu', np.full(3, float(stamp)), np.zeros(3)) for stamp in (100, 200, 400)
    ]
    series = EMPTY_SERIES.joined(samples)
    for stamp, nearest in ((0, 100), (149, 100), (151, 200), (299, 200), (301, 400), (900, 400)):
        found = series.nearest(stamp)
        assert found.stamps.tolist() == [nearest]
        assert found.gyro.tolist() == [[float(nearest)] * 3]
    assert len(EMPTY_SERIES.nearest(5).stamps) == 0


def test_noise_of_the_imu_is_what_the_settings_say():
    chosen = ImuSettings(
        accelerometer_noise=0.2,
        gyroscope_noise=0.03,
        accelerometer_bias_walk=0.004,
        gyroscope_bias_walk=0.0005,
        integration_sigma=0.06,
        gravity=9.7,
    )
    mounted = np.eye(4)
    mounted[:3, 3] = 1.0, 2.0, 3.0
    found = preintegration_parameters(chosen, mounted)
    for covariance, sigma in (
        (found.getAccelerometerCovariance(), 0.2),
        (found.getGyroscopeCovariance(), 0.03),
        (found.getBiasAccCovariance(), 0.004),
        (found.getBiasOmegaCovariance(), 0.0005),
        (found.getIntegrationCovariance(), 0.06),
    ):
        assert covariance == pytest.approx(np.eye(3) * sigma**2, rel=1e-12)
    assert found.getBodyPSensor().matrix() == pytest.approx(mounted)


def sinking_back(stamps, arm, noise=0.0):
    """What an IMU above a car measures that sinks back by 12 mrad within a second, level before.

    Its centre, base_link, stands still; gravity is as it is felt while it turns.
    """
    t = np.clip((np.asarray(stamps) - EPOCH) / SECOND, 0.0, 1.0)
    sag = 0.012
    angle = -sag * (3 * t**2 - 2 * t**3)
    rate, change = -sag * (6 * t - 6 * t**2), -sag * (6 - 12 * t)
    zero = np.zeros(len(t))
    gyro = np.column_stack([zero, rate, zero])
    gyro += noise * np.random.default_rng(5).normal(size=gyro.shape)
    swing = np.cross(np.column_stack([zero, change, zero]), arm)
    force = np.column_stack([-GRAVITY * np.sin(angle), zero, GRAVITY * np.cos(angle)]) + swing
    return ImuSeries(np.asarray(stamps, dtype=np.int64), gyro, force)


@pytest.mark.parametrize('noise', [0.0, 0.005])
def test_an_imu_on_the_roof_of_a_car_that_sinks_back_says_that_the_car_stands(noise):
    """It comes 20 mm back itself. Samples reach the series window by window, 0.1 s at a time."""
    arm = np.array([0.0, 0.0, 1.7])
    pose = np.eye(4)
    pose[:3, 3] = arm
    stamps = EPOCH + np.arange(5_000_000, SECOND, 10_000_000)
    whole = sinking_back(stamps, arm, noise)
    known, state = EMPTY_SERIES, gtsam.NavState(gtsam.Pose3(), np.zeros(3))
    for start in range(EPOCH, EPOCH + SECOND, SECOND // 10):
        part = whole.within(start, start + SECOND // 10)
        rows = zip(part.stamps, part.gyro, part.acceleration, strict=True)
        known = known.since(start - SMOOTHED).joined(
            [make_imu(row[0], 'imu', *row[1:]) for row in rows]
        )
        span = preintegrate(known, start, start + SECOND // 10, parameters(pose), NO_BIAS)
        state = span.predict(state, NO_BIAS)
    assert np.linalg.norm(state.velocity()) < (0.004 if noise == 0.0 else 0.01)
    assert np.linalg.norm(state.position()) < (0.003 if noise == 0.0 else 0.01)


def test_the_change_of_a_turn_is_not_told_across_holes_nor_by_a_sample_alone():
    hole = series([EPOCH, EPOCH + SECOND], gyro=(0.0, 0.0, 0.0))
    hole.gyro[1] = 3.0
    assert not hole.changes.any()
    assert not series([EPOCH]).changes.any()
    assert EMPTY_SERIES.changes.shape == (0, 3)


def test_a_series_goes_on_behind_a_hole_with_a_single_sample():
    known = EMPTY_SERIES.joined([make_imu(EPOCH, 'imu', np.ones(3), np.ones(3))])
    behind = known.since(EPOCH + 1)
    for number in (1, 2, 3):
        sample = make_imu(EPOCH + number * SECOND, 'imu', np.ones(3), np.ones(3))
        behind = behind.joined([sample])
        assert behind.changes.shape == behind.gyro.shape == (number, 3)


@pytest.mark.parametrize('felt', [(15.0, 0.0, 0.0), (0.0, -20.0, 0.0), (0.0, 0.0, 12.0)])
def test_a_knock_may_have_changed_no_velocity_at_all(felt):
    stamps = [EPOCH + t * SECOND // 100 for t in range(10)]
    knock = series(stamps, acceleration=np.add(felt, (0.0, 0.0, GRAVITY)))
    span = preintegrate(knock, EPOCH, EPOCH + SECOND // 10, parameters(), NO_BIAS)
    velocity = np.sqrt(np.diag(span.preintMeasCov())[6:9])
    impulse = 0.1 * float(np.linalg.norm(felt))
    assert (velocity > 0.9 * impulse).all()


def test_what_a_car_feels_is_believed_as_the_settings_say():
    stamps = [EPOCH + t * SECOND // 100 for t in range(10)]
    hard_turn = series(stamps, acceleration=(3.0, 6.0, GRAVITY))
    span = preintegrate(hard_turn, EPOCH, EPOCH + SECOND // 10, parameters(), NO_BIAS)
    calm = preintegrate(series(stamps), EPOCH, EPOCH + SECOND // 10, parameters(), NO_BIAS)
    np.testing.assert_allclose(
        np.diag(span.preintMeasCov())[6:9], np.diag(calm.preintMeasCov())[6:9], rtol=0.01
    )
