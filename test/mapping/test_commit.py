"""A window's winner becomes part of G(t): its numbers, its measurements, and what comes next."""

from dataclasses import replace

import numpy as np
import pytest
from turning_car import (
    ARM,
    LANDMARKS,
    MS,
    assert_poses,
    fix,
    imu_series,
    known_state,
    motion,
    own_biases,
    problem_of,
    scan,
    truth,
    velocity,
)
from turning_car import settings as car_settings

from incremental_mapper.candidates.enumeration import base_candidate, candidates
from incremental_mapper.frontend.imu_preintegration import preintegration_parameters
from incremental_mapper.geometry import transform_points
from incremental_mapper.graph.factors import FactorKind
from incremental_mapper.mapping.commit import NOTHING, commit
from incremental_mapper.selection.base_graph import BaseGraph
from incremental_mapper.selection.choice import Choice
from incremental_mapper.selection.lowest_score import LowestScore
from incremental_mapper.selection.window_problem import pose_problem
from incremental_mapper.smoothing.batch import squared_error
from incremental_mapper.variables import bias_key, cluster_of, pose_key, velocity_key

WINDOW = {40 * MS: {'left'}, 62 * MS: {'gps'}, 97 * MS: {'right'}, 140 * MS: {'left'}}


def chosen(problem, wanted):
    """The choice of a strategy that only one candidate pleases, with its solution."""
    strategy = LowestScore.of('wanted', lambda proposal: float(proposal.candidate != wanted))
    choice = strategy.select(problem)
    assert choice.winner == wanted
    return choice


def unsolved(candidate, **changes):
    choice = Choice(candidate, None, '', 1, 1, 0, False, {}, ())
    return replace(choice, **changes)


def candidate_with(problem, *bounds):
    """The first connected candidate whose clusters have these first and last elements."""
    return next(
        item
        for item in candidates(problem.elements, problem.head, problem.imu)
        if tuple((cluster.first, cluster.last) for cluster in item.clusters) == bounds
        and not problem.unconnected(item)
    )


GROUPS = ((0, 1), (2, 2), (3, 3)), ((0, 0), (1, 2), (3, 3)), ((0, 2), (3, 3))


@pytest.mark.parametrize('bounds', GROUPS)
@pytest.mark.parametrize('solved', [True, False])
def test_merged_measurements_are_remembered_where_they_were_taken(bounds, solved):
    state = known_state()
    problem = problem_of(WINDOW, state)
    candidate = candidate_with(problem, *bounds)
    choice = chosen(problem, candidate) if solved else unsolved(candidate)
    committed = commit(state, 7, choice, problem)
    assert [item.id for item in committed.placed] == list(range(1, 1 + len(bounds)))
    assert {item.window for item in committed.placed} == {7}
    assert [item.cluster for item in committed.placed] == list(candidate.clusters)
    assert state.clusters[1:] == list(committed.placed)
    for item in committed.placed:
        assert_poses(state.pose(item.id), truth(item.cluster.stamp), 0.01, 1e-3)
    for placed in state.scans[2:]:
        stamp = state.clusters[placed.cluster].cluster.stamp
        assert_poses(placed.T_cluster_scan, motion(stamp, placed.stamp))
        pose = state.pose(placed.cluster).compose(placed.T_cluster_scan).matrix()
        assert transform_points(pose, placed.points) == pytest.approx(LANDMARKS, abs=0.1)
    assert [(item.sensor, item.stamp) for item in state.scans[2:]] == [
        ('left', 40 * MS),
        ('right', 97 * MS),
        ('left', 140 * MS),
    ]
    assert [item for item, _ in state.recent] == state.scans
    assert list(state.recent)[-1][1] == pytest.approx(scan(140 * MS).sparse)
    (seen,) = state.fixes
    assert seen.enu.tolist() == fix(62 * MS).enu.tolist()
    assert seen.covariance.tolist() == fix(62 * MS).covariance.tolist()
    antenna = state.pose(seen.cluster).transformFrom(seen.lever_arm)
    assert antenna == pytest.approx(truth(62 * MS).transformFrom(ARM), abs=0.02)
    factor = state.factors[seen.factor]
    assert factor.kind is FactorKind.GNSS and factor.stamps == (62 * MS,)
    assert factor.keys == (pose_key(seen.cluster),)
    assert factor.data['lever_arm'] == seen.lever_arm.tolist()


