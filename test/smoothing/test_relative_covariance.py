"""Relative covariances: those of a chain that nothing holds, and of one that a prior holds."""

import subprocess
import sys
from pathlib import Path

import gtsam
import numpy as np
import pytest

from incremental_mapper.smoothing import relative_covariance
from incremental_mapper.smoothing.linear_system import REGULARISING_SIGMA
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


LONE = """
import gtsam
from test_relative_covariance import NOISE, STEP, chain
from incremental_mapper.smoothing.relative_covariance import RelativeCovariances
from incremental_mapper.variables import pose_key

factors, values = chain({linked})
for number in range({linked}, {linked} + {lone}):
    values.insert(pose_key(number), STEP)
    model = gtsam.noiseModel.Gaussian.Covariance(NOISE)
    factors.append(gtsam.PriorFactorPose3(pose_key(number), STEP, model))
RelativeCovariances(factors, values)
"""


@pytest.mark.parametrize(('linked', 'lone'), [(0, 3), (4, 900), (500, 1), (500, 6)])
def test_variables_that_nothing_links_do_not_end_the_process(linked, lone):
    """As scans that match no other, without an IMU; in a process, which would be the one to die."""
    done = subprocess.run(
        [sys.executable, '-c', LONE.format(linked=linked, lone=lone)],
        cwd=Path(__file__).parent,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0


def test_it_is_propagated_along_a_chain_that_nothing_holds():
    factors, values = chain(4)
    expected = np.zeros((6, 6))
    for _ in range(3):
        moved = STEP.inverse().AdjointMap()
        expected = moved @ expected @ moved.T + NOISE
    known = RelativeCovariances(factors, values)
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
    found = RelativeCovariances([*factors, prior], values).relative(first, second)
    assert found == pytest.approx(turn @ whole @ turn.T, rel=1e-3, abs=1e-6)


def test_parts_of_the_factors_make_the_same_whole_and_pairs_share_a_pose(monkeypatch):
    factors, values = chain(8)
    whole = RelativeCovariances(factors, values)
    monkeypatch.setattr(relative_covariance, 'PART', 3)
    parts = RelativeCovariances(factors, values)
    for first, second in ((0, 3), (3, 7), (0, 7), (7, 0)):
        keys = pose_key(first), pose_key(second)
        # Without an anchor they are small differences of large numbers.
        assert parts.relative(*keys) == pytest.approx(whole.relative(*keys), rel=1e-4, abs=1e-7)


def test_it_is_that_of_the_marginals_across_a_long_drive_with_a_loop():
    factors, values = chain(60)
    model = gtsam.noiseModel.Gaussian.Covariance(NOISE)
    loop = values.atPose3(pose_key(5)).between(values.atPose3(pose_key(48)))
    factors += [
        gtsam.PriorFactorPose3(
            pose_key(0), gtsam.Pose3(), gtsam.noiseModel.Isotropic.Sigma(6, 0.1)
        ),
        gtsam.BetweenFactorPose3(pose_key(5), pose_key(48), loop, model),
    ]
    marginals = gtsam.Marginals(relative_covariance.make_graph(factors), values)
    known = RelativeCovariances(factors, values)
    for first, second in ((0, 59), (5, 48), (20, 33), (33, 20)):
        keys = pose_key(first), pose_key(second)
        joint = marginals.jointMarginalCovariance(list(keys))
        back = values.atPose3(keys[1]).between(values.atPose3(keys[0])).AdjointMap()
        turn = np.hstack([-back, np.eye(6)])
        whole = np.block([[joint.at(i, j) for j in keys] for i in keys])
        assert known.relative(*keys) == pytest.approx(turn @ whole @ turn.T, rel=1e-3, abs=1e-6)


def test_a_variable_that_nothing_touches_is_known_to_be_unknown():
    factors, values = chain(3)
    values.insert(pose_key(9), gtsam.Pose3())
    known = RelativeCovariances(factors, values)
    alone, held = pose_key(9), pose_key(1)
    assert known.position(alone) == pytest.approx(REGULARISING_SIGMA)
    assert known.relative(held, pose_key(2))[5, 5] < 1.0 < known.relative(held, alone)[5, 5]
