"""The smoother step by step against one dense solution, where everything is linear.

Velocities with differences between them are linear exactly: what has been marginalised, what
follows the frontier and what is left over by a solve that was cut short must all agree with the
dense solution to rounding.
"""

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from incremental_mapper.graph.factors import constant_velocity_prior, velocity_prior
from incremental_mapper.smoothing.gauss_newton import Problem
from incremental_mapper.smoothing.linear_system import Layout, layout_of
from incremental_mapper.smoothing.marginal_prior import MarginalPrior, marginalise, trimmed
from incremental_mapper.smoothing.smoother import (
    commit_solution,
    marginal_prior_of,
    smoother_update,
)
from incremental_mapper.variables import velocity_key


class Dense:
    """All measurements of velocities so far, and their least-squares solution."""

    def __init__(self, rng):
        self.rng = rng
        self.rows, self.factors = [], []

    def hold(self, number, sigma):
        value = self.rng.normal(size=3)
        self.rows.append(({number: 1.0}, value, sigma))
        return self._made(velocity_prior(velocity_key(number), value, sigma, 0))

    def link(self, first, second, sigma):
        change = self.rng.normal(size=3)
        self.rows.append(({first: -1.0, second: 1.0}, change, sigma))
        keys = velocity_key(first), velocity_key(second)
        return self._made(constant_velocity_prior(keys, change, sigma, (0, 0)))

    def _made(self, factor):
        self.factors.append(factor.factor)
        return factor.factor

    def solution(self, count):
        """Means (count, 3) and covariance (count, count) of each axis."""
        matrix, rhs = np.zeros((len(self.rows), count)), np.zeros((len(self.rows), 3))
        for i, (entries, value, sigma) in enumerate(self.rows):
            for number, sign in entries.items():
                matrix[i, number] = sign / sigma
            rhs[i] = value / sigma
        covariance = np.linalg.inv(matrix.T @ matrix)
        return covariance @ matrix.T @ rhs, covariance


def start_at(dense, *numbers):
    initial = gtsam.Values()
    for number in numbers:
        value = dense.rng.normal(size=3)
        initial.insert(velocity_key(number), value)
        # Every new variable is also held where it starts, by a standard deviation of a kilometre.
        dense.rows.append(({number: 1.0}, value, 1e3))
    return initial


def assert_solution(values, expected, numbers):
    # A solve ends where a step would make the cost no smaller than by a millionth.
    for number in numbers:
        assert values.atVector(velocity_key(number)) == pytest.approx(expected[number], abs=0.01)


def keys(numbers):
    return {velocity_key(number) for number in numbers}


drives = st.lists(
    st.tuples(st.integers(1, 4), st.booleans(), st.sets(st.integers(1, 3), max_size=2)),
    min_size=2,
    max_size=7,
)
"""For each step: how far back it links, whether it is measured itself, and what is kept."""


def grown(steps, seed, lag=100, iterations=20, names=None):
    """Variables one after the other, some marginalised; the prior, what left it, and the oracle."""
    rng = np.random.default_rng(seed)
    dense, prior, left, kept = Dense(rng), MarginalPrior(), {}, {0}
    prior, _ = smoother_update(prior, [dense.hold(0, 0.5)], start_at(dense, 0), {0: 0}, 20)
    for step, (back, measured, keep) in enumerate(steps, 1):
        # Only what is still in the frontier may be touched.
        first = sorted(kept)[-min(back, len(kept))]
        factors = [dense.link(first, step, rng.uniform(0.1, 2.0))]
        if measured:
            factors.append(dense.hold(step, rng.uniform(0.1, 2.0)))
        initial = start_at(dense, step)
        prior, _ = smoother_update(prior, factors, initial, {step: step}, iterations)
        kept = {step} | {number for number in kept if step - number in keep}
        prior, gone = marginalise(prior, keys(kept), step - lag)
        for key in gone.keys():  # noqa: SIM118 (no mapping)
            left[key] = gone.atVector(key)
    return prior, left, dense, kept


