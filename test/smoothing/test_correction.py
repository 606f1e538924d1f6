"""Evidence that comes late: against a solution of everything at once."""

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_marginal_prior import drive, poses
from test_smoother import Dense, keys, start_at

from incremental_mapper.graph.factors import FactorKind, between_factor, pose_sigmas
from incremental_mapper.smoothing.batch import make_graph, optimize
from incremental_mapper.smoothing.correction import (
    evidence_on,
    hold,
    moved,
    release,
    with_evidence,
)
from incremental_mapper.smoothing.marginal_prior import MarginalPrior, marginalise
from incremental_mapper.smoothing.smoother import smoother_update
from incremental_mapper.variables import pose_key, velocity_key


def go_on(prior, dense, steps, held_at=None, lag=2):
    """A chain of velocities; returns the prior, and what there was at step ``held_at``."""
    then = None
    for step in steps:
        factors = [dense.link(step - 1, step, dense.rng.uniform(0.1, 2.0))]
        if step % 3 == 0:
            factors.append(dense.hold(step, dense.rng.uniform(0.5, 2.0)))
        prior, _ = smoother_update(prior, factors, start_at(dense, step), {step: step}, 20)
        prior, _ = marginalise(prior, keys({step, step - 1}), step - lag)
        if step == held_at:
            prior = hold(prior)
            then = prior, list(dense.factors)
    return prior, then


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 10_000), st.integers(2, 6), st.integers(0, 7))
def test_late_evidence_is_what_it_would_have_been_at_once(seed, held_at, later):
    dense = Dense(np.random.default_rng(seed))
    prior, _ = smoother_update(
        MarginalPrior(), [dense.hold(0, 0.5)], start_at(dense, 0), {0: 0}, 20
    )
    end = held_at + later
    prior, (prior_then, graph_then) = go_on(prior, dense, range(1, end + 1), held_at)
    assert set(prior.held) == keys({held_at, held_at - 1})
    # Found out: two old variables are linked, of which the smoother has let go long since.
    values = gtsam.Values()
    for number in range(held_at + 1):
        values.insert(velocity_key(number), np.zeros(3))
    link = dense.link(0, held_at - 1, 0.05)
    values = optimize(make_graph([*graph_then, link]), values, 20).values
    evidence = evidence_on(prior_then, values, graph_then, [*graph_then, link])
    grown = with_evidence(prior, evidence)
    expected, covariance = dense.solution(end + 1)
    for number in (end, end - 1):
        key = velocity_key(number)
        assert grown.values.atVector(key) == pytest.approx(expected[number], abs=1e-3)
        found = grown.covariance(key)
        assert found == pytest.approx(np.eye(3) * covariance[number, number], rel=1e-4)
    assert grown.held == ()


def chain(count):
    """A prior that has grown along poses with a fix at the first one; factors and optimum."""
    prior, factors, start = MarginalPrior(), [], gtsam.Values()
    for number, made, initial in drive(count):
        plain = [one for one in made if number == 0 or not isinstance(one, gtsam.GPSFactor)]
        factors += plain
        start.insert(initial)
        prior, _ = smoother_update(prior, plain, initial, {number: number}, 20)
        prior, _ = marginalise(prior, poses(number, max(number - 1, 0)), number - 5)
    return prior, factors, optimize(make_graph(factors), start, 50).values


def test_a_moved_prior_says_what_it_said():
    prior, _, _ = chain(8)
    there = gtsam.Pose3(gtsam.Rot3.Ypr(0.3, 0.0, 0.0), np.array([2.0, -1.0, 0.0]))
    there_and_back = moved(moved(prior, there), there.inverse())
    assert there_and_back.values.equals(prior.values, 1e-9)
    assert there_and_back.rhs == pytest.approx(prior.rhs, abs=1e-6)
    # Moved, and drawn back by what it knows of places: by the first pose alone, of which it has the
    # covariance. The step is linear, so that a small move shows it.
    small = gtsam.Pose3(gtsam.Rot3.Ypr(0.002, 0.0, 0.0), np.array([0.02, -0.01, 0.0]))
    back, _ = smoother_update(moved(prior, small), [], gtsam.Values(), {}, 20)
    assert back.values.equals(prior.values, 1e-4)
    known = prior.covariance(pose_key(7))
    assert moved(prior, there).covariance(pose_key(7)) == pytest.approx(known, rel=1e-9)


def test_a_loop_that_moves_the_map_leaves_nothing_to_fight_about():
    prior, before, values = chain(30)
    prior = hold(prior)
    # The 26th pose was seen from the third one, 4 degrees and more than a metre from where it was
    # thought: many standard deviations, so that all bends.
    off = gtsam.Pose3(gtsam.Rot3.Yaw(0.07), np.array([1.2, 0.9, 0.0]))
    seen = values.atPose3(pose_key(2)).between(values.atPose3(pose_key(25))).compose(off)
    ends = pose_key(2), pose_key(25)
    noise = np.diag(pose_sigmas(0.05, 0.003) ** 2)
    loop = between_factor(FactorKind.ODOMETRY, ends, seen, noise, 'loop', (2, 25)).factor
    after = optimize(make_graph([*before, loop]), values, 50).values
    evidence = evidence_on(prior, after, before, [*before, loop])
    newest = pose_key(29)
    grown = with_evidence(prior, evidence)
    apart = after.atPose3(newest).localCoordinates(grown.values.atPose3(newest))
    assert np.linalg.norm(evidence.T_new_old.translation()) > 0.5
    # A small part of a standard deviation of what was known without the loop.
    known = np.sqrt(np.diag(prior.covariance(newest)))
    assert np.all(np.abs(apart) < 0.02 * known), apart / known
    expected = gtsam.Marginals(make_graph([*before, loop]), after).marginalCovariance(newest)
    found = np.diag(grown.covariance(newest))
    assert np.sqrt(found) == pytest.approx(np.sqrt(np.diag(expected)), rel=0.05)


def test_nothing_is_held_once_released():
    prior = hold(chain(4)[0])
    assert release(prior).held == () and len(release(prior).spread) == 0
    assert prior.covariance(pose_key(3)) == pytest.approx(
        release(prior).covariance(pose_key(3)), abs=0.0
    )
