"""What G(t) says of its newest part: solving on top of it, extending it, letting old parts go."""

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from incremental_mapper.config import GraphSettings
from incremental_mapper.graph.factors import (
    FactorKind,
    between_factor,
    bias_prior,
    pose_prior,
    pose_sigmas,
    velocity_prior,
)
from incremental_mapper.smoothing.batch import make_graph, optimize, squared_error
from incremental_mapper.smoothing.gauss_newton import Problem
from incremental_mapper.smoothing.linear_system import Layout, solve_scaled
from incremental_mapper.smoothing.marginal_prior import MarginalPrior, marginalise, trimmed
from incremental_mapper.smoothing.smoother import marginal_prior_of, smoother_update
from incremental_mapper.smoothing.tangent import Pivoted
from incremental_mapper.variables import bias_key, pose_key, velocity_key

SECOND = 1_000_000_000
STEP = gtsam.Pose3(gtsam.Rot3.Ypr(0.05, 0.0, 0.01), np.array([1.0, 0.1, 0.0]))
FIX_NOISE = gtsam.noiseModel.Isotropic.Sigma(3, 0.02)


def noisy(pose, rng, scale):
    return pose.retract(rng.normal(scale=scale, size=6))


def odometry(first, second, motion):
    return between_factor(
        FactorKind.ODOMETRY,
        (pose_key(first), pose_key(second)),
        motion,
        np.diag(pose_sigmas(0.03, 0.003) ** 2),
        'left',
        (first, second),
    ).factor


def poses(*clusters):
    return {pose_key(cluster) for cluster in clusters}


def drive(count, seed=0):
    """Factors and initial values of each cluster of a chain, one cluster every 0.2 s."""
    rng = np.random.default_rng(seed)
    true = guess = gtsam.Pose3()
    for i in range(count):
        initial = gtsam.Values()
        if i == 0:
            factors = [pose_prior(pose_key(0), true, pose_sigmas(0.1, 0.02), 0).factor]
        else:
            motion = noisy(STEP, rng, 0.002)
            true, guess = true.compose(STEP), guess.compose(motion)
            factors = [odometry(i - 1, i, motion)]
        if i % 3 == 0:
            place = true.translation() + rng.normal(scale=0.02, size=3)
            factors.append(gtsam.GPSFactor(pose_key(i), place, FIX_NOISE))
        initial.insert(pose_key(i), guess)
        yield i, factors, initial