@pytest.mark.parametrize('solved', [True, False])
def test_every_factor_is_about_variables_that_are_there_and_their_error_is_told(solved):
    state = known_state(sigma=0.05)
    problem = problem_of(WINDOW, state)
    (seen,) = [item for item in problem.inputs.prepared.values() if item.core.kind == 'gnss']
    seen.enu[:] += [0.2, 0.1, -0.1]
    before = len(state.factors)
    candidate = candidate_with(problem, *GROUPS[0])
    choice = chosen(problem, candidate) if solved else unsolved(candidate)
    committed = commit(state, 1, choice, problem)
    made = state.factors[before:]
    assert len(made) == len(problem.factors.factors(candidate))
    values = state.all_values()
    for factor in made:
        assert tuple(factor.factor.keys()) == factor.keys
        assert all(values.exists(key) for key in factor.keys)
    plain = [factor.factor for factor in made]
    assert committed.error == pytest.approx(squared_error(plain, values), rel=1e-4)
    assert committed.error > 1.0
    assert set(map(cluster_of, values.keys())) == {0, 1, 2, 3}
    assert state.inertial == {0} | {item + 1 for item in candidate.inertial_clusters if item >= 0}
    assert state.factor_counts[FactorKind.ODOMETRY] == 3
    assert state.factor_counts[FactorKind.GNSS] == 1
    assert NOTHING.placed == () and NOTHING.error == 0.0


def test_next_window_starts_from_the_newest_cluster_with_velocity():
    state = known_state()
    problem = problem_of(WINDOW, state)
    candidate = candidate_with(problem, *GROUPS[0])
    commit(state, 1, chosen(problem, candidate), problem)
    frontier = state.frontier
    assert frontier.newest == 3 and frontier.newest_stamp == 140 * MS
    assert frontier.head == frontier.inertial == 3
    assert frontier.head_stamp == frontier.inertial_stamp == 140 * MS
    assert frontier.head_inertial
    assert frontier.chains == {'left': (3, 140 * MS), 'right': (2, 97 * MS)}
    assert set(state.scan_offsets) == {('left', 140 * MS), ('right', 97 * MS)}
    assert state.last_velocity == pytest.approx(velocity(140 * MS), abs=0.05)
    assert set(state.prior.keys) == {
        *(pose_key(number) for number in (2, 3)),
        velocity_key(3),
        bias_key(0),
    }
    assert (frontier.bias, frontier.bias_stamp) == (0, 0)


def test_a_bias_that_has_served_gives_way_to_one_of_the_window():
    state = known_state()
    problem = problem_of(WINDOW, state, car_settings(graph={'bias_period': 0.03}))
    commit(state, 1, chosen(problem, candidate_with(problem, *GROUPS[0])), problem)
    assert (state.frontier.bias, state.frontier.bias_stamp) == (1, 0)
    assert state.biased == {0, 1} and len(state.inertial) == 4
    assert bias_key(1) in state.prior.keys and bias_key(0) not in state.prior.keys


def test_each_end_of_a_span_has_a_bias_where_none_is_shared():
    state = known_state()
    problem = problem_of(WINDOW, state, own_biases())
    commit(state, 1, chosen(problem, candidate_with(problem, *GROUPS[0])), problem)
    frontier = state.frontier
    assert (frontier.bias, frontier.bias_stamp) == (frontier.inertial, frontier.inertial_stamp)
    assert state.biased == state.inertial
    assert bias_key(3) in state.prior.keys


def test_chain_goes_on_from_a_scan_inside_a_merged_cluster():
    state = known_state()
    problem = problem_of(WINDOW, state)
    commit(state, 1, chosen(problem, candidate_with(problem, (0, 2), (3, 3))), problem)
    assert state.frontier.chains['right'] == (1, 97 * MS)
    stamp = state.clusters[1].cluster.stamp
    assert stamp != 97 * MS
    offset = state.scan_offsets['right', 97 * MS]
    assert_poses(offset, motion(stamp, 97 * MS))
    # The next window's odometry starts where that scan stands.
    config = problem.config
    parameters = preintegration_parameters(config.preintegration, config.imu.matrix())
    items = [scan(190 * MS, 'right', 97 * MS)]
    series = imu_series(130 * MS, 300 * MS)
    following = pose_problem(items, state, series, None, parameters, config)
    single = base_candidate(following.elements, following.head, following.imu)
    factors = following.factors.factors(single)
    (odometry,) = [factor for factor in factors if factor.kind is FactorKind.ODOMETRY]
    assert odometry.keys[0] == pose_key(1)
    assert_poses(odometry.factor.measured(), motion(stamp, 190 * MS))


def test_scan_that_cannot_be_matched_to_is_no_link_of_the_chain():
    state = known_state()
    config = car_settings()
    parameters = preintegration_parameters(config.preintegration, config.imu.matrix())
    items = [scan(40 * MS, 'left', 0, usable=False), scan(90 * MS, 'right', -30 * MS)]
    series = imu_series(-50 * MS, 200 * MS)
    problem = pose_problem(items, state, series, None, parameters, config)
    base = base_candidate(problem.elements, problem.head, problem.imu)
    commit(state, 1, unsolved(base), problem)
    assert state.frontier.chains == {'left': (0, 0), 'right': (2, 90 * MS)}


