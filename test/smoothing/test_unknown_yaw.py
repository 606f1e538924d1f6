"""What nobody measures stays as it is: the yaw of a drive that no fix has turned to the north."""

import gtsam
import numpy as np
import pytest

from incremental_mapper.config import GraphSettings, ImuSettings
from incremental_mapper.frontend.imu_preintegration import (
    ImuSeries,
    preintegrate,
    preintegration_parameters,
)
from incremental_mapper.graph.factors import (
    FactorKind,
    between_factor,
    bias_prior,
    imu_factor,
    pose_prior,
    pose_sigmas,
    velocity_prior,
)
from incremental_mapper.smoothing.marginal_prior import MarginalPrior, marginalise
from incremental_mapper.smoothing.smoother import smoother_update
from incremental_mapper.variables import bias_key, pose_key, velocity_key

STEP = 100_000_000
SPEED = 5.6
YAW_SIGMA = 0.3
ODOMETRY = np.array([0.002, 0.002, 0.002, 0.01, 0.01, 0.01])
"""Standard deviations of a match, rotation first, radians and metres."""


def keys_of(cluster):
    return {pose_key(cluster), velocity_key(cluster), bias_key(cluster)}


def imu_span(first, rng, parameters):
    """Ten samples of a vehicle that goes straight on, from one cluster to the next."""
    stamps = first * STEP + np.arange(11) * STEP // 10
    forces = np.array([0.0, 0.0, 9.81]) + rng.normal(size=(11, 3)) * 0.05
    series = ImuSeries(stamps, rng.normal(size=(11, 3)) * 0.002, forces)
    span = (first * STEP, (first + 1) * STEP)
    made = preintegrate(series, *span, parameters, gtsam.imuBias.ConstantBias())
    return imu_factor(first, first + 1, made, 'imu', span, stamps).factor


def start(yaw):
    """A drive that heads so far off the x-axis, its yaw hardly known."""
    graph = GraphSettings()
    sigmas = pose_sigmas(graph.prior_sigma_position, graph.prior_sigma_level)
    sigmas[2] = YAW_SIGMA
    pose = gtsam.Pose3(gtsam.Rot3.Yaw(yaw), np.zeros(3))
    velocity = pose.rotation().rotate(np.array([SPEED, 0.0, 0.0]))
    factors = [
        pose_prior(pose_key(0), pose, sigmas, 0).factor,
        velocity_prior(velocity_key(0), np.zeros(3), 10.0, 0).factor,
        bias_prior(bias_key(0), gtsam.imuBias.ConstantBias(), graph, 0).factor,
    ]
    initial = gtsam.Values()
    initial.insert(pose_key(0), pose)
    initial.insert(velocity_key(0), velocity)
    initial.insert(bias_key(0), gtsam.imuBias.ConstantBias())
    return smoother_update(MarginalPrior(), factors, initial, {0: 0}, 20)[0]


def drive(seed, yaw, windows=60):
    """The prior after each window of a drive straight on; older clusters are marginalised."""
    rng = np.random.default_rng(seed)
    parameters = preintegration_parameters(ImuSettings(), np.eye(4))
    motion = gtsam.Pose3(gtsam.Rot3(), np.array([SPEED * STEP / 1e9, 0.0, 0.0]))
    prior = start(yaw)
    for last in range(windows):
        seen = motion.retract(rng.normal(size=6) * ODOMETRY)
        names = pose_key(last), pose_key(last + 1)
        match = between_factor(
            FactorKind.ODOMETRY, names, seen, np.diag(ODOMETRY**2), 'left', (last, last + 1)
        ).factor
        values, initial = prior.values, gtsam.Values()
        initial.insert(pose_key(last + 1), values.atPose3(pose_key(last)).compose(seen))
        initial.insert(velocity_key(last + 1), values.atVector(velocity_key(last)))
        initial.insert(bias_key(last + 1), values.atConstantBias(bias_key(last)))
        factors = [match, imu_span(last, rng, parameters)]
        prior, _ = smoother_update(prior, factors, initial, {last + 1: (last + 1) * STEP}, 10)
        prior, _ = marginalise(prior, keys_of(last + 1), 0)
        yield last + 1, prior


@pytest.mark.parametrize('yaw', [0.0, 0.7])
@pytest.mark.parametrize('seed', range(3))
def test_drive_without_fixes_keeps_the_yaw_it_began_with(seed, yaw):
    for last, prior in drive(seed, yaw):
        begun = prior.values.atPose3(pose_key(0)).rotation().yaw()
        assert begun == pytest.approx(yaw, abs=1e-3), last


def test_yaw_is_no_better_known_after_a_drive_than_at_its_start():
    for last, prior in drive(0, 0.7):
        covariance = prior.covariance(pose_key(last))
        assert np.sqrt(covariance[2, 2]) == pytest.approx(YAW_SIGMA, rel=0.02), last