def stepped(count, lag, keep=(), seed=0):
    """The prior after ``count`` clusters, what was let go, and all factors and initial values."""
    prior, left, everything, start = MarginalPrior(), {}, [], gtsam.Values()
    for i, factors, initial in drive(count, seed):
        everything.extend(factors)
        start.insert(initial)
        prior, cost = smoother_update(prior, factors, initial, {i: i * SECOND // 5}, 20)
        assert cost >= 0.0
        assert prior.healthy
        prior, gone = marginalise(prior, poses(i, *keep), i * SECOND // 5 - lag)
        for key in gone.keys():  # noqa: SIM118 (no mapping)
            assert key not in left
            left[key] = gone.atPose3(key)
    return prior, left, everything, start


def difference(first, second, key):
    return np.abs(first.atPose3(key).localCoordinates(second.atPose3(key))).max()


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 10_000))
def test_prior_is_the_marginal_and_the_conditional_of_the_whole_graph(seed):
    prior, _, factors, start = stepped(12, 100 * SECOND, seed=seed)
    batch = optimize(make_graph(factors), start, 100).values
    for key in batch.keys():  # noqa: SIM118 (no mapping)
        assert difference(batch, prior.values, key) < 5e-4
    whole = gtsam.Marginals(make_graph(factors), prior.values)
    newest = pose_key(11)
    assert prior.keys == (newest,)
    expected = whole.marginalCovariance(newest)
    assert np.abs(prior.covariance(newest) - expected).max() <= 2e-3 * np.abs(expected).max()
    # A gain is the covariance with the frontier, times the frontier's information.
    own = Pivoted(prior.base, prior.pivot).own_steps(newest)
    for i in (3, 10):
        joint = whole.jointMarginalCovariance([pose_key(i), newest]).fullMatrix()
        place = Layout(prior.eliminated).columns([pose_key(i)])
        gain = joint[:6, 6:] @ np.linalg.inv(joint[6:, 6:])
        assert prior.gains[place] == pytest.approx(gain @ own, abs=2e-2)


def test_newest_poses_are_those_of_the_batch_over_a_long_chain():
    prior, left, factors, start = stepped(80, 2 * SECOND)
    batch = optimize(make_graph(factors), start, 100).values
    assert len(left) == 80 - len(prior.clusters)
    for cluster in prior.clusters:
        assert difference(batch, prior.values, pose_key(cluster)) < 1e-3


def test_prior_stays_small_however_long_the_drive_and_what_left_it_is_gone():
    short, _, _, _ = stepped(20, SECOND)
    long, left, _, _ = stepped(80, SECOND)
    assert long.root.shape == short.root.shape == (6, 6)
    assert len(long.clusters) == len(short.clusters) <= 6
    held = set(long.values.keys())
    assert held == {pose_key(cluster) for cluster in long.clusters}
    assert held == {*long.keys, *long.eliminated}
    assert held.isdisjoint(left)


def test_what_a_solve_that_was_cut_short_leaves_is_caught_up_later():
    prior, everything, start = MarginalPrior(), [], gtsam.Values()
    rng = np.random.default_rng(4)
    for i, factors, initial in drive(25, seed=4):
        off, last = gtsam.Values(), i == 24
        off.insert(pose_key(i), noisy(initial.atPose3(pose_key(i)), rng, 0.0 if last else 0.1))
        everything.extend(factors)
        start.insert(initial)
        # A single step from a bad place does not get there.
        prior, _ = smoother_update(prior, factors, off, {i: i}, 20 if last else 1)
        assert last or np.abs(prior.root.T @ prior.rhs).max() > 0.0
        prior, _ = marginalise(prior, poses(i), 0)
    batch = optimize(make_graph(everything), start, 100).values
    assert difference(batch, prior.values, pose_key(24)) < 3e-3
    for i in (20, 22):
        assert difference(batch, prior.values, pose_key(i)) < 3e-3


def test_cluster_that_is_still_needed_stays_in_the_frontier_whatever_its_age():
    prior, left, factors, start = stepped(30, SECOND, keep={4})
    batch = optimize(make_graph(factors), start, 100).values
    assert set(prior.keys) == {pose_key(4), pose_key(29)}
    assert pose_key(4) not in left
    assert difference(batch, prior.values, pose_key(29)) < 1e-3
    assert difference(batch, prior.values, pose_key(4)) < 1e-3


def test_prior_of_a_whole_graph_is_the_one_that_grew_with_it():
    grown, left, factors, start = stepped(20, SECOND)
    clusters = {i: i * SECOND // 5 for i in range(20)}
    batch = optimize(make_graph(factors), start, 100).values
    whole, gone = marginal_prior_of(factors, batch, clusters, poses(19), 19 * SECOND // 5 - SECOND)
    assert set(gone.keys()) == set(left)
    assert whole.keys == grown.keys
    assert set(whole.eliminated) == set(grown.eliminated)
    assert whole.clusters == grown.clusters
    information = grown.root.T @ grown.root
    assert whole.root.T @ whole.root == pytest.approx(
        information, abs=2e-3 * np.abs(information).max()
    )
    order = Layout(grown.eliminated).columns(whole.eliminated)
    assert whole.gains == pytest.approx(grown.gains[order], abs=2e-2)


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 10_000))
def test_problem_on_a_prior_has_the_optimum_of_the_whole_graph(seed):
    rng = np.random.default_rng(seed)
    prior, _, factors, start = stepped(10, 100 * SECOND, seed=seed)
    newest = prior.values.atPose3(pose_key(9))
    new = [odometry(9, 10, noisy(STEP, rng, 0.01))]
    place = newest.compose(STEP).translation() + rng.normal(scale=0.05, size=3)
    new.append(gtsam.GPSFactor(pose_key(10), place, FIX_NOISE))
    initial = gtsam.Values()
    initial.insert(pose_key(10), noisy(newest.compose(STEP), rng, 0.05))
    solved = Problem(prior, initial, 10).solve(new)
    start.insert(initial)
    batch = optimize(make_graph([*factors, *new]), start, 100).values
    # The prior is linear: of what the batch knows it loses a small part of its uncertainty.
    marginals = gtsam.Marginals(make_graph([*factors, *new]), batch)
    for i in range(11):
        sigma = np.sqrt(np.diag(marginals.marginalCovariance(pose_key(i))).max())
        assert difference(batch, solved.values, pose_key(i)) < 0.1 * sigma
        own = solved.values.atPose3(pose_key(i)).localCoordinates(solved.pose(pose_key(i)))
        assert np.abs(own).max() < 1e-9
    assert solved.error == pytest.approx(squared_error(new, solved.values))


def test_sets_of_factors_do_not_see_each_other():
    prior, _, _, _ = stepped(5, SECOND)
    newest = prior.values.atPose3(pose_key(4))
    problem = Problem(prior, gtsam.Values(), 10)
    for number in (5, 6):
        problem.values.insert(pose_key(number), newest.compose(STEP))
    straight, shifted = (
        odometry(4, number, STEP.compose(gtsam.Pose3(gtsam.Rot3(), np.array([shift, 0, 0]))))
        for number, shift in ((5, 0.0), (6, 0.02))
    )
    both = [problem.solve([straight]), problem.solve([shifted]), problem.solve([straight])]
    assert difference(both[0].values, both[2].values, pose_key(5)) < 1e-12
    apart = both[1].values.atPose3(pose_key(6)).between(both[0].values.atPose3(pose_key(5)))
    assert np.linalg.norm(apart.translation()) == pytest.approx(0.02, abs=1e-6)


def test_eliminated_variables_that_were_trimmed_are_no_part_of_a_solution():
    prior, _, _, _ = stepped(8, 100 * SECOND)
    far = prior.values.atPose3(pose_key(7)).translation() + [0.0, 0.0, 1.0]
    pull = [gtsam.GPSFactor(pose_key(7), far, FIX_NOISE)]
    solved = Problem(trimmed(prior, {pose_key(6)}), gtsam.Values(), 10).solve(pull)
    assert difference(prior.values, solved.values, pose_key(6)) > 1e-3
    assert set(solved.values.keys()) == {pose_key(6), pose_key(7)}


def test_measurement_that_is_not_finite_keeps_the_initial_values_and_says_so():
    _, factors, initial = next(iter(drive(1)))
    nowhere = gtsam.Pose3(gtsam.Rot3(), np.full(3, np.nan))
    bad = pose_prior(pose_key(0), nowhere, pose_sigmas(1, 1), 0)
    prior, cost = smoother_update(MarginalPrior(), [*factors, bad.factor], initial, {0: 0}, 20)
    assert not prior.healthy and cost == np.inf
    assert difference(prior.values, initial, pose_key(0)) == 0.0
    # What was finite still holds.
    assert prior.covariance(pose_key(0)) is not None
    again, _ = smoother_update(prior, [odometry(0, 1, STEP)], next_pose(1), {1: 1}, 20)
    assert again.healthy


def next_pose(number):
    initial = gtsam.Values()
    initial.insert(pose_key(number), STEP)
    return initial


def test_initial_value_far_off_is_still_solved():
    prior, _, _, _ = stepped(3, SECOND)
    newest = prior.values.atPose3(pose_key(2))
    initial = gtsam.Values()
    initial.insert(pose_key(3), newest.compose(gtsam.Pose3(gtsam.Rot3.Yaw(1.0), np.ones(3) * 5)))
    solved = Problem(prior, initial, 50).solve([odometry(2, 3, STEP)])
    moved = solved.values.atPose3(pose_key(2)).between(solved.values.atPose3(pose_key(3)))
    assert moved.equals(STEP, 1e-4)


def test_undetermined_variable_stays_where_it_is_and_disturbs_nobody():
    prior, _, _, _ = stepped(5, SECOND)
    initial = gtsam.Values()
    initial.insert(pose_key(5), prior.values.atPose3(pose_key(4)).compose(STEP))
    initial.insert(velocity_key(5), np.array([1.0, 2.0, 3.0]))
    factors = [odometry(4, 5, STEP)]
    grown, _ = smoother_update(prior, factors, initial, {5: SECOND}, 10)
    assert grown.healthy
    assert grown.values.atVector(velocity_key(5)) == pytest.approx([1.0, 2.0, 3.0])
    smaller, _ = marginalise(grown, {pose_key(5), velocity_key(5)}, 0)
    alone, _ = smoother_update(prior, factors, without_velocity(initial), {5: SECOND}, 10)
    alone, _ = marginalise(alone, poses(5), 0)
    assert smaller.covariance(pose_key(5)) == pytest.approx(alone.covariance(pose_key(5)), rel=1e-6)
    assert np.diag(smaller.covariance(velocity_key(5))) == pytest.approx([1e6] * 3, rel=1e-3)


def without_velocity(values):
    smaller = gtsam.Values(values)
    smaller.erase(velocity_key(5))
    return smaller


def test_prior_with_velocities_and_biases_has_the_graph_s_marginals():
    factors, values = [], gtsam.Values()
    bias = gtsam.imuBias.ConstantBias()
    for i, own, initial in drive(6, seed=9):
        values.insert(initial)
        priors = [
            velocity_prior(velocity_key(i), np.array([1.0, 0.0, 0.0]), 0.5, 0),
            bias_prior(bias_key(i), bias, GraphSettings(), 0),
        ]
        values.insert(velocity_key(i), np.array([1.0, 0.0, 0.0]))
        values.insert(bias_key(i), bias)
        factors += [*own, *(prior.factor for prior in priors)]
    values = optimize(make_graph(factors), values, 100).values
    keep = {pose_key(5), velocity_key(5), bias_key(5)}
    prior, _ = marginal_prior_of(factors, values, {i: i for i in range(6)}, keep, 0)
    assert set(prior.keys) == {pose_key(5), velocity_key(5), bias_key(5)}
    whole = gtsam.Marginals(make_graph(factors), values)
    pose, velocity, bias = pose_key(5), velocity_key(5), bias_key(5)
    joint = whole.jointMarginalCovariance([velocity, pose])
    blocks = [[joint.at(a, b) for b in (pose, velocity)] for a in (pose, velocity)]
    # A velocity as the vehicle sees it: what is not known of the attitude has a part in it.
    R_base_map = values.atPose3(pose).rotation().matrix().T
    turn = gtsam.Rot3.Hat(R_base_map @ values.atVector(velocity))
    seen = np.hstack([turn, np.zeros((3, 3)), R_base_map])
    expected = {key: whole.marginalCovariance(key) for key in (pose, bias)}
    expected[velocity] = seen @ np.block(blocks) @ seen.T
    for key in prior.keys:
        apart = np.abs(prior.covariance(key) - expected[key]).max()
        assert apart <= 1e-5 * np.abs(expected[key]).max()


def test_pose_stays_as_long_as_its_velocity_which_turns_with_it():
    factors, initial = [], gtsam.Values()
    for _, own, start in drive(2):
        factors += own
        initial.insert(start)
    initial.insert(velocity_key(0), np.array([1.0, 0.0, 0.0]))
    factors.append(velocity_prior(velocity_key(0), np.array([1.0, 0.0, 0.0]), 0.5, 0).factor)
    grown, _ = smoother_update(MarginalPrior(), factors, initial, {0: 0, 1: 1}, 5)
    smaller, _ = marginalise(grown, {pose_key(1), velocity_key(0)}, 0)
    assert set(smaller.keys) == {pose_key(0), pose_key(1), velocity_key(0)}
    whole, _ = marginal_prior_of(
        factors, grown.values, {0: 0, 1: 1}, {pose_key(1), velocity_key(0)}, 0
    )
    assert set(whole.keys) == set(smaller.keys)


def test_a_cluster_may_stay_in_part():
    bias = gtsam.imuBias.ConstantBias()
    (_, factors, initial), *_ = drive(1)
    initial.insert(velocity_key(0), np.zeros(3))
    initial.insert(bias_key(0), bias)
    priors = [velocity_prior(velocity_key(0), np.zeros(3), 0.5, 0)]
    priors.append(bias_prior(bias_key(0), bias, GraphSettings(), 0))
    grown, _ = smoother_update(
        MarginalPrior(), [*factors, *(prior.factor for prior in priors)], initial, {0: 0}, 5
    )
    smaller, gone = marginalise(grown, poses(0), SECOND)
    # Old as it is, the cluster's other variables stay with its pose.
    assert smaller.keys == (pose_key(0),)
    assert set(smaller.eliminated) == {velocity_key(0), bias_key(0)}
    assert gone.size() == 0 and smaller.clusters == {0: 0}


def test_empty_prior_has_nothing_to_marginalise():
    smaller, gone = marginalise(MarginalPrior(), (), 10)
    assert smaller.keys == () and smaller.root.shape == (0, 0)
    assert gone.size() == 0


@settings(deadline=None, max_examples=50)
@given(st.integers(1, 8), st.integers(0, 10_000))
def test_scaled_solve_is_the_solution_whatever_the_units(size, seed):
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(size + 3, size))
    units = 10.0 ** rng.uniform(-6, 6, size=size)
    information = (matrix * units).T @ (matrix * units)
    wanted = rng.normal(size=size) / units
    found = solve_scaled(information, information @ wanted)
    assert found * units == pytest.approx(wanted * units, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize('value', [0.0, -1.0, np.nan, np.inf])
def test_equations_that_are_not_definite_have_no_solution(value):
    information = np.eye(3)
    information[1, 1] = value
    assert solve_scaled(information, np.ones(3)) is None
