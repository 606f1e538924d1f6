"""Relative covariances: those of a chain that nothing holds, and of one that a prior holds."""

import gtsam
import numpy as np
import pytest

from incremental_mapper.smoothing import relative_covariance
from incremental_mapper.smoothing.relative_covariance import RelativeCovariances
from incremental_mapper.variables import pose_key

STEP = gtsam.Pose3(gtsam.Rot3.Yaw(0.1), np.array([1.0, 0.2, 0.0]))
NOISE = np.diag(np.square([0.01, 0.02, 0.03, 0.1, 0.2, 0.3]))


def chain(count):
    values = gtsam.Values()
    pose = gtsam.Pose3()
    for number in range(count):
        values.insert(pose_key(number), pose)
        pose = pose.compose(STEP)
    model = gtsam.noiseModel.Gaussian.Covariance(NOISE)
    factors = [
        gtsam.BetweenFactorPose3(pose_key(i), pose_key(i + 1), STEP, model)
        for i in range(count - 1)
    ]
    return factors, values


def test_it_is_propagated_along_a_chain_that_nothing_holds():
    factors, values = chain(4)
    expected = np.zeros((6, 6))
    for _ in range(3):
        moved = STEP.inverse().AdjointMap()
        expected = moved @ expected @ moved.T + NOISE
    known = RelativeCovariances(factors, values, [pose_key(0), pose_key(3)])
    found = known.relative(pose_key(0), pose_key(3))
    assert found == pytest.approx(expected, rel=1e-3, abs=1e-6)


def test_it_is_that_of_the_marginals_where_those_can_be_had():
    factors, values = chain(5)
    prior = gtsam.PriorFactorPose3(
        pose_key(1), values.atPose3(pose_key(1)), gtsam.noiseModel.Isotropic.Sigma(6, 0.1)
    )
    graph = gtsam.NonlinearFactorGraph()
    for factor in (*factors, prior):
        graph.push_back(factor)
    first, second = pose_key(1), pose_key(4)
    joint = gtsam.Marginals(graph, values).jointMarginalCovariance([first, second])
    back = values.atPose3(second).between(values.atPose3(first)).AdjointMap()
    turn = np.hstack([-back, np.eye(6)])
    whole = np.block([[joint.at(i, j) for j in (first, second)] for i in (first, second)])
    found = RelativeCovariances([*factors, prior], values, [first, second]).relative(first, second)
    assert found == pytest.approx(turn @ whole @ turn.T, rel=1e-3, abs=1e-6)


def test_parts_of_the_factors_make_the_same_whole_and_pairs_share_a_pose(monkeypatch):
    factors, values = chain(8)
    poses = [pose_key(i) for i in (0, 3, 7)]
    whole = RelativeCovariances(factors, values, poses)
    monkeypatch.setattr(relative_covariance, 'PART', 3)
    parts = RelativeCovariances(factors, values, poses)
    for first, second in ((0, 3), (3, 7), (0, 7), (7, 0)):
        keys = pose_key(first), pose_key(second)
        # Without an anchor they are small differences of large numbers.
        assert parts.relative(*keys) == pytest.approx(whole.relative(*keys), rel=1e-4, abs=1e-7)