@pytest.mark.parametrize(('gap', 'known'), [(0.139, {'left'}), (0.14, {'left', 'right'})])
def test_scan_that_is_too_old_to_be_matched_to_is_forgotten(gap, known):
    config = car_settings(odometry={'max_gap': gap + 0.03})
    state = known_state()
    problem = problem_of({140 * MS: {'left'}}, state, config)
    base = base_candidate(problem.elements, problem.head, problem.imu)
    commit(state, 1, unsolved(base), problem)
    assert set(state.frontier.chains) == known


def committed_base(state, stamps, series, config=None):
    config = car_settings() if config is None else config
    problem = problem_of(stamps, state, config, series)
    commit(state, 1, BaseGraph().select(problem), problem)
    return state.frontier


def test_base_connects_from_the_newest_cluster_whatever_it_has():
    # Samples end before the last cluster: it has no velocity.
    state = known_state()
    series = imu_series(-50 * MS, 60 * MS, 10 * MS)
    config = car_settings(preintegration={'max_gap': 0.05})
    frontier = committed_base(state, {40 * MS: {'left'}, 140 * MS: {'left'}}, series, config)
    assert (frontier.head, frontier.head_stamp, frontier.head_inertial) == (2, 140 * MS, False)
    assert (frontier.inertial, frontier.inertial_stamp) == (1, 40 * MS)


@pytest.mark.parametrize(
    ('end', 'max_gap', 'head'),
    [
        (40, 0.1, 1),  # no sample between the head and the newest: a span may still come
        (40, 0.099, 2),  # but not across such a hole
        (41, 0.1, 2),  # a sample in between was in no span that a strategy of one's own took
    ],
)
def test_chain_starts_anew_where_the_old_head_cannot_be_connected_any_more(end, max_gap, head):
    state = known_state()
    config = car_settings(preintegration={'max_gap': max_gap})
    series = imu_series(-50 * MS, end * MS, 1 * MS)
    stamps = {40 * MS: {'left'}, 140 * MS: {'left'}}
    problem = problem_of(stamps, state, config, series)
    candidate = next(
        item
        for item in candidates(problem.elements, problem.head, problem.imu)
        if len(item.clusters) == 2 and item.connections[0].end == 0
    )
    candidate = replace(candidate, connections=candidate.connections[:1])
    commit(state, 1, unsolved(candidate), problem)
    frontier = state.frontier
    assert frontier.head == head
    assert frontier.head_inertial == (head == 1)
    assert frontier.inertial == 1 and frontier.inertial_stamp == 40 * MS
    assert frontier.newest == 2


def test_velocity_is_the_predicted_one_where_the_graph_has_none():
    state = known_state(head_inertial=False)
    frontier = committed_base(state, {40 * MS: {'left'}}, imu_series(0, 0))
    assert not frontier.head_inertial
    assert state.last_velocity == pytest.approx(velocity(0))
    assert not state.velocity_known


def test_what_is_older_than_the_lag_no_longer_changes():
    state = known_state()
    config = own_biases(graph={'lag': 0.07})
    problem = problem_of(WINDOW, state, config)
    commit(state, 1, chosen(problem, candidate_with(problem, *GROUPS[0])), problem)
    # 140 ms less 70 ms: what is at 62 ms and before has left.
    assert set(state.prior.clusters) == {2, 3}
    assert state.values.exists(pose_key(1)) and state.values.exists(pose_key(0))
    assert_poses(state.pose(1), truth(state.clusters[1].cluster.stamp), 0.01, 1e-3)
    assert_poses(state.pose(0), truth(0), 0.01, 1e-3)


def test_bridge_holds_what_nothing_connects():
    state = known_state()
    series = imu_series(-50 * MS, 10 * MS)
    problem = problem_of({40 * MS: {'gps'}}, state, series=series)
    bare = base_candidate(problem.elements, None, problem.imu)
    bare = replace(bare, connections=())
    tie = problem.factors.bridge(bare.clusters[0], bare.clusters[0], state.pose(0))
    committed = commit(state, 1, unsolved(bare, extra=(tie,)), problem)
    assert committed.placed[0].id == 1
    assert state.factors[-1].kind is FactorKind.BRIDGE
    assert state.factors[-1].keys == (pose_key(0), pose_key(1))
    assert state.components.n_subsets == 3  # the poses, and velocity and bias of the first
    assert np.isfinite(state.pose(1).matrix()).all()
