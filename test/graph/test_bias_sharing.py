"""One bias for many spans: whose it is, what holds it, and what it saves."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from turning_car import (
    MS,
    assert_poses,
    known_state,
    own_biases,
    problem_of,
    true_values,
    windows,
)
from turning_car import settings as car_settings

from incremental_mapper.candidates.enumeration import candidates
from incremental_mapper.candidates.model import HEAD, SpanBias
from incremental_mapper.config.pipeline import Strategy
from incremental_mapper.graph.bias_sharing import BiasSharing, sharing
from incremental_mapper.graph.factors import FactorKind
from incremental_mapper.graph.frontier import Frontier
from incremental_mapper.smoothing.candidate_solver import CandidateSolver
from incremental_mapper.smoothing.graph_state import GraphState
from incremental_mapper.variables import bias_key, kind_of, pose_key, velocity_key

WINDOW = {40 * MS: {'left'}, 140 * MS: {'right'}, 240 * MS: {'left'}}


def finest(problem):
    """Every measurement on its own, each tied to the one before."""
    return next(
        item
        for item in candidates(problem.elements, problem.head, problem.imu)
        if len(item.clusters) == 3 and len(item.connections) == 3
    )


def of_kind(factors, kind):
    return [factor for factor in factors if factor.kind is kind]


def biases(factors):
    return {key for factor in factors for key in factor.keys if kind_of(key) == 'b'}


def aged(seconds):
    """G(t-1) whose bias has served for so long."""
    state = known_state()
    state.frontier = replace(state.frontier, bias_stamp=round(40 * MS - seconds * 1000 * MS))
    return state


def test_spans_take_the_bias_that_is_there():
    problem = problem_of(WINDOW)
    factors = problem.factors.factors(finest(problem))
    assert biases(factors) == {bias_key(0)}
    assert not of_kind(factors, FactorKind.BIAS_RANDOM_WALK)
    assert [len(factor.keys) for factor in of_kind(factors, FactorKind.IMU)] == [5, 5, 5]
    values = problem.guess.values(finest(problem))
    assert not [key for key in values.keys() if kind_of(key) == 'b']  # noqa: SIM118 (no mapping)


def test_a_new_bias_starts_after_the_period_and_walks_as_long_as_the_old_one_served():
    walks = {'accelerometer_bias_walk': 0.2, 'gyroscope_bias_walk': 0.003}
    config = car_settings(preintegration=walks, graph={'bias_period': 4.0})
    problem = problem_of(WINDOW, aged(4.0), config)
    candidate = finest(problem)
    factors = problem.factors.factors(candidate)
    home = bias_key(problem.partitions.number(candidate.clusters[0]))
    (walk,) = of_kind(factors, FactorKind.BIAS_RANDOM_WALK)
    assert walk.keys == (bias_key(0), home)
    served = np.sqrt(3.96)  # up to where the first span starts
    assert walk.data['sigmas'] == pytest.approx([0.2 * served] * 3 + [0.003 * served] * 3)
    assert {factor.keys[-1] for factor in of_kind(factors, FactorKind.IMU)} == {home}
    assert problem.guess.values(candidate).exists(home)
    assert biases(problem_of(WINDOW, aged(3.9), config).factors.factors(candidate)) == {bias_key(0)}


def test_the_first_bias_of_all_has_a_prior():
    problem = problem_of(WINDOW, known_state(head_inertial=False))
    candidate = finest(problem)
    factors = problem.factors.factors(candidate)
    (held,) = of_kind(factors, FactorKind.PRIOR_BIAS)
    assert held.keys == (bias_key(problem.partitions.number(candidate.clusters[0])),)
    assert biases(factors) == set(held.keys)
    # The cluster that the window starts from gets a velocity, and the bias is not its own.
    values = problem.guess.values(candidate)
    assert values.exists(velocity_key(0)) and not values.exists(bias_key(0))


def test_a_chain_that_starts_anew_needs_no_bias_of_its_own():
    problem = problem_of(WINDOW, config=car_settings(preintegration={'max_gap': 0.15}))
    late = next(
        item
        for item in candidates(problem.elements, problem.head, problem.imu)
        if len(item.clusters) == 3 and [link.start for link in item.connections] == [HEAD, 1]
    )
    factors = problem.factors.factors(late)
    assert biases(factors) == {bias_key(0)}


def test_factors_of_longer_prefixes_have_a_new_bias_once():
    problem = problem_of(WINDOW, aged(60.0))
    candidate = finest(problem)
    walks = [
        len(of_kind(problem.factors.factors(candidate, since), FactorKind.BIAS_RANDOM_WALK))
        for since in range(4)
    ]
    assert walks == [1, 0, 0, 0]


@settings(deadline=None, max_examples=20)
@given(windows(4), st.booleans())
def test_no_candidate_has_more_than_one_new_bias_and_none_objects_to_the_truth(stamps, old):
    problem = problem_of(stamps, aged(60.0) if old else None)
    for candidate in list(candidates(problem.elements, problem.head, problem.imu))[:12]:
        factors = problem.factors.factors(candidate)
        new = biases(factors) - {bias_key(0)}
        assert len(new) == (1 if old and candidate.connections else 0)
        values = true_values(candidate, problem)
        for factor in factors:
            if factor.kind in (FactorKind.IMU, FactorKind.BIAS_RANDOM_WALK):
                assert 2.0 * factor.factor.error(values) < 0.1
        assert candidate.vertices == problem.guess.values(candidate).size()


@settings(deadline=None, max_examples=15)
@given(windows(4))
def test_one_bias_or_many_say_the_same_of_poses(stamps):
    """Where the bias walks slowly, a variable at each end of a span tells nothing more."""
    solved = []
    for config in (own_biases(), car_settings()):
        problem = problem_of(stamps, config=config)
        every = candidates(problem.elements, problem.head, problem.imu)
        candidate = next((item for item in every if not problem.unconnected(item)), None)
        if candidate is None:
            return
        solver = CandidateSolver(problem.prior, problem.factors, problem.guess, 30)
        found = solver.solve(candidate)
        assert found is not None
        last = problem.partitions.number(candidate.clusters[-1])
        solved.append(found.own().atPose3(pose_key(last)))
    assert_poses(solved[1], solved[0], metres=1e-4, radians=1e-5)


@pytest.mark.parametrize(('period', 'strategy'), [(0.0, Strategy.MOM), (1.0, Strategy.BASE)])
def test_paper_and_base_have_a_bias_at_each_end(period, strategy):
    graph = car_settings(graph={'bias_period': period}).graph
    assert sharing(Frontier(bias=3), 0, graph, strategy) == BiasSharing()


def test_nothing_is_kept_before_there_is_a_bias():
    graph = car_settings().graph
    assert sharing(GraphState().frontier, 0, graph, Strategy.MOM) == BiasSharing(SpanBias.NEW)


def test_what_a_candidate_adds_follows_from_whether_it_shares_a_bias():
    own, shared = (problem_of(WINDOW, config=config) for config in (own_biases(), None))
    assert finest(own).vertices == 9
    assert finest(shared).vertices == 6
