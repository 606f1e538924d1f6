"""The local map is turned into ENU by its GNSS track, once the track says where it points."""

from dataclasses import replace

import gtsam
import numpy as np
import pymap3d
import pytest
import turning_car as car
from scipy.spatial.transform import Rotation

from incremental_mapper.candidates.model import CoreKind, CoreMeasurement
from incremental_mapper.frontend.front_end import PreparedFix
from incremental_mapper.frontend.imu_preintegration import preintegration_parameters
from incremental_mapper.geometry import pose_matrix
from incremental_mapper.graph.factors import FactorKind, pose_prior
from incremental_mapper.mapping.commit import commit
from incremental_mapper.mapping.georeferencing import (
    agreeing_track,
    georeference,
    turn_prior,
    without_fixes,
)
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.measurements import FixStatus, GnssFix, ImuSample, LidarScan
from incremental_mapper.selection.base_graph import BaseGraph
from incremental_mapper.selection.window_problem import fix_spread, pose_problem
from incremental_mapper.settings import make_config
from incremental_mapper.smoothing.batch import make_graph
from incremental_mapper.smoothing.graph_state import GraphState, PlacedFix
from incremental_mapper.smoothing.linear_system import Layout
from incremental_mapper.variables import cluster_of, kind_of, pose_key

SECOND = 1_000_000_000
EPOCH = 1_544_676_777_000_000_000
ARM = np.array([-0.3, 0.4, 1.2])
DATUM = (36.5, 127.25, 50.0)
SPEED = 4.0


def square(seed=0):
    """Points on the ground and on four walls around the drive, in ENU."""
    rng = np.random.default_rng(seed)
    elements = [rng.uniform(-40, 40, size=(1200, 3)) for _ in range(5)]
    elements[0][:, 2] = -1.5
    for part, axis, place in zip(elements[1:], (0, 0, 1, 1), (-40, 40, -40, 40), strict=True):
        part[:, axis] = place
        part[:, 2] = rng.uniform(-1.5, 8, size=len(part))
    return np.vstack(elements)


SQUARE = square()


def truth(seconds, heading):
    """T_enu_base of a car that drives straight on."""
    way = np.array([np.cos(heading), np.sin(heading), 0.0]) * SPEED * seconds
    return gtsam.Pose3(gtsam.Rot3.Yaw(heading), way)


