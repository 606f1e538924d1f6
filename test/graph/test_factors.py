"""Factors and the plain numbers that they are read back as."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from turning_car import MS, START, imu_series
from turning_car import settings as car_settings

from incremental_mapper.frontend.imu_preintegration import preintegrate, preintegration_parameters
from incremental_mapper.graph.factors import (
    Factor,
    FactorKind,
    beside_gtsam,
    between_factor,
    bias_prior,
    bias_random_walk,
    closure_factor,
    constant_velocity_prior,
    describer,
    gnss_factor,
    imu_factor,
    pose_numbers,
    pose_prior,
    pose_sigmas,
    velocity_prior,
)
from incremental_mapper.variables import bias_key, pose_key, velocity_key

POSE = gtsam.Pose3(gtsam.Rot3.Ypr(0.3, -0.2, 0.1), np.array([1.0, 2.0, 3.0]))
ARM = np.array([0.5, 0.2, 1.0])


def at(**values):
    found = gtsam.Values()
    for name, value in values.items():
        key = {'x': pose_key, 'v': velocity_key, 'b': bias_key}[name[0]](int(name[1:]))
        found.insert(key, value)
    return found


def squared(factor, values):
    return 2.0 * factor.factor.error(values)


def test_pose_is_position_and_quaternion():
    numbers = pose_numbers(POSE)
    assert numbers[:3] == [1.0, 2.0, 3.0]
    back = gtsam.Rot3.Quaternion(numbers[6], *numbers[3:6])
    assert back.equals(POSE.rotation(), 1e-12)
    assert all(type(number) is float for number in numbers)


def test_sigmas_of_a_pose_are_rotation_first():
    assert pose_sigmas(0.5, 0.1).tolist() == [0.1] * 3 + [0.5] * 3
    held = pose_prior(pose_key(1), gtsam.Pose3(), pose_sigmas(0.5, 0.1), 7)
    east = gtsam.Pose3(gtsam.Rot3(), np.array([1.0, 0.0, 0.0]))
    assert squared(held, at(x1=east)) == pytest.approx((1.0 / 0.5) ** 2)
    assert squared(held, at(x1=gtsam.Pose3(gtsam.Rot3.Yaw(0.2), np.zeros(3)))) == pytest.approx(4.0)
    assert (held.kind, held.keys, held.stamps) == (FactorKind.PRIOR_POSE, (pose_key(1),), (7,))
    assert held.data == {'T_map_base': pose_numbers(gtsam.Pose3()), 'sigmas': [0.1] * 3 + [0.5] * 3}


def test_relative_pose_is_of_the_second_in_the_first():
    keys = pose_key(1), pose_key(2)
    noise = np.diag(pose_sigmas(0.5, 0.1) ** 2)
    made = between_factor(FactorKind.BRIDGE, keys, POSE, noise, None, (3, 4))
    assert squared(made, at(x1=START, x2=START.compose(POSE))) == pytest.approx(0.0, abs=1e-12)
    assert squared(made, at(x1=START, x2=POSE.compose(START))) > 1.0
    assert (made.kind, made.keys, made.sensor, made.stamps) == (
        FactorKind.BRIDGE,
        keys,
        None,
        (3, 4),
    )
    assert made.data['T_first_second'] == pytest.approx(pose_numbers(POSE))
    assert made.data['sigmas'] == pytest.approx([0.1] * 3 + [0.5] * 3)
    assert 'covariance' not in made.data


def test_relative_pose_is_as_loose_in_each_direction_of_the_second_as_its_covariance_says():
    axis = np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0)
    noise = 0.01 * np.eye(6)
    noise[3:, 3:] += 0.99 * np.outer(axis, axis)
    keys = pose_key(1), pose_key(2)
    made = between_factor(FactorKind.ODOMETRY, keys, POSE, noise, 'left', (3, 4))
    along, across = (
        POSE.compose(gtsam.Pose3(gtsam.Rot3(), metres * np.array([*direction, 0.0])))
        for metres, direction in ((1.0, axis[:2]), (0.1, (-axis[1], axis[0])))
    )
    for moved in (along, across):
        there = at(x1=START, x2=START.compose(moved))
        assert squared(made, there) == pytest.approx(1.0)
    told = np.zeros((6, 6))
    told[np.triu_indices(6)] = made.data['covariance']
    assert told + np.triu(told, 1).T == pytest.approx(noise)


@pytest.mark.parametrize('threshold', [0.0, 2.0])
def test_closure_is_a_relative_pose_whose_pull_is_bounded(threshold):
    keys = pose_key(1), pose_key(2)
    noise = np.diag(pose_sigmas(0.5, 0.1) ** 2)
    made = closure_factor(keys, POSE, noise, threshold, (3, 4))
    for metres in (0.5, 5.0):
        moved = POSE.compose(gtsam.Pose3(gtsam.Rot3(), np.array([metres, 0.0, 0.0])))
        far = metres / 0.5
        expected = 2.0 * threshold * (far - threshold / 2.0) if 0.0 < threshold < far else far**2
        assert squared(made, at(x1=START, x2=START.compose(moved))) == pytest.approx(expected)
    assert (made.kind, made.keys, made.sensor, made.stamps) == (
        FactorKind.CLOSURE,
        keys,
        None,
        (3, 4),
    )
    assert made.data['sigmas'] == pytest.approx([0.1] * 3 + [0.5] * 3)
    read_back = replace(made, describe=describer(FactorKind.CLOSURE, beside_gtsam(made)))
    assert read_back.data == made.data


COVARIANCE = np.diag([0.04, 0.09, 0.25])


@pytest.mark.parametrize('threshold', [0.0, 0.5, 2.0])
def test_fix_is_of_the_antenna_and_a_far_one_pulls_with_a_constant_force(threshold):
    place = POSE.transformFrom(ARM)
    made = gnss_factor(pose_key(1), place, COVARIANCE, ARM, threshold, 'gps', 9)
    assert squared(made, at(x1=POSE)) == pytest.approx(0.0, abs=1e-12)
    for metres in (0.05, 3.0):
        moved = gtsam.Pose3(POSE.rotation(), POSE.translation() + [0.0, metres, 0.0])
        whitened = metres / 0.3
        expected = whitened**2
        if 0.0 < threshold < whitened:
            expected = 2.0 * threshold * (whitened - threshold / 2.0)
        assert squared(made, at(x1=moved)) == pytest.approx(expected)
    assert (made.kind, made.sensor, made.stamps) == (FactorKind.GNSS, 'gps', (9,))
    assert made.data == {
        'position': pytest.approx(place.tolist()),
        'covariance': COVARIANCE.tolist(),
        'lever_arm': ARM.tolist(),
    }


def test_velocities_and_biases_are_held_as_the_settings_say():
    bias = gtsam.imuBias.ConstantBias(np.full(3, 0.1), np.full(3, 0.02))
    held = velocity_prior(velocity_key(1), np.array([1.0, 0.0, 2.0]), 0.5, 3)
    assert held.data == {'velocity': [1.0, 0.0, 2.0], 'sigma': 0.5}
    assert squared(held, at(v1=np.array([2.0, 0.0, 2.0]))) == pytest.approx(4.0)
    graph = car_settings(
        graph={'prior_sigma_accelerometer_bias': 0.2, 'prior_sigma_gyroscope_bias': 0.01}
    ).graph
    prior = bias_prior(bias_key(1), bias, graph, 3)
    assert prior.data == {'bias': [0.1] * 3 + [0.02] * 3, 'sigmas': [0.2] * 3 + [0.01] * 3}
    assert squared(prior, at(b1=gtsam.imuBias.ConstantBias())) == pytest.approx(3 * 0.25 + 3 * 4.0)
    assert (held.kind, prior.kind) == (FactorKind.PRIOR_VELOCITY, FactorKind.PRIOR_BIAS)
    assert held.stamps == prior.stamps == (3,)


def test_velocity_changes_from_the_first_to_the_second_cluster():
    keys = velocity_key(1), velocity_key(2)
    change = np.array([0.5, -1.0, 0.0])
    made = constant_velocity_prior(keys, change, 0.25, (3, 4))
    first = np.array([1.0, 2.0, 3.0])
    assert squared(made, at(v1=first, v2=first + change)) == pytest.approx(0.0, abs=1e-12)
    assert squared(made, at(v1=first, v2=first)) == pytest.approx((0.25 + 1.0) / 0.25**2)
    assert made.data == {'change': change.tolist(), 'sigma': 0.25}
    walk = bias_random_walk((bias_key(1), bias_key(2)), np.arange(1.0, 7.0), (3, 4))
    assert walk.data == {'sigmas': [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]}
    zero = gtsam.imuBias.ConstantBias()
    assert squared(walk, at(b1=zero, b2=zero)) == 0.0
    off = gtsam.imuBias.ConstantBias(np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 6.0]))
    assert squared(walk, at(b1=zero, b2=off)) == pytest.approx(2.0)
    assert (made.kind, walk.kind) == (FactorKind.CONSTANT_VELOCITY, FactorKind.BIAS_RANDOM_WALK)
    assert made.stamps == walk.stamps == (3, 4)


def test_span_tells_what_it_is_made_of():
    config = car_settings()
    parameters = preintegration_parameters(config.preintegration, config.imu.matrix())
    series = imu_series(0, 100 * MS)
    bias = gtsam.imuBias.ConstantBias(np.full(3, 0.1), np.zeros(3))
    span = preintegrate(series, 10 * MS, 60 * MS, parameters, bias)
    inside = series.within(10 * MS, 60 * MS).stamps
    made = imu_factor(1, 2, span, 'imu', (10 * MS, 60 * MS), inside)
    assert made.keys == tuple(
        make(number)
        for number, make in (
            (1, pose_key),
            (1, velocity_key),
            (2, pose_key),
            (2, velocity_key),
            (1, bias_key),
            (2, bias_key),
        )
    )
    assert made.stamps == (inside[0], inside[-1]) == (10 * MS, 58 * MS)
    data = made.data
    assert data['span_ns'] == [10 * MS, 60 * MS] and data['samples'] == len(inside) == 25
    assert data['delta_t'] == pytest.approx(0.05)
    assert data['delta_rotation_vector'] == pytest.approx([0.0, 0.0, 0.04], abs=1e-9)
    assert data['bias_hat'] == pytest.approx([0.1] * 3 + [0.0] * 3)
    assert len(data['delta_position']) == len(data['delta_velocity']) == 3


def test_factor_that_nobody_describes_has_no_numbers():
    assert Factor(FactorKind.IMU, (1,), gtsam.PriorFactorVector(1, np.zeros(3), NOISE)).data == {}


NOISE = gtsam.noiseModel.Isotropic.Sigma(3, 1.0)
