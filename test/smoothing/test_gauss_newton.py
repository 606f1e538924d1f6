"""Candidates' sets of factors around one linearisation have the optima that each has by itself."""

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from incremental_mapper.graph.factors import (
    FactorKind,
    between_factor,
    gnss_factor,
    pose_prior,
    pose_sigmas,
)
from incremental_mapper.smoothing.batch import make_graph
from incremental_mapper.smoothing.gauss_newton import Problem, SharedProblem
from incremental_mapper.smoothing.marginal_prior import MarginalPrior, marginalise
from incremental_mapper.smoothing.smoother import commit_solution, smoother_update
from incremental_mapper.variables import pose_key

STEP = gtsam.Pose3(gtsam.Rot3.Ypr(0.05, 0.0, 0.01), np.array([1.0, 0.1, 0.0]))


def odometry(first, second, motion):
    keys = (pose_key(first), pose_key(second))
    noise = np.diag(pose_sigmas(0.03, 0.003) ** 2)
    return between_factor(FactorKind.ODOMETRY, keys, motion, noise, 'left', (first, second)).factor


def fix(number, place, robust=0.0):
    spread = np.eye(3) * 0.02**2
    arm = np.array([0.5, 0.0, 1.0])
    return gnss_factor(pose_key(number), place, spread, arm, robust, 'gnss', 0).factor


def start_prior():
    """Two poses in the frontier, the second known less well than the first."""
    initial = gtsam.Values()
    initial.insert(pose_key(0), gtsam.Pose3())
    initial.insert(pose_key(1), STEP)
    prior = pose_prior(pose_key(0), gtsam.Pose3(), pose_sigmas(0.1, 0.02), 0).factor
    factors = [prior, odometry(0, 1, STEP)]
    prior, _ = smoother_update(MarginalPrior(), factors, initial, {0: 0, 1: 1}, 20)
    return marginalise(prior, {pose_key(0), pose_key(1)}, 0)[0]


def noisy_motion(rng, scale):
    return STEP.retract(rng.normal(scale=scale, size=6))


def sets_of(rng, scale, robust=0.0, off=0.05):
    """Three sets over the poses 2 and 3 that have most factors in common."""
    last, two = STEP.compose(STEP), noisy_motion(rng, scale)
    shared = [odometry(1, 2, two), odometry(0, 2, STEP.compose(noisy_motion(rng, scale)))]
    arm = np.array([0.5, 0.0, 1.0])
    seen = fix(2, last.transformFrom(arm) + rng.normal(scale=off, size=3), robust)
    third = odometry(2, 3, noisy_motion(rng, scale))
    return [shared, [*shared, seen], [*shared, third, seen], [shared[0], third]]


def shared_problem(prior):
    problem = SharedProblem(prior, 20)
    for number in (2, 3):
        problem.values.insert(pose_key(number), initial_pose(number))
    return problem


def initial_pose(number):
    pose = gtsam.Pose3()
    for _ in range(number):
        pose = pose.compose(STEP)
    return pose


def alone(prior, factors):
    initial = gtsam.Values()
    for number in (2, 3):
        initial.insert(pose_key(number), initial_pose(number))
    return Problem(prior, initial, 50).solve(factors)


def assert_same(found, expected, poses):
    # A thousandth for what is linear, and what either solve may be away from its optimum. The cost
    # is flat there; the error is not, as what the prior says against a step makes up for it.
    assert found.cost == pytest.approx(expected.cost, abs=1.1e-3 * (1 + expected.cost))
    assert found.error == pytest.approx(expected.error, abs=5e-3 * (1 + expected.error))
    for number in poses:
        key = pose_key(number)
        apart = expected.pose(key).localCoordinates(found.pose(key))
        # A tenth of the measurements' standard deviations.
        assert np.abs(apart[:3]).max() < 3e-4
        assert np.abs(apart[3:]).max() < 2e-3


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 10_000))
def test_sets_that_share_factors_have_the_optima_that_they_have_alone(seed):
    prior, rng = start_prior(), np.random.default_rng(seed)
    problem = shared_problem(prior)
    for factors in sets_of(rng, 0.002):
        solved = problem.solve_next(factors)
        assert_same(solved, alone(prior, factors), (0, 1, 2))
    assert solved.pose(pose_key(77)) is None


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 10_000))
def test_fix_that_a_robust_loss_holds_off_counts_as_it_does_alone(seed):
    prior, rng = start_prior(), np.random.default_rng(seed)
    problem = shared_problem(prior)
    for factors in sets_of(rng, 0.002, robust=1.5, off=0.15):
        solved = problem.solve_next(factors)
        assert_same(solved, alone(prior, factors), (0, 1, 2))


