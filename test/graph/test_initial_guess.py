"""Where candidates are solved from: predictions, put right by what was solved already."""

import gtsam
import numpy as np
import pytest
from turning_car import (
    MS,
    assert_poses,
    known_state,
    own_biases,
    problem_of,
    true_values,
    truth,
    velocity,
)

from incremental_mapper.candidates.enumeration import candidates
from incremental_mapper.variables import bias_key, pose_key, velocity_key

WINDOW = {40 * MS: {'left'}, 62 * MS: {'gps'}, 97 * MS: {'right'}, 140 * MS: {'left'}}


def candidate_with(problem, *bounds):
    """The candidate with these clusters and all connections."""
    return next(
        item
        for item in candidates(problem.elements, problem.head, problem.imu)
        if tuple((cluster.first, cluster.last) for cluster in item.clusters) == bounds
        and len(item.connections) == len(bounds)
    )


def test_every_new_variable_starts_at_its_prediction():
    problem = problem_of(WINDOW, config=own_biases())
    candidate = candidate_with(problem, (0, 1), (2, 2), (3, 3))
    values = problem.guess.values(candidate)
    numbers = [problem.partitions.number(cluster) for cluster in candidate.clusters]
    makes = (pose_key, velocity_key, bias_key)
    assert set(values.keys()) == {make(number) for number in numbers for make in makes}
    for number, cluster in zip(numbers, candidate.clusters, strict=True):
        assert_poses(values.atPose3(pose_key(number)), truth(cluster.stamp))
        expected = velocity(cluster.stamp)
        assert values.atVector(velocity_key(number)) == pytest.approx(expected, abs=0.02)


def test_head_gets_velocity_and_bias_where_it_has_none():
    problem = problem_of(WINDOW, known_state(head_inertial=False), own_biases())
    candidate = candidate_with(problem, (0, 0), (1, 1), (2, 2), (3, 3))
    values = problem.guess.values(candidate)
    assert values.atVector(velocity_key(0)) == pytest.approx(velocity(0))
    assert values.exists(bias_key(0)) and not values.exists(pose_key(0))
    known = problem_of(WINDOW).guess.values(candidate)
    assert not known.exists(velocity_key(0))


def test_what_is_there_already_stays():
    problem = problem_of(WINDOW)
    candidate = candidate_with(problem, (0, 0), (1, 1), (2, 2), (3, 3))
    number = problem.partitions.number(candidate.clusters[0])
    values = gtsam.Values()
    values.insert(pose_key(number), gtsam.Pose3())
    values.insert(velocity_key(number), np.zeros(3))
    values.insert(bias_key(number), gtsam.imuBias.ConstantBias())
    problem.guess.add(candidate, values)
    assert values.atPose3(pose_key(number)).equals(gtsam.Pose3(), 0.0)
    assert values.atVector(velocity_key(number)).tolist() == [0.0] * 3


def test_states_differ_from_the_prediction_as_the_nearest_cluster_does():
    problem = problem_of(WINDOW, config=own_biases())
    candidate = candidate_with(problem, (0, 2), (3, 3))
    first, last = candidate.clusters
    assert (first.stamp, last.stamp) == (62 * MS, 140 * MS)
    values = true_values(candidate, problem)
    shifts = {first.stamp: np.array([1.0, 0.0, 0.0]), last.stamp: np.array([0.0, 2.0, 0.0])}
    for cluster in candidate.clusters:
        number, shift = problem.partitions.number(cluster), shifts[cluster.stamp]
        pose = truth(cluster.stamp)
        values.update(pose_key(number), gtsam.Pose3(pose.rotation(), pose.translation() + shift))
        values.update(velocity_key(number), velocity(cluster.stamp) + 10.0 * shift)
        bias = gtsam.imuBias.ConstantBias(shift, np.zeros(3))
        values.update(bias_key(number), bias)
    found = problem.guess.warm_start(candidate, values)
    assert set(found) == set(WINDOW)
    for stamp, near in ((40, 62), (62, 62), (97, 62), (140, 140)):
        state, shift = found[stamp * MS], shifts[near * MS]
        pose = truth(stamp * MS)
        assert_poses(state.pose, gtsam.Pose3(pose.rotation(), pose.translation() + shift))
        expected = velocity(stamp * MS) + 10.0 * shift
        assert state.velocity == pytest.approx(expected, abs=0.05)
        assert state.bias.accelerometer().tolist() == shift.tolist()
        assert state.stamp == stamp * MS