@settings(deadline=None, max_examples=25)
@given(drives, st.integers(0, 10_000))
def test_every_variable_follows_what_is_measured_later(steps, seed):
    prior, _, dense, kept = grown(steps, seed)
    count = len(steps) + 1
    expected, covariance = dense.solution(count)
    assert set(prior.keys) == keys(kept)
    assert set(prior.keys) | set(prior.eliminated) == keys(range(count))
    assert_solution(prior.values, expected, range(count))
    for number in kept:
        found = prior.covariance(velocity_key(number))
        assert found == pytest.approx(np.eye(3) * covariance[number, number], rel=1e-6, abs=1e-9)
    for number in range(count):
        held = prior.holder(velocity_key(number)).atVector(velocity_key(number))
        assert held == pytest.approx(expected[number], abs=0.01)


@settings(deadline=None, max_examples=15)
@given(drives, st.integers(0, 10_000))
def test_gains_are_those_of_the_joint_covariance(steps, seed):
    prior, _, dense, kept = grown(steps, seed)
    _, covariance = dense.solution(len(steps) + 1)
    frontier = [number for key in prior.keys for number in kept if velocity_key(number) == key]
    information = np.linalg.inv(covariance[np.ix_(frontier, frontier)])
    places = layout_of(prior.eliminated).places
    for number in range(len(steps) + 1):
        if number in kept:
            continue
        gain = covariance[number, frontier] @ information
        found = prior.gains[places[velocity_key(number)]]
        assert found == pytest.approx(np.kron(gain, np.eye(3)), abs=1e-8)


@settings(deadline=None, max_examples=15)
@given(drives, st.integers(0, 10_000))
def test_solved_set_moves_all_that_follows_without_being_committed(steps, seed):
    prior, _, dense, kept = grown(steps, seed)
    count = len(steps) + 1
    before = prior.values
    newest = max(kept)
    factors = [dense.link(newest, count, 0.3), dense.hold(newest, 0.2), dense.hold(count, 0.4)]
    solved = Problem(prior, start_at(dense, count), 20).solve(factors)
    expected, _ = dense.solution(count + 1)
    assert_solution(solved.values, expected, range(count + 1))
    assert solved.pose(velocity_key(count + 1)) is None
    # The marginal prior itself has not changed.
    for number in range(count):
        key = velocity_key(number)
        assert prior.values.atVector(key).tolist() == before.atVector(key).tolist()
    named = {velocity_key(count): velocity_key(count + 5)}
    committed = commit_solution(prior, solved, named, {count + 5: count})
    assert set(committed.keys) == set(prior.keys) | {velocity_key(count + 5)}
    assert committed.clusters == {**prior.clusters, count + 5: count}
    assert_solution(committed.values, expected, range(count))
    last = committed.values.atVector(velocity_key(count + 5))
    assert last == pytest.approx(expected[count], abs=0.01)
    # And it goes on from there as if nothing had been marginalised.
    smaller, _ = marginalise(committed, {velocity_key(count + 5)}, 0)
    assert_solution(smaller.values, expected, range(count))
    expected_error = 2.0 * sum(factor.error(solved.values) for factor in factors)
    assert solved.error == pytest.approx(expected_error, rel=1e-6, abs=1e-9)
    assert solved.cost >= solved.error


@settings(deadline=None, max_examples=15)
@given(drives, st.integers(0, 10_000))
def test_solution_that_no_step_was_taken_for_is_caught_up_by_the_next_one(steps, seed):
    # Whatever was marginalised before it was solved follows as soon as the frontier is.
    rng = np.random.default_rng(seed)
    dense, prior, kept = Dense(rng), MarginalPrior(), {0}
    prior, _ = smoother_update(prior, [dense.hold(0, 0.5)], start_at(dense, 0), {0: 0}, 0)
    for step, (back, measured, keep) in enumerate(steps, 1):
        first = sorted(kept)[-min(back, len(kept))]
        factors = [dense.link(first, step, 0.5)] + [dense.hold(step, 0.7) for _ in range(measured)]
        last = step == len(steps)
        initial = start_at(dense, step)
        prior, _ = smoother_update(prior, factors, initial, {step: step}, 20 if last else 0)
        kept = {step} | {number for number in kept if step - number in keep}
        prior, _ = marginalise(prior, keys(kept), 0)
    expected, _ = dense.solution(len(steps) + 1)
    assert_solution(prior.values, expected, range(len(steps) + 1))


