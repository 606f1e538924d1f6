"""Clusters that an IMU span passes over are held by dead reckoning, no sample counting twice."""

import gtsam
import numpy as np
import pytest
from turning_car import MS, known_state, problem_of, settings, true_values, truth, velocity

from incremental_mapper.candidates.enumeration import candidates
from incremental_mapper.candidates.model import HEAD
from incremental_mapper.config import ImuSettings, Strategy
from incremental_mapper.graph.factors import (
    FactorKind,
    bias_prior,
    pose_prior,
    pose_sigmas,
    velocity_prior,
)
from incremental_mapper.graph.passed_clusters import passed_sigmas
from incremental_mapper.variables import bias_key, pose_key, velocity_key

IMU = ImuSettings()
ON = settings(graph={'dead_reckoning': True})
OFF = settings(graph={'dead_reckoning': False})
SIGMA = 1e-3
"""How well G(t-1) is known: metres and m/s, and ten times as well in radians."""
WINDOW = {40 * MS: {'left'}, 80 * MS: {'right'}, 140 * MS: {'left'}, 180 * MS: {'right'}}


def passed_over(problem, *ends):
    """The candidate with a cluster for each scan and spans from G(t-1) to these clusters."""
    for candidate in candidates(problem.elements, problem.head, problem.imu):
        chain = [link.end for link in candidate.connections]
        if len(candidate.clusters) == len(problem.elements) and chain == list(ends):
            return candidate
    raise AssertionError


def made_of(kind, problem, candidate):
    return [factor for factor in problem.factors.factors(candidate) if factor.kind is kind]


def test_each_cluster_hangs_on_the_start_of_the_span_that_passes_over_it():
    problem = problem_of(WINDOW, config=ON)
    candidate = passed_over(problem, 1, 3)
    assert [link.start for link in candidate.connections] == [HEAD, 1]
    number = [problem.partitions.number(cluster) for cluster in candidate.clusters]
    found = made_of(FactorKind.IMU_PART, problem, candidate)
    head = problem.inputs.frontier.head
    # Pose and velocity of the start, the pose, the velocity that stands for its own, and the bias.
    assert [factor.keys[:4] for factor in found] == [
        (pose_key(head), velocity_key(head), pose_key(number[0]), velocity_key(number[1])),
        (
            pose_key(number[1]),
            velocity_key(number[1]),
            pose_key(number[2]),
            velocity_key(number[3]),
        ),
    ]
    values = true_values(candidate, problem)
    for factor in found:
        assert np.abs(factor.factor.unwhitenedError(values)[:6]).max() < 2e-3
    assert not made_of(FactorKind.IMU_PART, problem, passed_over(problem, 0, 1, 2, 3))


def test_nothing_is_said_of_the_velocity_of_a_cluster_on_the_way():
    problem = problem_of(WINDOW, config=ON)
    candidate = passed_over(problem, 1, 3)
    values = true_values(candidate, problem)
    (factor, _) = made_of(FactorKind.IMU_PART, problem, candidate)
    before = factor.factor.error(values)
    standing_for_it = factor.keys[3]
    values.update(standing_for_it, values.atVector(standing_for_it) + 5.0)
    assert factor.factor.error(values) == pytest.approx(before, abs=1e-3)


CLOSE = {
    40 * MS + MS // 2: {'left'},
    42 * MS: {'right'},
    140 * MS + MS // 2: {'left'},
    142 * MS: {'right'},
}
"""No sample of the IMU lies between a scan of the left and that of the right LiDAR."""


@pytest.mark.parametrize(
    ('strategy', 'expected'), [(Strategy.MOM, [(0, 1), (2, 3)]), (Strategy.BASE, [])]
)
def test_a_cluster_that_no_sample_parts_from_the_end_of_a_span_hangs_on_it(strategy, expected):
    config = settings(graph={'dead_reckoning': True}, selection={'strategy': strategy})
    problem = problem_of(CLOSE, config=config)
    candidate = passed_over(problem, 0, 2)
    number = [problem.partitions.number(cluster) for cluster in candidate.clusters]
    found = made_of(FactorKind.DEAD_RECKONING, problem, candidate)
    assert [factor.keys for factor in found] == [
        (pose_key(number[first]), pose_key(number[second])) for first, second in expected
    ]
    values = true_values(candidate, problem)
    for factor in found:
        assert np.abs(factor.factor.unwhitenedError(values)).max() < 2e-3


def spread(problem, candidate):
    """Standard deviations of the first cluster's rotation and position, behind a known state."""
    graph = gtsam.NonlinearFactorGraph()
    for factor in problem.factors.factors(candidate):
        graph.push_back(factor.factor)
    values = true_values(candidate, problem)
    bias = gtsam.imuBias.ConstantBias()
    for made in (
        pose_prior(pose_key(0), truth(0), pose_sigmas(SIGMA, SIGMA / 10.0), 0),
        velocity_prior(velocity_key(0), velocity(0), SIGMA, 0),
        bias_prior(bias_key(0), bias, problem.config.graph, 0),
    ):
        graph.push_back(made.factor)
    touched = set(graph.keyVector())
    for key in values.keys():  # noqa: SIM118 (no mapping)
        if key not in touched:
            values.erase(key)
    first = pose_key(problem.partitions.number(candidate.clusters[0]))
    covariance = gtsam.Marginals(graph, values).marginalCovariance(first)
    return np.sqrt([np.trace(covariance[:3, :3]), np.trace(covariance[3:, 3:])])


def test_a_cluster_is_nearly_as_exact_without_velocity_and_bias_as_with_them():
    """Hanging on a match of 0.03 m and 0.003 rad alone it is several times as uncertain."""
    state = known_state(sigma=SIGMA)
    on = problem_of(WINDOW, state, ON)
    off = problem_of(WINDOW, state, OFF)
    full = spread(on, passed_over(on, 0, 1, 2, 3))
    assert (spread(on, passed_over(on, 3)) < 1.5 * full).all()
    assert (spread(off, passed_over(off, 3)) > 3.0 * full).all()


@pytest.mark.parametrize('passed', [0.01, 0.1, 0.19])
def test_noise_within_a_span_is_that_between_two_known_ends(passed):
    """White noise is drawn, integrated up to the cluster, and freed of what the end tells."""
    span, step, rng = 0.2, 0.0005, np.random.default_rng(3)
    noise = rng.normal(size=(4000, round(span / step))) / np.sqrt(step)
    turned = np.cumsum(noise, axis=1) * step
    moved = np.cumsum(turned, axis=1) * step
    at, share = round(passed / step) - 1, passed / span
    rotation = IMU.gyroscope_noise * np.std(turned[:, at] - share * turned[:, -1])
    position = IMU.accelerometer_noise * np.std(moved[:, at] - share * moved[:, -1])
    found = passed_sigmas(passed, span, IMU)
    assert found[0] == pytest.approx(max(rotation, 0.0001), rel=0.1)
    assert found[1] == pytest.approx(max(position, 0.001), rel=0.1)
