"""Solving, and marginals that stand in for the rest of a graph."""

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from incremental_mapper.graph.factors import pose_prior, pose_sigmas
from incremental_mapper.smoothing.batch import eliminate, make_graph, optimize, squared_error
from incremental_mapper.variables import bias_key, copy_value, key_name, pose_key, velocity_key

SECOND = 1_000_000_000
FIX_NOISE = gtsam.noiseModel.Isotropic.Sigma(3, 0.5)
STEP = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.01, -0.02, 0.05), np.array([1.0, 0.1, -0.05]))


def odometry(start, end, motion, translation=0.05, rotation=0.01):
    noise = gtsam.noiseModel.Diagonal.Sigmas(pose_sigmas(translation, rotation))
    return gtsam.BetweenFactorPose3(pose_key(start), pose_key(end), motion, noise)


def noisy(motion, rng, scale=0.02):
    return motion.retract(rng.normal(scale=scale, size=6))


def make_chain(seed, count=6):
    """Poses in a chain with extra ties, fixes and a velocity, solved; every one determined."""
    rng = np.random.default_rng(seed)
    factors = [pose_prior(pose_key(0), gtsam.Pose3(), pose_sigmas(0.1, 0.05), 0).factor]
    initial = gtsam.Values()
    pose = gtsam.Pose3()
    for i in range(count):
        initial.insert(pose_key(i), noisy(pose, rng))
        if i:
            factors.append(odometry(i - 1, i, noisy(STEP, rng)))
        if i > 1:
            factors.append(odometry(i - 2, i, noisy(STEP.compose(STEP), rng), 0.2, 0.1))
        if i % 2:
            place = pose.translation() + rng.normal(scale=0.3, size=3)
            factors.append(gtsam.GPSFactor(pose_key(i), place, FIX_NOISE))
        pose = pose.compose(STEP)
    solution = optimize(make_graph(factors), initial, 50)
    assert solution is not None
    return factors, solution.values


def dense(factors, values, keys):
    """Information matrix and vector over ``keys``, from the plain Jacobian."""
    ordering = gtsam.Ordering()
    for key in keys:
        ordering.push_back(key)
    jacobian, right = make_graph(factors).linearize(values).jacobian(ordering)
    return jacobian.T @ jacobian, jacobian.T @ right


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 10_000), st.sets(st.integers(0, 5), min_size=1, max_size=5))
def test_marginal_of_the_kept_variables_is_that_of_the_whole_graph(seed, kept):
    factors, values = make_chain(seed)
    dropped = [pose_key(i) for i in range(6) if i not in kept]
    split = eliminate(make_graph(factors), values, dropped)
    smaller = gtsam.Values()
    for i in kept:
        copy_value(values, pose_key(i), smaller)
    whole = gtsam.Marginals(make_graph(factors), values)
    marginal = gtsam.Marginals(make_graph(split.factors), smaller)
    for i in kept:
        expected = whole.marginalCovariance(pose_key(i))
        found = marginal.marginalCovariance(pose_key(i))
        assert np.abs(found - expected).max() <= 1e-6 * np.abs(expected).max()


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 10_000), st.sets(st.integers(0, 5), min_size=1, max_size=5))
def test_dropped_variables_follow_the_kept_ones_as_the_dense_conditional_mean(seed, kept):
    factors, values = make_chain(seed)
    rng = np.random.default_rng(seed + 1)
    # Linearised away from the optimum, so that the steps have a constant part too.
    for i in range(6):
        values.update(pose_key(i), noisy(values.atPose3(pose_key(i)), rng))
    dropped = [pose_key(i) for i in range(6) if i not in kept]
    kept_keys = [pose_key(i) for i in sorted(kept)]
    split = eliminate(make_graph(factors), values, dropped)
    moves = {key: rng.normal(scale=0.05, size=6) for key in kept_keys}
    given_steps = gtsam.VectorValues()
    for key in kept_keys:
        given_steps.insert(key, moves[key])
    steps = split.conditional.optimize(given_steps)

    information, vector = dense(factors, values, [*dropped, *kept_keys])
    size = 6 * len(dropped)
    moved = np.concatenate([moves[key] for key in kept_keys])
    mean = np.linalg.solve(
        information[:size, :size], vector[:size] - information[:size, size:] @ moved
    )
    for i, key in enumerate(dropped):
        assert steps.at(key) == pytest.approx(mean[6 * i : 6 * i + 6], abs=1e-9)