@settings(deadline=None, max_examples=8)
@given(drives, st.integers(0, 10_000), st.integers(0, 4))
def test_what_leaves_the_lag_keeps_the_value_that_it_had_then(steps, seed, lag):
    prior, left, _, kept = grown(steps, seed, lag)
    count = len(steps) + 1
    stays = {number for number in range(count) if number >= count - 1 - lag}
    clusters = stays | kept
    assert set(prior.clusters) >= kept
    assert set(left) == keys(range(count)) - set(prior.keys) - set(prior.eliminated)
    assert set(left).isdisjoint(prior.base.keys())
    assert {number for number in range(count) if velocity_key(number) not in left} == clusters
    # Each had, when it left, the solution of what had been measured by then.
    for number in sorted(set(range(count)) - clusters):
        for end in range(number + 1, count):
            shorter, gone, oracle, _ = grown(steps[:end], seed, lag)
            if velocity_key(number) in gone:
                expected, _ = oracle.solution(end + 1)
                found = left[velocity_key(number)]
                assert found == pytest.approx(expected[number], abs=0.01)
                assert velocity_key(number) not in shorter.clusters
                break


@settings(deadline=None, max_examples=15)
@given(drives, st.integers(0, 10_000), st.integers(0, 4))
def test_prior_of_the_whole_graph_is_the_one_that_grew(steps, seed, lag):
    prior, _, dense, kept = grown(steps, seed, lag=100)
    count = len(steps) + 1
    expected, covariance = dense.solution(count)
    values = gtsam.Values()
    for number in range(count):
        values.insert(velocity_key(number), expected[number])
    clusters = {number: number for number in range(count)}
    whole, gone = marginal_prior_of(
        dense.factors, values, clusters, sorted(keys(kept)), count - 1 - lag
    )
    assert set(whole.keys) == keys(kept)
    newer = {number for number in range(count) if number >= count - 1 - lag} | kept
    assert set(gone.keys()) == keys(set(range(count)) - newer)
    assert set(whole.eliminated) == keys(newer - kept)
    assert set(whole.clusters) == newer
    assert_solution(whole.values, expected, newer)
    for number in kept:
        found = whole.covariance(velocity_key(number))
        assert found == pytest.approx(np.eye(3) * covariance[number, number], rel=1e-4)
    order = layout_of(whole.keys).columns(prior.keys)
    rows = layout_of(prior.eliminated).columns(whole.eliminated)
    assert whole.gains[:, order] == pytest.approx(prior.gains[rows], abs=1e-5)
    assert whole.rhs == pytest.approx(np.zeros(len(whole.rhs)), abs=1e-4)


@settings(deadline=None, max_examples=15)
@given(drives, st.integers(0, 10_000), st.sets(st.integers(0, 6)))
def test_trimmed_prior_says_the_same_of_what_is_left(steps, seed, wanted):
    prior, _, dense, kept = grown(steps, seed)
    small = trimmed(prior, keys(wanted))
    rest = {key for key in prior.eliminated if key in keys(wanted)}
    assert set(small.eliminated) == rest
    assert set(small.base.keys()) == rest | set(prior.keys)
    far = dense.hold(max(kept), 0.1)
    one = Problem(prior, gtsam.Values(), 20).solve([far]).values
    other = Problem(small, gtsam.Values(), 20).solve([far]).values
    for key in other.keys():  # noqa: SIM118 (no mapping)
        assert other.atVector(key) == pytest.approx(one.atVector(key), abs=1e-9)
    assert other.size() == len(rest) + len(prior.keys)


def test_layouts_grow_without_a_change_of_what_was_there():
    layout = Layout([velocity_key(1)])
    longer = layout.followed_by([velocity_key(2), velocity_key(1)])
    assert layout.size == 3 and longer.size == 6
    assert longer.keys == (velocity_key(1), velocity_key(2))
    assert longer.columns([velocity_key(2), velocity_key(1)]).tolist() == [3, 4, 5, 0, 1, 2]
    assert longer.columns([]).tolist() == []