def drive(heading, seconds=3.0, orientation=None, fixes_per_second=4):
    turn = None if orientation is None else Rotation.from_euler('z', orientation).as_quat()
    made = []
    for i in range(round(seconds * 100)):
        force = np.array([0.0, 0.0, 9.81])
        made.append(ImuSample(EPOCH + i * SECOND // 100, 'imu', np.zeros(3), force, turn))
    for i in range(round(seconds * 10)):
        pose = truth(i / 10, heading)
        points = (SQUARE - pose.translation()) @ pose.rotation().matrix()
        made.append(LidarScan(EPOCH + i * SECOND // 10, 'left', points.astype(np.float32)))
    for i in range(round(seconds * fixes_per_second)):
        stamp = EPOCH + i * SECOND // fixes_per_second + 20_000_000
        antenna = truth((stamp - EPOCH) / SECOND, heading).transformFrom(ARM)
        place = map(float, pymap3d.enu2geodetic(*antenna, *DATUM))
        made.append(GnssFix(stamp, 'gps', *place, FixStatus.GBAS, np.eye(3) * 0.05**2))
    return sorted(made, key=lambda item: item.stamp)


def mapped(heading, measurements=None, datum=None, **kwargs):
    config = make_config(
        {
            'selection': {'strategy': 'min_time_shift'},
            'lidars': {'names': ['left']},
            'gnss': {'T_base_sensor': [*ARM, 0, 0, 0, 1]},
            'graph': {'lag': 0.5},
            'datum': datum or {},
        }
    )
    mapper = Mapper(config, ['left', 'gps', 'imu'])
    for item in drive(heading, **kwargs) if measurements is None else measurements:
        mapper.push(item)
    return mapper.finish()


@pytest.mark.parametrize('heading', [0.0, 1.2, -2.5])
def test_map_ends_in_enu_around_the_first_antenna_position_whatever_the_heading(heading):
    result = mapped(heading)
    assert result.stats['georeferenced']
    assert result.stats['components'] == 1
    first = truth(0.02, heading).transformFrom(ARM)
    for stamp, matrix in zip(result.trajectory.stamps, result.trajectory.matrices(), strict=True):
        pose = truth((stamp - EPOCH) / SECOND, heading)
        expected = gtsam.Pose3(pose.rotation(), pose.translation() - first)
        error = expected.localCoordinates(gtsam.Pose3(matrix))
        assert np.linalg.norm(error[3:]) < 0.2
        assert np.linalg.norm(error[:3]) < 0.03
    assert result.fixes[0] == pytest.approx(np.zeros(3), abs=1e-6)


def test_heading_of_the_imu_is_corrected_by_the_track():
    result = mapped(0.8, orientation=0.3)
    yaws = result.trajectory.rotations().as_euler('zyx')[:, 0]
    assert yaws == pytest.approx(np.full(len(yaws), 0.8), abs=0.03)


def test_short_drive_stays_in_its_local_frame():
    result = mapped(0.8, seconds=0.4, orientation=0.5)
    assert not result.stats['georeferenced']
    assert len(result.fixes) == 2
    yaws = result.trajectory.rotations().as_euler('zyx')[:, 0]
    # Two fixes a metre apart do not overrule the heading of the IMU.
    assert (np.abs(yaws - 0.5) < np.abs(yaws - 0.8)).all()


def test_drive_without_a_fix_starts_at_the_origin_with_the_heading_of_the_imu():
    result = mapped(0.8, seconds=1.0, orientation=0.5, fixes_per_second=0)
    assert not result.stats['georeferenced']
    assert result.fixes.shape == (0, 3)
    yaws = result.trajectory.rotations().as_euler('zyx')[:, 0]
    assert yaws == pytest.approx(np.full(len(yaws), 0.5), abs=2e-3)
    assert result.trajectory.positions[0] == pytest.approx(np.zeros(3), abs=1e-6)


def placed(east, sigma=0.05):
    enu = np.array([east, 0.0, 0.0])
    return PlacedFix(0, 0, enu, np.eye(3) * sigma**2, np.zeros(3), 0)


@pytest.mark.parametrize(
    ('east', 'sigma', 'enough'),
    [
        ([0.0, 1.9], 0.05, False),
        ([0.0, 2.1], 0.05, True),
        ([0.0, 2.1, 0.1], 0.05, True),
        ([0.0, 6.0], 1.0, False),
        ([0.0, 7.5], 1.0, True),
    ],
)
def test_track_must_be_longer_than_the_setting_and_than_its_noise(east, sigma, enough):
    track = np.array([[x, 0.0, 0.0] for x in east])
    turned = track @ Rotation.from_euler('z', 1.0).as_matrix().T
    found = agreeing_track(track, turned, np.full(len(track), sigma), 2.0)
    assert (found is not None) is enough
    if enough:
        assert found.tolist() == list(range(len(track)))


@pytest.mark.parametrize('wrong', [0, 2, 4])
def test_fix_that_disagrees_with_odometry_is_not_part_of_the_track(wrong):
    local = np.array([[1.5 * i, 0.1 * i, 0.0] for i in range(5)])
    enu = local + [100.0, -30.0, 0.0]
    enu[wrong] += [0.0, 60.0, 0.0]
    found = agreeing_track(enu, local, np.full(5, 0.05), 2.0)
    assert found.tolist() == [i for i in range(5) if i != wrong]


def test_fixes_that_all_disagree_make_no_track():
    local = np.array([[1.0 * i, 0.0, 0.0] for i in range(3)])
    enu = np.array([[0.0, 0.0, 0.0], [70.0, 0.0, 0.0], [0.0, 150.0, 0.0]])
    assert agreeing_track(enu, local, np.full(3, 0.05), 2.0) is None


def test_fix_is_trusted_the_less_the_further_it_is_from_the_first_while_the_yaw_is_unknown():
    items = [
        PreparedFix(
            CoreMeasurement(stamp, 'gps', CoreKind.GNSS), np.array([east, 0.0, 9.0]), np.eye(3)
        )
        for stamp, east in ((1, 0.5), (2, 1.5))
    ]
    assert fix_spread(GraphState(), items) == {1: (0.0, 0.0), 2: pytest.approx((2.0, 0.0))}
    known = GraphState(fixes=[placed(0.0)])
    assert fix_spread(known, items) == {1: pytest.approx((1.0, 0.0)), 2: pytest.approx((3.0, 0.0))}
    assert fix_spread(GraphState(georeferenced=True), items) == {}
    assert fix_spread(GraphState(), []) == {}
    doubtful = [replace(items[0], doubtful=True)]
    assert fix_spread(GraphState(georeferenced=True), doubtful) == {1: (1e4, 1e4)}


# What is turned, on a graph whose every number is known.

TURNED = gtsam.Pose3(gtsam.Rot3.Yaw(1.1), np.array([12.0, -30.0, 4.0]))
"""T_enu_map of the drives below: ENU does not lie in the map as the fixes were first taken to."""
SECONDS = tuple(range(200, 2000, 200))


def enu_fix(stamp):
    """A fix as the receiver gives it, more precise to the east than to the north."""
    core = CoreMeasurement(stamp, 'gps', CoreKind.GNSS)
    antenna = TURNED.transformFrom(car.truth(stamp).transformFrom(car.ARM))
    return PreparedFix(core, antenna, np.diag([0.04, 0.09, 0.25]) ** 2)


def driven_car(lag=0.7):
    """G(t) of a turning car whose map is not ENU yet, with a hole in the IMU on the way."""
    graph = {'lag': lag, 'weak_sigma_position': 0.6}
    config = car.settings(graph=graph, preintegration={'max_gap': 0.3})
    parameters = preintegration_parameters(config.preintegration, config.imu.matrix())
    state = car.known_state()
    state.enu_offset = None
    last = 0
    for number, milliseconds in enumerate(SECONDS):
        stamp = milliseconds * car.MS
        items = [car.scan(stamp, 'left', last), enu_fix(stamp + 20 * car.MS)]
        last = stamp
        # No sample around the third window: its chain is carried over from the second.
        begin = (milliseconds - 230) * car.MS
        series = car.imu_series(begin, stamp + 100 * car.MS)
        if number == 2:
            series = series.since(stamp + 1)
        problem = pose_problem(items, state, series, None, parameters, config)
        commit(state, number, BaseGraph().select(problem), problem)
    return state, config


def test_everything_is_turned_into_enu_and_fixes_count_in_full():
    state, config = driven_car()
    before = {key: factor for key, factor in enumerate(state.factors)}
    velocity_before = state.last_velocity
    arms = [fix.lever_arm for fix in state.fixes]
    assert not state.georeferenced
    assert {FactorKind.CONSTANT_VELOCITY, FactorKind.PRIOR_VELOCITY, FactorKind.PRIOR_POSE} <= {
        factor.kind for factor in before.values()
    }
    assert georeference(state, config)
    assert state.georeferenced and state.enu_offset.tolist() == [0.0] * 3
    assert not georeference(state, config)

    turn = TURNED.rotation()
    for placed in state.clusters:
        expected = TURNED.compose(car.truth(placed.cluster.stamp))
        car.assert_poses(state.pose(placed.id), expected, 0.1, 0.01)
        if state.has_inertial(placed.id):
            expected = turn.rotate(car.velocity(placed.cluster.stamp))
            assert state.velocity(placed.id) == pytest.approx(expected, abs=0.2)
    # Turned as it was, not looked up again.
    assert state.last_velocity == pytest.approx(turn.rotate(velocity_before), abs=0.2)
    assert np.linalg.norm(state.last_velocity) == pytest.approx(np.linalg.norm(velocity_before))

    assert len(state.factors) == len(before)
    for place, factor in enumerate(state.factors):
        old = before[place]
        assert (factor.kind, factor.keys, factor.stamps, factor.sensor) == (
            old.kind,
            old.keys,
            old.stamps,
            old.sensor,
        )
        if factor.kind is FactorKind.GNSS:
            seen = enu_fix(factor.stamps[0])
            assert factor.data['position'] == seen.enu.tolist()
            assert np.array(factor.data['covariance']) == pytest.approx(seen.covariance)
            assert factor.data['lever_arm'] == old.data['lever_arm']
        elif factor.kind is FactorKind.PRIOR_VELOCITY:
            expected = turn.rotate(np.array(old.data['velocity']))
            assert factor.data['velocity'] == pytest.approx(expected, abs=0.1)
            assert factor.data['sigma'] == old.data['sigma']
        elif factor.kind is FactorKind.CONSTANT_VELOCITY:
            expected = turn.rotate(np.array(old.data['change']))
            assert factor.data['change'] == pytest.approx(expected, abs=0.1)
            assert factor.data['sigma'] == old.data['sigma']
            assert np.linalg.norm(expected - old.data['change']) > 0.3
        elif factor.kind is FactorKind.PRIOR_POSE:
            pose = TURNED.compose(gtsam.Pose3(pose_matrix(old.data['T_map_base'])))
            found = gtsam.Pose3(pose_matrix(factor.data['T_map_base']))
            car.assert_poses(found, pose, 0.1, 0.01)
            # Level stays as well known as it was, the rest is left to the fixes.
            assert factor.data['sigmas'][:3] == [*old.data['sigmas'][:2], 0.3]
            assert min(factor.data['sigmas'][3:]) >= 0.6
        else:
            assert factor is old
    for fix, arm in zip(state.fixes, arms, strict=True):
        assert state.factors[fix.factor].kind is FactorKind.GNSS
        assert fix.lever_arm.tolist() == arm.tolist()


def test_newest_part_of_the_turned_graph_still_changes_and_is_as_certain_as_the_graph_says():
    state, config = driven_car(lag=0.7)
    assert georeference(state, config)
    newest = state.frontier.newest_stamp
    recent = {c.id for c in state.clusters if c.cluster.stamp >= newest - 700 * car.MS}
    # An older scan that the next one may still be matched to stays as well.
    chained = {id_ for id_, _ in state.frontier.chains.values()}
    # So does the one whose bias still serves.
    assert set(state.prior.clusters) == recent | chained | {state.frontier.bias}
    assert set(state.prior.keys) <= state.frontier.keys()
    whole = state.all_values()
    graph = make_graph(factor.factor for factor in state.factors)
    keys = sorted(whole.keys())
    ordering = gtsam.Ordering()
    for key in keys:
        ordering.push_back(key)
    information, _ = graph.linearize(whole).hessian(ordering)
    scale = 1.0 / np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information * scale * scale[:, None]) * scale * scale[:, None]
    columns = Layout(keys)
    for key in state.prior.keys:
        own = columns.columns([key])
        expected = covariance[np.ix_(own, own)]
        if kind_of(key) == 'v':
            # As the vehicle sees it: what is not known of its attitude has a part in it.
            both = columns.columns([pose_key(cluster_of(key)), key])
            R_base_map = state.pose(cluster_of(key)).rotation().matrix().T
            turn = gtsam.Rot3.Hat(R_base_map @ state.velocity(cluster_of(key)))
            seen = np.hstack([turn, np.zeros((3, 3)), R_base_map])
            expected = seen @ covariance[np.ix_(both, both)] @ seen.T
        apart = np.abs(state.prior.covariance(key) - expected).max()
        assert apart <= 0.02 * np.abs(expected).max()


def test_too_few_fixes_or_too_short_a_track_turn_nothing():
    state, config = driven_car()
    fixes = list(state.fixes)
    state.fixes[:] = fixes[:1]
    assert not georeference(state, config)
    state.fixes[:] = fixes
    far = car.settings(fixes={'min_distance': 1000.0})
    assert not georeference(state, far)
    assert not state.georeferenced


def test_only_the_newest_fixes_are_looked_at():
    # A car that stood for long: 45 fixes in one place, none of which tells the yaw.
    state, config = driven_car()
    moving = list(state.fixes)
    state.fixes[:] = [*moving, *([moving[0]] * 40)]
    assert not georeference(state, config)
    state.fixes[:] = [*moving, *([moving[0]] * 38)]
    assert georeference(state, config)


@pytest.mark.parametrize(('short', 'long', 'agree'), [(2.0, 11.0, True), (2.0, 11.001, False)])
def test_ways_agree_up_to_five_times_and_a_metre(short, long, agree):
    one, other = (np.array([[0.0, 0.0, 0.0], [way, 0.0, 0.0]]) for way in (short, long))
    for enu, local in ((one, other), (other, one)):
        found = agreeing_track(enu, local, np.zeros(2), 1.0)
        assert (found is not None) == agree


@pytest.mark.parametrize(('sigma', 'agree'), [(0.1, False), (0.2, True)])
def test_noise_of_the_fixes_makes_up_for_some_of_the_way(sigma, agree):
    # The two together are off by five times 0.14 m, or 0.28 m.
    enu = np.array([[0.0, 0.0, 0.0], [12.0, 0.0, 50.0]])
    local = np.array([[0.0, 0.0, 0.0], [0.0, 2.0, -50.0]])
    assert (agreeing_track(enu, local, np.full(2, sigma), 1.0) is not None) == agree


@pytest.mark.parametrize(('distance', 'far'), [(1.999, True), (2.0, False)])
def test_track_is_longer_than_the_least_distance(distance, far):
    track = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    assert (agreeing_track(track, track, np.zeros(2), distance) is not None) == far


def test_fixes_that_proved_wrong_leave_the_graph_and_it_is_as_without_them():
    state, config = driven_car()
    clean, _ = driven_car()
    assert georeference(clean, config)
    wrong = {state.fixes[i].stamp for i in (0, 3)}
    shift = np.array([-2000.0, 700.0, 40.0])
    for i in (0, 3):
        factor = state.fixes[i].factor
        bad = state.fixes[i].enu + np.array([500.0, 0.0, 20.0])
        state.fixes[i] = replace(state.fixes[i], enu=bad)
        assert state.factors[factor].kind is FactorKind.GNSS
    before = len(state.factors)
    without_fixes(state, config, wrong, lambda enu: enu + shift)
    assert not state.georeferenced and len(state.factors) == before - 2
    assert state.factor_counts['gnss'] == len(state.fixes) == len(clean.fixes) - 2
    assert all(state.factors[fix.factor].stamps == (fix.stamp,) for fix in state.fixes)
    assert georeference(state, config)
    for placed in state.clusters:
        pose = state.pose(placed.id)
        back = gtsam.Pose3(pose.rotation(), pose.translation() - shift)
        car.assert_poses(back, clean.pose(placed.id), 0.1, 0.01)


@pytest.mark.parametrize(('far', 'least', 'most'), [(0.0, 1.0, 1.0), (80.0, 23.0, 25.0)])
def test_where_a_drive_began_far_from_its_first_fixes_is_not_held(far, least, most):
    """Its place hangs on the yaw that they tell, which may be wrong by some tenths."""
    prior = pose_prior(pose_key(0), gtsam.Pose3(), np.full(6, 0.05), EPOCH)
    turned = turn_prior(prior, gtsam.Pose3(), make_config({}), np.array([far, 0.0, 0.0]))
    sigmas = np.array(turned.data['sigmas'])
    assert np.all((least <= sigmas[3:]) & (sigmas[3:] <= most))
    assert sigmas[:2] == pytest.approx([0.05, 0.05]) and sigmas[2] == pytest.approx(0.3)
