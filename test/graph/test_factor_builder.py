"""Factors of a window's candidates: none of them has anything to say against the truth."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from turning_car import (
    ARM,
    ENU_OFFSET,
    MS,
    assert_poses,
    fix,
    imu_series,
    items_at,
    known_state,
    motion,
    own_biases,
    problem_of,
    true_values,
    truth,
    velocity,
    windows,
)
from turning_car import settings as car_settings

from incremental_mapper.candidates.enumeration import candidates
from incremental_mapper.candidates.model import Candidate, Cluster, Connection
from incremental_mapper.graph.factors import FactorKind
from incremental_mapper.smoothing.graph_state import GraphState
from incremental_mapper.variables import bias_key, pose_key, velocity_key


def all_candidates(problem):
    return list(candidates(problem.elements, problem.head, problem.imu))


def of_kind(factors, kind):
    return [factor for factor in factors if factor.kind is kind]


@settings(deadline=None, max_examples=25)
@given(windows(4), st.randoms(use_true_random=False))
def test_no_factor_objects_to_the_truth_however_measurements_are_merged(stamps, random):
    problem = problem_of(stamps)
    every = all_candidates(problem)
    for candidate in random.sample(every, min(len(every), 12)):
        values = true_values(candidate, problem)
        factors = problem.factors.factors(candidate)
        assert len(of_kind(factors, FactorKind.IMU)) == len(candidate.connections)
        measured = {
            (factor.sensor, factor.stamps[-1])
            for factor in factors
            if factor.kind in (FactorKind.ODOMETRY, FactorKind.GNSS)
        }
        assert measured == {(core.sensor, core.stamp) for core in problem.inputs.prepared}
        for factor in factors:
            if factor.kind in (FactorKind.ODOMETRY, FactorKind.GNSS, FactorKind.CONSTANT_VELOCITY):
                assert np.abs(factor.factor.unwhitenedError(values)).max() < 2e-3, factor.kind
            else:
                # What a span says is the truth to the last few of its own standard deviations.
                assert 2.0 * factor.factor.error(values) < 0.1, factor.kind


def merged(problem, *groups):
    """A candidate with the elements in these runs (first, last), unconnected."""
    return Candidate(
        tuple(
            Cluster(tuple(core for part in problem.elements[a : b + 1] for core in part), a, b)
            for a, b in groups
        ),
        (),
    )


WINDOW = {40 * MS: {'left'}, 90 * MS: {'gps'}, 130 * MS: {'right'}}


def test_merged_members_are_moved_to_the_stamp_of_their_cluster():
    problem = problem_of(WINDOW)
    candidate = merged(problem, (0, 2))
    assert candidate.clusters[0].stamp == 90 * MS
    left, right = of_kind(problem.factors.factors(candidate), FactorKind.ODOMETRY)
    assert left.sensor == 'left' and left.stamps == (0, 40 * MS)
    for factor in (left, right):
        assert_poses(factor.factor.measured(), motion(0, 90 * MS))


def test_a_match_keeps_its_covariance_in_the_frame_of_the_cluster_in_which_its_scan_stands():
    problem = problem_of(WINDOW)
    candidate = merged(problem, (0, 2))
    rng = np.random.default_rng(2)
    root = 0.01 * rng.normal(size=(6, 6))
    known = {core: item for core, item in problem.inputs.prepared.items() if core.sensor == 'right'}
    for core, item in known.items():
        problem.inputs.prepared[core] = replace(item, covariance=root @ root.T)
    left, right = of_kind(problem.factors.factors(candidate), FactorKind.ODOMETRY)
    assert left.data['sigmas'] == pytest.approx([0.003] * 3 + [0.03] * 3)
    # The match is off by a step; how far off is the motion to the cluster, by its own noise?
    before, match = motion(0, -30 * MS), motion(-30 * MS, 130 * MS)
    after = motion(130 * MS, 90 * MS)
    for step in root.T:
        moved = before.compose(match.retract(1e-3 * step)).compose(after)
        values = true_values(candidate, problem)
        number = problem.partitions.number(candidate.clusters[0])
        values.update(pose_key(number), truth(0).compose(moved))
        whitened = right.factor.whitenedError(values) - right.factor.whitenedError(
            true_values(candidate, problem)
        )
        assert np.linalg.norm(whitened) == pytest.approx(1e-3, rel=0.02)


def test_fix_of_a_cluster_has_the_antenna_where_it_was_then():
    problem = problem_of(WINDOW)
    candidate = merged(problem, (0, 1), (2, 2))
    assert candidate.clusters[0].stamp == 90 * MS
    problem = problem_of({90 * MS: {'left'}, 40 * MS: {'gps'}, 130 * MS: {'right'}})
    candidate = merged(problem, (0, 1), (2, 2))
    (factor,) = of_kind(problem.factors.factors(candidate), FactorKind.GNSS)
    arm = motion(90 * MS, 40 * MS).transformFrom(ARM)
    assert factor.data['lever_arm'] == pytest.approx(arm, abs=2e-3)
    assert np.linalg.norm(arm - ARM) > 0.5
    assert factor.data['position'] == pytest.approx(truth(40 * MS).transformFrom(ARM), abs=1e-9)


def test_without_compensation_members_count_as_measured_at_their_cluster():
    config = car_settings(graph={'motion_compensation': False})
    problem = problem_of(WINDOW, config=config)
    candidate = merged(problem, (0, 2))
    factors = problem.factors.factors(candidate)
    left, right = of_kind(factors, FactorKind.ODOMETRY)
    assert left.factor.measured().equals(motion(0, 40 * MS), 1e-12)
    # Where the last scan of G(t-1) stands in its cluster is not this window's to say.
    expected = motion(0, -30 * MS).compose(motion(-30 * MS, 130 * MS))
    assert right.factor.measured().equals(expected, 1e-9)
    (seen,) = of_kind(factors, FactorKind.GNSS)
    assert seen.data['lever_arm'] == ARM.tolist()


def test_fix_is_inflated_in_the_plane_and_keeps_its_covariance():
    problem = problem_of({50 * MS: {'gps'}})
    inflated = dict.fromkeys(problem.inputs.fix_inflation, (3.0, 0.0))
    problem.inputs.fix_inflation.update(inflated)
    candidate = merged(problem, (0, 0))
    (factor,) = of_kind(problem.factors.factors(candidate), FactorKind.GNSS)
    expected = fix(50 * MS).covariance + np.diag([9.0, 9.0, 0.0])
    assert np.array(factor.data['covariance']) == pytest.approx(expected)
    enu = fix(50 * MS).enu
    assert factor.data['position'] == pytest.approx(enu + ENU_OFFSET)


def connected(problem, groups, *links):
    """A candidate with connections between clusters, by their indices."""
    bare = merged(problem, *groups)
    made = []
    for start, end in links:
        begin = 0 if start < 0 else bare.clusters[start].stamp
        stop = bare.clusters[end].stamp
        made.append(Connection(start, end, begin, stop, problem.imu.first_sample(begin, stop)))
    return Candidate(bare.clusters, tuple(made), problem.imu.bias)


SPREAD = {40 * MS: {'left'}, 140 * MS: {'right'}, 240 * MS: {'left'}}
ALONE = (0, 0), (1, 1), (2, 2)


def test_chain_that_starts_anew_is_held_by_the_last_velocity_and_bias():
    walks = {'accelerometer_bias_walk': 0.2, 'gyroscope_bias_walk': 0.003}
    config = own_biases(preintegration={'max_gap': 0.15, **walks})
    problem = problem_of(SPREAD, config=config)
    candidate = connected(problem, ALONE, (0, 1))
    factors = problem.factors.factors(candidate)
    (carried,) = of_kind(factors, FactorKind.CONSTANT_VELOCITY)
    (walk,) = of_kind(factors, FactorKind.BIAS_RANDOM_WALK)
    own = problem.partitions.number(candidate.clusters[0])
    assert carried.keys == (velocity_key(0), velocity_key(own))
    assert walk.keys == (bias_key(0), bias_key(own))
    assert carried.stamps == walk.stamps == (0, 40 * MS)
    assert carried.data['change'] == pytest.approx(velocity(40 * MS) - velocity(0), abs=1e-3)
    assert carried.data['sigma'] == pytest.approx(2.0 * 0.04)
    assert walk.data['sigmas'] == pytest.approx([0.2 * 0.2] * 3 + [0.2 * 0.003] * 3)


def test_second_chain_of_a_window_goes_on_from_the_first():
    problem = problem_of({**SPREAD, 290 * MS: {'right'}}, config=own_biases())
    candidate = connected(problem, (*ALONE, (3, 3)), (0, 1), (2, 3))
    walks = of_kind(problem.factors.factors(candidate), FactorKind.BIAS_RANDOM_WALK)
    numbers = [problem.partitions.number(cluster) for cluster in candidate.clusters]
    assert [walk.keys for walk in walks] == [
        (bias_key(0), bias_key(numbers[0])),
        (bias_key(numbers[1]), bias_key(numbers[2])),
    ]
    assert walks[1].stamps == (140 * MS, 240 * MS)


def test_velocity_is_forgotten_after_a_gap_and_the_bias_is_not():
    config = own_biases(preintegration={'max_gap': 0.1}, graph={'weak_sigma_velocity': 0.7})
    series = imu_series(-50 * MS, 300 * MS)
    state = known_state()
    problem = problem_of(SPREAD, state, config, series)
    candidate = connected(problem, ALONE, (1, 2))
    factors = problem.factors.factors(candidate)
    assert not of_kind(factors, FactorKind.CONSTANT_VELOCITY)
    (held,) = of_kind(factors, FactorKind.PRIOR_VELOCITY)
    assert held.data['sigma'] == 0.7
    assert held.data['velocity'] == pytest.approx(velocity(140 * MS), abs=0.02)
    assert len(of_kind(factors, FactorKind.BIAS_RANDOM_WALK)) == 1
    assert not of_kind(factors, FactorKind.PRIOR_BIAS)


def test_first_chain_of_all_has_priors_of_its_own():
    graph = {'prior_sigma_velocity': 7.0, 'prior_sigma_accelerometer_bias': 0.3}
    graph |= {'prior_sigma_gyroscope_bias': 0.02}
    config = own_biases(graph=graph)
    problem = problem_of(SPREAD, known_state(head_inertial=False), config)
    candidate = connected(problem, ALONE, (-1, 0))
    factors = problem.factors.factors(candidate)
    (held,) = of_kind(factors, FactorKind.PRIOR_VELOCITY)
    (bias,) = of_kind(factors, FactorKind.PRIOR_BIAS)
    assert held.keys == (velocity_key(0),) and bias.keys == (bias_key(0),)
    assert held.data['sigma'] == 7.0
    assert held.data['velocity'] == pytest.approx(velocity(0))
    assert bias.data['sigmas'] == [0.3] * 3 + [0.02] * 3
    assert bias.data['bias'] == [0.0] * 6


def test_factors_of_a_longer_prefix_are_those_that_it_has_more():
    problem = problem_of(SPREAD, config=own_biases())
    candidate = connected(problem, ALONE, (-1, 0), (0, 1), (1, 2))
    every = problem.factors.factors(candidate)
    for since in range(4):
        some = problem.factors.factors(candidate, since)
        known = {id(factor) for factor in some}
        numbers = [problem.partitions.number(item) for item in candidate.clusters[since:]]
        newer = {make(number) for number in numbers for make in (pose_key, velocity_key, bias_key)}
        assert known == {id(factor) for factor in every if newer & set(factor.keys)}


def test_first_window_holds_its_first_pose_level():
    graph = {'prior_sigma_level': 0.03, 'prior_sigma_yaw': 0.4, 'prior_sigma_position': 0.2}
    config = car_settings(graph=graph)
    problem = problem_of(SPREAD, GraphState(), config)
    candidate = merged(problem, (0, 0), (1, 1), (2, 2))
    (held,) = of_kind(problem.factors.factors(candidate), FactorKind.PRIOR_POSE)
    assert held.keys == (pose_key(problem.partitions.number(candidate.clusters[0])),)
    assert held.data['sigmas'] == [0.03, 0.03, 0.03, 0.2, 0.2, 0.2]
    assert held.stamps == (40 * MS,)
    assert not of_kind(problem.factors.factors(candidate, 1), FactorKind.PRIOR_POSE)


def test_bridge_is_the_predicted_motion_from_the_newest_cluster():
    graph = {'weak_sigma_position': 1.5, 'weak_sigma_rotation': 0.25}
    problem = problem_of(SPREAD, config=car_settings(graph=graph))
    first, _, last = merged(problem, *ALONE).clusters
    tie = problem.factors.bridge(last, first, truth(0))
    assert tie.kind is FactorKind.BRIDGE
    assert tie.keys == (pose_key(0), pose_key(problem.partitions.number(last)))
    assert tie.stamps == (0, 240 * MS)
    assert_poses(tie.factor.measured(), motion(0, 240 * MS))
    assert tie.data['sigmas'] == [0.25] * 3 + [1.5] * 3
    alone = problem.factors.bridge(last, first, None)
    assert alone.keys[0] == pose_key(problem.partitions.number(first))
    assert alone.stamps == (40 * MS, 240 * MS)
    assert_poses(alone.factor.measured(), motion(40 * MS, 240 * MS))


@pytest.mark.parametrize(
    ('hole', 'metres', 'radians'), [(1.0, 1.0, 0.2), (3.0, 41.0, 0.8), (600.0, 11981.0, np.pi)]
)
def test_bridge_is_the_looser_the_longer_the_hole(hole, metres, radians):
    problem = problem_of({round(hole * 1000) * MS: {'left'}})
    (alone,) = merged(problem, (0, 0)).clusters
    sigmas = problem.factors.bridge(alone, alone, truth(0)).data['sigmas']
    assert sigmas == pytest.approx([radians] * 3 + [metres] * 3)


def test_regularising_prior_is_weak_and_at_the_predicted_pose():
    graph = {'weak_sigma_position': 1.5, 'weak_sigma_rotation': 0.25}
    problem = problem_of(SPREAD, config=car_settings(graph=graph))
    last = merged(problem, *ALONE).clusters[2]
    held = problem.factors.regularising_prior(last)
    assert held.keys == (pose_key(problem.partitions.number(last)),)
    assert held.stamps == (240 * MS,)
    assert held.data['sigmas'] == [0.25] * 3 + [1.5] * 3
    assert_poses(held.factor.prior(), truth(240 * MS))


def test_scans_that_have_odometry_and_those_that_it_starts_from_are_known():
    problem = problem_of(WINDOW)
    left, seen, right = items_at(WINDOW)
    assert problem.factors.has_odometry(left.core) and problem.factors.has_odometry(right.core)
    assert not problem.factors.has_odometry(seen.core)
    continued = problem.factors.continued_scans(problem.inputs.prepared)
    assert continued == {('left', 0), ('right', -30 * MS)}


def test_velocity_and_bias_may_change_for_a_millisecond_at_the_least():
    walks = {'accelerometer_bias_walk': 0.2, 'gyroscope_bias_walk': 0.003}
    problem = problem_of(
        {MS // 2: {'left'}, 140 * MS: {'right'}}, config=own_biases(preintegration=walks)
    )
    candidate = connected(problem, ((0, 0), (1, 1)), (0, 1))
    factors = problem.factors.factors(candidate)
    (carried,) = of_kind(factors, FactorKind.CONSTANT_VELOCITY)
    (walk,) = of_kind(factors, FactorKind.BIAS_RANDOM_WALK)
    assert carried.data['sigma'] == pytest.approx(2.0 * 1e-3, rel=1e-9)
    root = np.sqrt(1e-3)
    assert walk.data['sigmas'] == pytest.approx([root * 0.2] * 3 + [root * 0.003] * 3, rel=1e-9)


def test_chain_that_starts_before_the_head_state_does_not_reckon_backwards():
    # The last cluster with velocity is older than the head, which has none.
    state = known_state()
    state.frontier = replace(state.frontier, inertial_stamp=-20 * MS)
    problem = problem_of(SPREAD, state)
    candidate = connected(problem, ALONE, (0, 1))
    (carried,) = of_kind(problem.factors.factors(candidate), FactorKind.CONSTANT_VELOCITY)
    assert carried.stamps == (-20 * MS, 40 * MS)
    assert carried.data['change'] == pytest.approx(velocity(40 * MS) - velocity(0), abs=1e-3)
    assert carried.data['sigma'] == pytest.approx(2.0 * 0.06)