def test_nothing_dropped_keeps_the_whole_graph():
    factors, values = make_chain(3)
    split = eliminate(make_graph(factors), values, [])
    keys = [pose_key(i) for i in range(6)]
    expected, _ = dense(factors, values, keys)
    found, _ = dense(split.factors, values, keys)
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_undetermined_variable_is_dropped_without_a_word_on_the_kept_ones():
    # A fix says nothing about the rotation of the dropped pose.
    values = gtsam.Values()
    for i in range(2):
        values.insert(pose_key(i), gtsam.Pose3())
    fix = gtsam.GPSFactor(pose_key(1), np.array([1.0, 2.0, 3.0]), FIX_NOISE)
    held = pose_prior(pose_key(0), gtsam.Pose3(), pose_sigmas(0.5, 0.1), 0).factor
    split = eliminate(make_graph([held, fix]), values, [pose_key(1)])
    kept = gtsam.Values()
    copy_value(values, pose_key(0), kept)
    marginal = gtsam.Marginals(make_graph(split.factors), kept).marginalCovariance(pose_key(0))
    assert np.sqrt(np.diag(marginal)) == pytest.approx([0.1] * 3 + [0.5] * 3, rel=1e-6)
    still = gtsam.VectorValues()
    still.insert(pose_key(0), np.zeros(6))
    steps = split.conditional.optimize(still).at(pose_key(1))
    assert steps == pytest.approx([0, 0, 0, 1, 2, 3], abs=1e-5)


def test_solution_is_the_optimum_and_its_error_twice_that_of_gtsam():
    factors, values = make_chain(5)
    solution = optimize(make_graph(factors), values, 50)
    graph = make_graph(factors)
    assert solution.error == pytest.approx(2.0 * graph.error(solution.values), rel=1e-9)
    assert squared_error(factors, solution.values) == pytest.approx(solution.error, rel=1e-9)
    _, gradient = dense(factors, solution.values, [pose_key(i) for i in range(6)])
    assert np.abs(gradient).max() < 1e-3


def test_squared_error_is_the_squared_mahalanobis_distance():
    prior = pose_prior(pose_key(0), gtsam.Pose3(), pose_sigmas(0.5, 0.1), 0).factor
    values = gtsam.Values()
    values.insert(pose_key(0), gtsam.Pose3(gtsam.Rot3(), np.array([1.0, 0.0, 0.0])))
    assert squared_error([prior], values) == pytest.approx((1.0 / 0.5) ** 2)


@pytest.mark.parametrize('bad', [np.nan, np.inf])
def test_measurement_that_is_not_finite_gives_no_solution(bad):
    factors, values = make_chain(1)
    motion = gtsam.Pose3(gtsam.Rot3(), np.array([bad, 0.0, 0.0]))
    assert optimize(make_graph([*factors, odometry(0, 1, motion)]), values, 10) is None


def test_initial_value_that_is_not_finite_gives_no_solution():
    factors, values = make_chain(1)
    values.update(pose_key(2), gtsam.Pose3(gtsam.Rot3(), np.full(3, np.nan)))
    assert optimize(make_graph(factors), values, 10) is None


def test_missing_initial_value_gives_no_solution():
    factors, values = make_chain(1)
    values.erase(pose_key(2))
    assert optimize(make_graph(factors), values, 10) is None


