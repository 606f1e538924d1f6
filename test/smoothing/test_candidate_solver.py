"""Solved candidates against the batch solution of the same factors."""

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from turning_car import MS, assert_poses, known_state, problem_of, true_values, truth, windows
from turning_car import settings as car_settings

from incremental_mapper.candidates.enumeration import candidates
from incremental_mapper.smoothing.batch import make_graph, optimize, squared_error
from incremental_mapper.smoothing.candidate_solver import CandidateSolver
from incremental_mapper.variables import pose_key

WINDOW = {40 * MS: {'left'}, 60 * MS: {'gps'}, 90 * MS: {'right'}, 130 * MS: {'left'}}


def all_candidates(problem):
    return list(candidates(problem.elements, problem.head, problem.imu))


@settings(deadline=None, max_examples=15)
@given(windows(4), st.randoms(use_true_random=False))
def test_every_candidate_of_perfect_measurements_is_solved_to_the_truth(stamps, random):
    problem = problem_of(stamps)
    solver = CandidateSolver(problem.prior, problem.factors, problem.guess, 10)
    every = [item for item in all_candidates(problem) if not problem.unconnected(item)]
    for candidate in random.sample(every, min(len(every), 8)):
        solved = solver.solve(candidate)
        assert solved.error < 0.1
        for cluster in candidate.clusters:
            found = solved.pose(pose_key(problem.partitions.number(cluster)))
            assert_poses(found, truth(cluster.stamp), 0.01, 1e-3)


def optimum(problem, candidate, state):
    """The optimum of a candidate with all of G(t-1), by Levenberg-Marquardt."""
    factors = [factor.factor for factor in problem.factors.factors(candidate)]
    every = [*(factor.factor for factor in state.factors), *factors]
    needed = set(make_graph(every).keyVector())
    start, values = true_values(candidate, problem), gtsam.Values()
    values.insert(start)
    for key in start.keys():  # noqa: SIM118 (no mapping)
        if key not in needed:
            values.erase(key)
    return optimize(make_graph(every), values, 200).values, factors


def test_candidates_have_the_optimum_and_the_error_that_the_batch_gives_them():
    state = known_state(sigma=0.05)
    # The fix says that the car was elsewhere: the solution is a compromise.
    odometry = {'sigma_translation': 0.05, 'sigma_rotation': 0.005}
    config = car_settings(odometry=odometry, graph={'dead_reckoning': False})
    problem = problem_of(WINDOW, state, config)
    (seen,) = [item for item in problem.inputs.prepared.values() if item.core.kind == 'gnss']
    seen.enu[:] += [0.1, -0.15, 0.05]
    solver = CandidateSolver(problem.prior, problem.factors, problem.guess, 10)
    errors = []
    connected = [item for item in all_candidates(problem) if not problem.unconnected(item)]
    for candidate in connected:
        solved = solver.solve(candidate)
        expected, factors = optimum(problem, candidate, state)
        for cluster in candidate.clusters:
            key = pose_key(problem.partitions.number(cluster))
            assert_poses(solved.pose(key), expected.atPose3(key), 0.02, 2e-3)
        assert solved.error == pytest.approx(squared_error(factors, expected), rel=0.02, abs=0.05)
        errors.append(solved.error)
        refined = solver.refine(candidate, solved)
        assert refined.error == pytest.approx(squared_error(factors, refined.values), rel=1e-9)
        assert refined.graph is not None
    assert max(errors) > 1.1 * min(errors) > 1.0


def test_later_candidates_start_where_the_first_one_put_the_car():
    # One that starts from the prediction would be too far away to be linear in the same place.
    problem = problem_of(WINDOW, known_state(sigma=0.05))
    solver = CandidateSolver(problem.prior, problem.factors, problem.guess, 10)
    first, *others = all_candidates(problem)
    assert solver.solve(first).graph is not None
    for candidate in others:
        assert solver.solve(candidate).graph is None


def test_candidate_without_a_finite_solution_has_none():
    problem = problem_of(WINDOW)
    (seen,) = [item for item in problem.inputs.prepared.values() if item.core.kind == 'gnss']
    seen.enu[0] = np.nan
    solver = CandidateSolver(problem.prior, problem.factors, problem.guess, 10)
    assert solver.solve(all_candidates(problem)[0]) is None
