"""Clusters that an IMU span passes over are held by dead reckoning, no sample counting twice."""

import gtsam
import numpy as np
import pytest
from turning_car import MS, known_state, problem_of, settings, true_values, truth, velocity

from incremental_mapper.candidates.enumeration import candidates
from incremental_mapper.candidates.model import HEAD
from incremental_mapper.config import ImuSettings
from incremental_mapper.graph.factors import (
    FactorKind,
    bias_prior,
    pose_prior,
    pose_sigmas,
    velocity_prior,
)
from incremental_mapper.graph.passed_clusters import MotionSigmas, passed_sigmas
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


def dead_reckoned(problem, candidate):
    return [
        factor
        for factor in problem.factors.factors(candidate)
        if factor.kind is FactorKind.DEAD_RECKONING
    ]


def test_each_cluster_hangs_on_the_start_of_the_span_that_passes_over_it():
    problem = problem_of(WINDOW, config=ON)
    candidate = passed_over(problem, 1, 3)
    assert [link.start for link in candidate.connections] == [HEAD, 1]
    number = [problem.partitions.number(cluster) for cluster in candidate.clusters]
    found = dead_reckoned(problem, candidate)
    head = problem.inputs.frontier.head
    assert [factor.keys for factor in found] == [
        (pose_key(head), pose_key(number[0])),
        (pose_key(number[1]), pose_key(number[2])),
    ]
    values = true_values(candidate, problem)
    for factor in found:
        assert np.abs(factor.factor.unwhitenedError(values)).max() < 2e-3
    assert not dead_reckoned(problem, passed_over(problem, 0, 1, 2, 3))


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
def test_a_rotation_within_a_span_is_as_uncertain_as_a_bridge_between_its_ends(passed):
    sigmas = passed_sigmas(passed, 0.2, MotionSigmas(0.0, 0.0), IMU)
    bridge = IMU.gyroscope_noise * np.sqrt(passed * (0.2 - passed) / 0.2)
    assert sigmas[:3] == pytest.approx([max(bridge, 0.0001)] * 3)


def test_what_is_unknown_of_velocity_and_bias_grows_with_the_way():
    sigmas = [passed_sigmas(t, 0.4, MotionSigmas(0.5, 0.02), IMU) for t in (0.1, 0.2)]
    assert sigmas[0][3:] == pytest.approx([0.15] * 3, rel=0.01)
    assert sigmas[1][3:] == pytest.approx([0.3] * 3, rel=0.01)
    assert sigmas[1][0] == pytest.approx(0.004, rel=0.02)