def test_chain_that_nothing_holds_in_the_map_keeps_its_differences():
    # Only the differences are determined; where it lies is as good as where it started.
    values = gtsam.Values()
    values.insert(pose_key(0), gtsam.Pose3())
    values.insert(pose_key(1), gtsam.Pose3(gtsam.Rot3(), np.array([5.0, 0.0, 0.0])))
    factors = [odometry(0, 1, STEP)]
    solution = optimize(make_graph(factors), values, 50)
    assert solution is not None
    poses = [solution.values.atPose3(pose_key(i)).matrix() for i in range(2)]
    assert np.isfinite(poses).all()
    assert solution.error < 1e-6 < squared_error(factors, values)
    assert poses[1] == pytest.approx(poses[0] @ STEP.matrix(), abs=1e-4)


def test_every_kind_of_variable_is_copied_also_under_another_name():
    source, target = gtsam.Values(), gtsam.Values()
    source.insert(pose_key(1), STEP)
    source.insert(velocity_key(1), np.array([1.0, 2.0, 3.0]))
    source.insert(bias_key(1), gtsam.imuBias.ConstantBias(np.ones(3), np.full(3, 2.0)))
    for make in (pose_key, velocity_key, bias_key):
        copy_value(source, make(1), target, make(4))
    assert target.atPose3(pose_key(4)).equals(STEP, 0.0)
    assert target.atVector(velocity_key(4)).tolist() == [1.0, 2.0, 3.0]
    assert target.atConstantBias(bias_key(4)).vector().tolist() == [1, 1, 1, 2, 2, 2]
    assert key_name(velocity_key(4)) == 'v4'


def test_velocity_and_bias_that_nothing_determines_are_dropped_where_they_are():
    values = gtsam.Values()
    values.insert(pose_key(0), STEP)
    values.insert(velocity_key(0), np.array([1.0, 2.0, 3.0]))
    values.insert(bias_key(0), gtsam.imuBias.ConstantBias(np.full(3, 0.1), np.full(3, 0.2)))
    values.insert(velocity_key(1), np.zeros(3))
    values.insert(bias_key(1), gtsam.imuBias.ConstantBias())
    noise = gtsam.noiseModel.Isotropic.Sigma(3, 0.5)
    # One axis of each is tied to the next cluster's, so that the variables are in the graph.
    ties = [
        gtsam.BetweenFactorVector(velocity_key(0), velocity_key(1), np.ones(3), noise),
        gtsam.BetweenFactorConstantBias(
            bias_key(0),
            bias_key(1),
            gtsam.imuBias.ConstantBias(),
            gtsam.noiseModel.Isotropic.Sigma(6, 0.5),
        ),
    ]
    held = pose_prior(pose_key(0), STEP, pose_sigmas(0.5, 0.1), 0).factor
    dropped = [velocity_key(0), velocity_key(1), bias_key(0), bias_key(1)]
    split = eliminate(make_graph([held, *ties]), values, dropped)
    kept = gtsam.Values()
    copy_value(values, pose_key(0), kept)
    marginal = gtsam.Marginals(make_graph(split.factors), kept).marginalCovariance(pose_key(0))
    assert np.sqrt(np.diag(marginal)) == pytest.approx([0.1] * 3 + [0.5] * 3, rel=1e-6)
    still = gtsam.VectorValues()
    still.insert(pose_key(0), np.zeros(6))
    steps = split.conditional.optimize(still)
    # They share the way to where the tie holds, as each is held alike.
    apart = values.atVector(velocity_key(1)) - values.atVector(velocity_key(0))
    change = steps.at(velocity_key(1)) - steps.at(velocity_key(0))
    assert apart + change == pytest.approx(np.ones(3), abs=1e-3)
    assert steps.at(velocity_key(0)) == pytest.approx(-steps.at(velocity_key(1)), abs=1e-3)
    assert steps.at(bias_key(0)) == pytest.approx(-steps.at(bias_key(1)), abs=1e-3)