def test_set_whose_solution_is_far_away_is_solved_by_itself():
    prior = start_prior()
    problem = shared_problem(prior)
    turned = STEP.compose(gtsam.Pose3(gtsam.Rot3.Yaw(0.4), np.array([0.0, 0.5, 0.0])))
    assert problem.solve_next([odometry(1, 2, STEP)]).graph is not None
    assert problem.solve_next([odometry(1, 2, noisy_motion(np.random.default_rng(0), 1e-4))])
    far = problem.solve_next([odometry(1, 2, turned)])
    assert far.graph is not None
    moved = far.pose(pose_key(1)).between(far.pose(pose_key(2)))
    assert moved.equals(turned, 1e-5)


def test_refined_solution_has_its_true_error_and_is_appended_as_if_solved_alone():
    prior, rng = start_prior(), np.random.default_rng(5)
    problem = shared_problem(prior)
    sets = sets_of(rng, 0.002)
    problem.solve_next(sets[0])
    linear = problem.solve_next(sets[2])
    assert linear.graph is None
    refined = problem.refine(linear, sets[2])
    values = refined.values
    true = 2.0 * sum(factor.error(values) for factor in sets[2])
    assert refined.error == pytest.approx(true)
    grown = commit_solution(prior, refined, {}, {2: 2, 3: 3})
    expected = commit_solution(prior, alone(prior, sets[2]), {}, {2: 2, 3: 3})
    assert grown.keys == expected.keys
    for key in grown.keys:
        assert grown.covariance(key) == pytest.approx(expected.covariance(key), rel=1e-2, abs=1e-7)


def test_set_that_is_not_finite_has_no_solution_and_spoils_no_other():
    prior = start_prior()
    problem = shared_problem(prior)
    good = [odometry(1, 2, STEP)]
    bad = fix(2, np.full(3, np.nan))
    assert problem.solve_next([*good, bad]) is None
    assert problem.solve_next(good) is not None
    assert problem.solve_next([*good, bad]) is None
    assert problem.solve_next(good).error == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(('turn', 'alone'), [(0.008, False), (0.012, True), (-0.012, True)])
@pytest.mark.parametrize('axis', range(3))
def test_set_is_solved_by_itself_once_a_pose_turns_by_more_than_a_hundredth(axis, turn, alone):
    prior = start_prior()
    problem = shared_problem(prior)
    problem.solve_next([odometry(1, 2, STEP)])
    off = np.zeros(6)
    off[axis] = turn
    solved = problem.solve_next([odometry(1, 2, STEP.retract(off))])
    assert (solved.graph is not None) == alone
    assert solved.error == pytest.approx(0.0, abs=2e-3)
    found = solved.pose(pose_key(1)).between(solved.pose(pose_key(2)))
    assert found.equals(STEP.retract(off), 1e-3)


def test_set_that_moves_far_without_turning_is_as_good_as_linear():
    problem = shared_problem(start_prior())
    problem.solve_next([odometry(1, 2, STEP)])
    off = np.array([0.0, 0.0, 0.0, 0.5, -0.3, 0.2])
    solved = problem.solve_next([odometry(1, 2, STEP.retract(off))])
    assert solved.graph is None
    assert solved.error == pytest.approx(0.0, abs=2e-3)


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 10_000))
def test_solution_is_the_optimum_to_a_thousandth_of_its_cost(seed):
    """Whatever the first step reaches: a solve that ends too early would be off by more."""
    prior, rng = start_prior(), np.random.default_rng(seed)
    factors = sets_of(rng, 0.02, off=0.2)[2]
    initial = gtsam.Values()
    for number in (2, 3):
        initial.insert(pose_key(number), initial_pose(number).retract(rng.normal(size=6) * 0.05))
    found = Problem(prior, initial, 50).solve(factors)
    best = Problem(prior, found.values.extract([pose_key(2), pose_key(3)]), 50).solve(factors)
    assert found.cost <= best.cost + 1e-3 * (1.0 + best.cost)
    assert found.error == pytest.approx(2.0 * make_graph(factors).error(found.values), rel=1e-9)


@settings(deadline=None, max_examples=25)
@given(st.floats(0.01, 0.3))
def test_robust_fix_has_its_true_error_whether_it_is_held_off_or_not(off):
    problem = shared_problem(start_prior())
    problem.solve_next([odometry(1, 2, STEP)])
    arm = np.array([0.5, 0.0, 1.0])
    place = initial_pose(2).transformFrom(arm) + [0.0, off, 0.0]
    factors = [odometry(1, 2, STEP), fix(2, place, 1.5)]
    solved = problem.solve_next(factors)
    true = 2.0 * make_graph(factors).error(solved.values)
    assert solved.error == pytest.approx(true, abs=3e-3 * (1.0 + true))
