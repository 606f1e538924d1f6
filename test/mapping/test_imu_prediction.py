"""The newest state carried on by the IMU: against the truth, and by how much it may be off."""

import gtsam
import numpy as np
import pytest
import turning_car as car
from turning_car import MS, SPEED, TURN, truth

from incremental_mapper.mapping.imu_prediction import ImuPrediction, Stopped
from incremental_mapper.mapping.newest_state import NewestState
from incremental_mapper.mapping.odometry_frame import OdometryPose
from incremental_mapper.measurements import ImuSample

STEP = 10 * MS
T_MAP_ODOM = gtsam.Pose3(gtsam.Rot3.Yaw(-2.0), np.array([100.0, 50.0, 0.5]))
POSE_SIGMAS = np.array([0.004] * 3 + [0.03] * 3)
VELOCITY_SIGMA = 0.05


def samples(first, last, R_base_imu=None, bias=None, noise=0.0, seed=0):
    """What an IMU in base_link measures on the bend, with its errors."""
    rng, made = np.random.default_rng(seed), []
    series = car.imu_series(first, last, STEP)
    turn = np.eye(3) if R_base_imu is None else R_base_imu.matrix()
    bias = np.zeros(6) if bias is None else bias
    for stamp, gyro, force in zip(series.stamps, series.gyro, series.acceleration, strict=True):
        force = force @ turn + bias[:3] + rng.normal(size=3) * noise * 0.02 / np.sqrt(0.01)
        gyro = gyro @ turn + bias[3:] + rng.normal(size=3) * noise * 0.001 / np.sqrt(0.01)
        # No two are the same to the bit, which would look frozen.
        force[2] += 1e-9 * (stamp // STEP)
        made.append(ImuSample(int(stamp), 'imu', gyro, force, None))
    return made


def state(stamp, off=None, bias_known=True):
    """The newest state of the map at a stamp, off by as much, and where it is in odom."""
    off = np.zeros(9) if off is None else off
    pose = truth(stamp).retract(off[:6])
    velocity = pose.rotation().rotate(SPEED + off[6:])
    bias = gtsam.imuBias.ConstantBias()
    covariance = np.diag(POSE_SIGMAS**2)
    newest = NewestState(
        stamp,
        pose,
        covariance,
        velocity,
        np.eye(3) * VELOCITY_SIGMA**2,
        bias=bias if bias_known else None,
    )
    return newest, OdometryPose(T_MAP_ODOM.between(pose), covariance, T_MAP_ODOM)


def prediction(**sections):
    return ImuPrediction(car.settings(**sections))


def fed(made, measurements):
    return [found for item in measurements if (found := made.take(item)) is not None]


@pytest.mark.parametrize('turned', [False, True])
def test_a_car_on_a_bend_is_where_it_is(turned):
    R_base_imu = gtsam.Rot3.RzRyRx(0.4, -0.3, 1.9) if turned else gtsam.Rot3()
    turn = R_base_imu.toQuaternion()
    place = [0, 0, 0, turn.x(), turn.y(), turn.z(), turn.w()]
    made = prediction(imu={'T_base_sensor': place})
    assert fed(made, samples(-200 * MS, 1, R_base_imu)) == []
    made.rebase(*state(0))
    found = fed(made, samples(STEP, 500 * MS, R_base_imu))
    assert [item.stamp for item in found] == list(range(STEP, 500 * MS, STEP))
    for item in found:
        exact = truth(item.stamp)
        assert item.pose.equals(T_MAP_ODOM.between(exact), 2e-3)
        assert T_MAP_ODOM.rotation().rotate(item.velocity) == pytest.approx(
            exact.rotation().rotate(SPEED), abs=2e-3
        )
        assert item.rate == pytest.approx(TURN, abs=1e-9)


def test_a_window_that_closes_late_is_caught_up_with_and_its_correction_is_measured():
    made = prediction()
    made.rebase(*state(0, off=np.array([0, 0, 0, 0, 0, 0, 0.4, 0, 0])))
    wrong = fed(made, samples(0, 300 * MS))[-1]
    expected = T_MAP_ODOM.between(truth(290 * MS))
    assert wrong.pose.translation() != pytest.approx(expected.translation(), abs=0.1)
    made.rebase(*state(100 * MS))
    assert made.correction == pytest.approx(0.4 * 0.29, abs=0.01)
    right = fed(made, samples(300 * MS, 320 * MS))[0]
    assert right.pose.equals(T_MAP_ODOM.between(truth(300 * MS)), 2e-3)


def test_errors_are_as_large_as_the_covariance_says():
    config = car.settings()
    gyro_sigma = config.graph.prior_sigma_gyroscope_bias
    force_sigma = config.graph.prior_sigma_accelerometer_bias
    scaled, speeds = [], []
    for seed in range(150):
        rng = np.random.default_rng(1000 + seed)
        off = rng.normal(size=9) * [*POSE_SIGMAS, *[VELOCITY_SIGMA] * 3]
        wrong = rng.normal(size=6) * [*[force_sigma] * 3, *[gyro_sigma] * 3]
        made = ImuPrediction(config)
        made.rebase(*state(0, off))
        last = fed(made, samples(0, 400 * MS, bias=wrong, noise=1.0, seed=seed))[-1]
        exact = T_MAP_ODOM.between(truth(last.stamp))
        error = exact.localCoordinates(last.pose)
        scaled.append(error @ np.linalg.solve(last.covariance, error))
        speed = last.pose.rotation().unrotate(last.velocity) - SPEED
        speeds.append(speed @ np.linalg.solve(last.velocity_covariance, speed))
    # Squares of normalised errors have the mean 6 and 3.
    assert 4.0 < np.mean(scaled) < 7.5
    assert 2.0 < np.mean(speeds) < 4.0


def test_the_covariance_grows_from_sample_to_sample():
    made = prediction()
    made.rebase(*state(0))
    found = fed(made, samples(0, 500 * MS))
    sizes = [np.trace(item.covariance[3:, 3:]) for item in found]
    assert sizes == sorted(sizes) and sizes[-1] > sizes[0]


def test_nothing_is_predicted_before_the_velocity_is_known():
    made = prediction()
    made.rebase(*state(0, bias_known=False))
    assert fed(made, samples(0, 200 * MS)) == [] and made.stopped is Stopped.NO_STATE


def test_a_window_that_is_too_old_ends_it_and_the_next_one_goes_on():
    made = prediction(imu_odometry={'max_age': 0.3})
    made.rebase(*state(0))
    found = fed(made, samples(0, 500 * MS))
    assert found[-1].stamp == 300 * MS and made.stopped is Stopped.TOO_OLD
    made.rebase(*state(400 * MS))
    assert fed(made, samples(500 * MS, 520 * MS)) and made.stopped is None


def test_a_hole_ends_it_until_a_window_lies_behind_it():
    made = prediction()
    made.rebase(*state(0))
    fed(made, samples(0, 100 * MS))
    assert fed(made, samples(300 * MS, 400 * MS)) == [] and made.stopped is Stopped.HOLE
    made.rebase(*state(50 * MS))
    assert made.stopped is Stopped.HOLE
    made.rebase(*state(320 * MS))
    found = fed(made, samples(400 * MS, 420 * MS))
    assert found[0].pose.equals(T_MAP_ODOM.between(truth(400 * MS)), 2e-3)


def test_unusable_samples_and_old_ones_are_left_alone():
    made = prediction()
    made.rebase(*state(0))
    good = samples(0, 60 * MS)
    absurd = ImuSample(65 * MS, 'imu', np.array([0.0, 0.0, 1000.0]), good[0].acceleration, None)
    assert len(fed(made, good)) == 5
    assert fed(made, [absurd, good[2], good[-1]]) == []
    found = fed(made, samples(60 * MS, 80 * MS))
    assert found[-1].pose.equals(T_MAP_ODOM.between(truth(70 * MS)), 2e-3)


@pytest.mark.parametrize(('rate', 'count'), [(1000.0, 99), (100.0, 99), (99.0, 99), (25.0, 25)])
def test_messages_are_no_more_than_wanted(rate, count):
    made = prediction(imu_odometry={'max_rate': rate, 'max_age': 2.0})
    made.rebase(*state(0))
    assert len(fed(made, samples(0, 1000 * MS))) == pytest.approx(count, abs=1)
