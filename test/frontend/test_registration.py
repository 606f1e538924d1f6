"""Scan matching recovers known motions, and the front end counts what it cannot match."""

import pickle
from collections import Counter

import gtsam
import numpy as np
import pytest
import small_gicp
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from incremental_mapper.config import OdometryMethod, OdometrySettings, make_config
from incremental_mapper.frontend.front_end import FrontEnd, PreparedFix
from incremental_mapper.frontend.preprocessing import Sweep, Twist, deskew, to_base
from incremental_mapper.frontend.registration import make_matcher
from incremental_mapper.frontend.scan_preparation import PreparedScan, ScanPreparer
from incremental_mapper.measurements import FixStatus, GnssFix, LidarScan
from incremental_mapper.voxels import thin, voxel_means

SECOND = 1_000_000_000
EPOCH = 1_544_676_777_000_000_000
METHODS = list(OdometryMethod)
STEP = gtsam.Pose3(gtsam.Rot3.Ypr(0.02, 0.003, -0.002), np.array([0.4, 0.05, 0.01]))


def room(count=6000, seed=0):
    """Random points on the floor and on two walls of a room of 30 m, in the room's frame."""
    rng = np.random.default_rng(seed)
    walls = []
    for axis in range(3):
        points = rng.uniform(0.0, 30.0, size=(count // 3, 3))
        points[:, axis] = rng.normal(scale=0.005, size=count // 3)
        walls.append(points)
    return np.vstack(walls) - np.array([12.0, 14.0, 2.0])


def seen_from(pose, points):
    """What a car at ``pose`` sees of the room."""
    return (points - pose.translation()) @ pose.rotation().matrix()


def poses(count, step=STEP):
    track = [gtsam.Pose3()]
    for _ in range(count - 1):
        track.append(track[-1].compose(step))
    return track


def assert_close(found, expected, metres, radians):
    error = expected.localCoordinates(found)
    assert np.linalg.norm(error[3:]) < metres
    assert np.linalg.norm(error[:3]) < radians


@pytest.mark.parametrize('method', METHODS)
def test_known_motion_is_recovered_as_the_pose_of_the_current_scan_in_the_previous(method):
    matcher = make_matcher(OdometrySettings(method=method))
    # Every scan samples the walls anew, as a turning LiDAR does.
    matches = [
        matcher.match(seen_from(pose, room(seed=i)), STEP) for i, pose in enumerate(poses(6))
    ]
    assert matches[0] is None
    for match in matches[1:]:
        assert match.overlap > 0.5
        assert_close(match.T_previous_current, STEP, 0.05, 0.005)
        assert match.T_previous_current.x() > 0.3  # forwards, not backwards


@pytest.mark.parametrize('scans', [1, 4])
def test_gicp_finds_the_motion_without_a_guess_scan_to_scan_and_on_a_sliding_map(scans):
    settings = OdometrySettings(method=OdometryMethod.GICP, local_map_scans=scans)
    matcher = make_matcher(settings)
    for i, pose in enumerate(poses(6)):
        match = matcher.match(seen_from(pose, room(seed=i)), gtsam.Pose3())
        if i:
            assert_close(match.T_previous_current, STEP, 0.03, 0.003)


@pytest.mark.parametrize('method', METHODS)
def test_standing_car_does_not_move(method):
    matcher = make_matcher(OdometrySettings(method=method))
    for i in range(4):
        match = matcher.match(room(seed=i), gtsam.Pose3())
        if i:
            assert_close(match.T_previous_current, gtsam.Pose3(), 0.05, 0.005)


def test_gicp_matches_what_is_near():
    matcher, alone = (
        make_matcher(OdometrySettings(method='gicp', match_range=45)) for _ in range(2)
    )
    for i, pose in enumerate(poses(3)):
        near, far = seen_from(pose, room(seed=i)), room(seed=i) + [80.0, 0.0, 0.0]
        found = matcher.match(np.vstack([near, far]), STEP), alone.match(near, STEP)
        if i:
            assert_close(*(item.T_previous_current for item in found), 1e-9, 1e-9)


def test_gicp_matches_what_is_far_where_nothing_else_is_seen():
    matcher = make_matcher(OdometrySettings(method=OdometryMethod.GICP, match_range=45))
    for i, pose in enumerate(poses(3)):
        match = matcher.match(seen_from(pose, room(seed=i) + np.array([80.0, 0.0, 0.0])), STEP)
        if i:
            assert match.overlap > 0.5
            assert_close(match.T_previous_current, STEP, 0.1, 0.005)


# Clouds.

component = st.floats(-30.0, 30.0)


@settings(deadline=None)
@given(
    linear=st.tuples(component, component, component),
    angular=st.one_of(
        st.tuples(component, component, component),
        st.tuples(*[st.floats(-1e-9, 1e-9)] * 3),
    ),
    moment=st.floats(-0.2, 0.2),
    seed=st.integers(0, 1000),
)
def test_deskewing_is_the_rotation_and_the_translation_since_the_moment(
    linear, angular, moment, seed
):
    rng = np.random.default_rng(seed)
    rows, times = rng.uniform(-80.0, 80.0, (3, 40)), rng.uniform(-0.2, 0.2, 40)
    twist = Twist(np.array(linear), np.array(angular))
    found = deskew(Sweep(EPOCH, 'left', rows, times), twist, moment)
    since = (times - moment)[:, None]
    expected = Rotation.from_rotvec(since * twist.angular).apply(rows.T) + since * twist.linear
    assert found == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize('scale', [1.0, 1e3, 1e7], ids=['few', 'many', 'too_many_to_number'])
def test_thinned_points_are_the_means_of_their_voxels(scale):
    points = np.vstack([room(3000), room(20, seed=1) * scale])
    found = {tuple(np.floor(point / 0.5)): point for point in thin(points, 0.5)}
    cells = np.floor(points / 0.5)
    assert set(found) == set(map(tuple, cells))
    for cell, point in found.items():
        assert point == pytest.approx(points[(cells == cell).all(axis=1)].mean(axis=0), rel=1e-12)


def test_thinning_agrees_with_the_sampler_of_small_gicp_and_takes_further_rows_along():
    points = room(3000)
    expected = small_gicp.voxelgrid_sampling(points, 0.7).points()[:, :3]
    means = voxel_means(np.vstack([points.T, points[:, 0] * 2.0]), 0.7)
    order, other = (np.lexsort(table.T) for table in (means[:3].T, expected))
    assert means[:3].T[order] == pytest.approx(expected[other], abs=1e-9)
    assert means[3] == pytest.approx(means[0] * 2.0)


@pytest.mark.parametrize('far', [0.0, 1e7], ids=['numbered_voxels', 'too_many_to_number'])
def test_voxels_come_in_the_order_of_their_last_points(far):
    points = np.vstack([room(3000), np.full((1, 3), far)])
    last = {tuple(np.floor(point / 0.5)): i for i, point in enumerate(points)}
    found = [last[tuple(np.floor(point / 0.5))] for point in thin(points, 0.5)]
    assert found == sorted(last.values())


def test_nothing_is_thinned_to_nothing():
    assert thin(np.zeros((0, 3)), 0.5).shape == (0, 3)


def test_deskewing_thinned_points_is_thinning_deskewed_ones_to_a_few_millimetres():
    rng = np.random.default_rng(3)
    # Neighbours of all times, as where a sweep's start meets its end, in a fast bend.
    points, times = room(3000).astype(np.float32), rng.uniform(-0.1, 0.0, 3000).astype(np.float32)
    twist = Twist(np.array([15.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.5]))
    raw = to_base(LidarScan(EPOCH, 'left', points, times), np.eye(4), 0.0, 80.0, 1e-3)
    sweep = to_base(LidarScan(EPOCH, 'left', points, times), np.eye(4), 0.0, 80.0, 0.2)
    exact = deskew(raw, twist, 0.0)
    cells, own = np.floor(raw.rows.T / 0.2), np.floor(sweep.rows.T / 0.2)
    for cell, point in zip(own, deskew(sweep, twist, 0.0), strict=True):
        mates = exact[(cells == cell).all(axis=1)]
        if len(mates):
            assert np.linalg.norm(point - mates.mean(axis=0)) < 0.005


# The front end.


def scan(seconds, points, sensor='left'):
    return LidarScan(EPOCH + round(seconds * SECOND), sensor, points.astype(np.float32))


def front_end(**odometry):
    return FrontEnd(make_config({'odometry': odometry, 'lidars': {'left': {}, 'right': {}}}))


def drive(end, times, sensor='left'):
    """Prepared scans of a car that moves by STEP every 0.1 s."""
    prepared = []
    for seconds in times:
        pose = gtsam.Pose3.Expmap(gtsam.Pose3.Logmap(STEP) * (seconds * 10))
        prepared += end.prepare((scan(seconds, seen_from(pose, room(seed=round(seconds * 10)))),))
    return prepared


def stamp(seconds):
    return EPOCH + round(seconds * SECOND)


@pytest.mark.parametrize('method', METHODS)
def test_first_scan_of_a_lidar_has_no_odometry_and_the_next_ones_have(method):
    found = drive(front_end(method=method), [0.0, 0.1, 0.2, 0.3])
    assert [item.previous for item in found] == [None, stamp(0.0), stamp(0.1), stamp(0.2)]
    assert found[0].T_previous_current is None
    for item in found[1:]:
        assert_close(item.T_previous_current, STEP, 0.05, 0.005)


def test_each_lidar_is_matched_to_itself():
    end = front_end()
    cloud = room()
    core = tuple(scan(t, cloud, name) for t, name in ((0, 'left'), (0.03, 'right'), (0.1, 'left')))
    found = end.prepare(core)
    assert [item.previous for item in found] == [None, None, stamp(0)]


def test_scan_out_of_range_is_dropped_and_counted():
    end = front_end(min_range=2.5, max_range=50.0)
    near = np.full((200, 3), 0.5)
    far = np.full((200, 3), 100.0)
    assert end.prepare((scan(0, near), scan(0.1, far))) == []
    assert end.drops == {('left', 'no_points_in_range'): 2}
    assert not end.notes


def test_small_scan_is_kept_without_odometry_and_the_chain_goes_on_around_it():
    end = front_end()
    found = drive(end, [0.0, 0.1])
    found += end.prepare((scan(0.2, room()[:20] + np.array([5.0, 0, 0])),))
    found += drive(end, [0.3])
    assert [item.previous for item in found] == [None, stamp(0.0), None, stamp(0.1)]
    assert found[2].T_previous_current is None
    assert len(found[2].thinned) > 0
    assert_close(found[3].T_previous_current, STEP.compose(STEP), 0.05, 0.005)
    assert end.notes == {'left: too few points to match': 1}
    assert not end.drops


def test_scans_too_far_apart_are_not_matched_and_counted():
    end = front_end(max_gap=1.0)
    found = drive(end, [0.0, 0.1, 2.0, 2.1])
    assert [item.previous for item in found] == [None, stamp(0.0), None, stamp(2.0)]
    assert end.notes == {'left: gap too long to match': 1}
    assert_close(found[3].T_previous_current, STEP, 0.05, 0.005)


def test_match_that_no_car_could_drive_is_rejected_and_the_chain_starts_anew():
    # The room jumps by 3 m between two scans: nothing but a wrong match says so.
    end = front_end(max_correspondence=10.0)
    found = drive(end, [0.0, 0.1, 0.2])
    cloud = room(seed=9)
    away = gtsam.Pose3(gtsam.Rot3(), np.array([4.0, 0.0, 0.0]))
    found += end.prepare((scan(0.3, seen_from(away, cloud)),))
    found += end.prepare((scan(0.4, seen_from(away.compose(STEP), cloud)),))
    assert end.notes == {'left: match rejected': 1}
    assert [item.previous for item in found[3:]] == [None, stamp(0.3)]
    assert_close(found[4].T_previous_current, STEP, 0.05, 0.005)


def test_points_are_moved_into_base_link_before_they_are_matched():
    # A LiDAR that looks backwards sees the car drive backwards; base_link still goes forwards.
    turned = [0, 0, 1.5, 0, 0, 1, 0]
    config = make_config({'lidars': {'left': {'T_base_sensor': turned}}})
    end = FrontEnd(config)
    T_base_lidar = gtsam.Pose3(config.lidars['left'].matrix())
    found = []
    for i, pose in enumerate(poses(3)):
        points = seen_from(pose.compose(T_base_lidar), room(seed=i))
        found += end.prepare((scan(i / 10, points),))
    assert_close(found[2].T_previous_current, STEP, 0.05, 0.005)
    floor = found[2].thinned[found[2].thinned[:, 2] < 0]
    assert len(floor) > 0


def driven(steps, standing):
    """T_room_base after so many steps; the car sets off after ``standing`` of them."""
    return gtsam.Pose3.Expmap(gtsam.Pose3.Logmap(STEP) * max(steps - standing, 0.0))


def sweeps(end, count, first, last, standing=0):
    """Prepared sweeps of a car, each measured from ``first`` to ``last`` s off its stamp."""
    prepared = []
    for i in range(count):
        cloud = room(3000, seed=i)
        moments = np.round(np.linspace(first, last, len(cloud)), 3)
        np.random.default_rng(i).shuffle(moments)
        points = np.empty_like(cloud)
        for moment in np.unique(moments):
            steps = i + 10 * moment
            then = driven(steps, standing) if standing else driven_on(steps)
            points[moments == moment] = seen_from(then, cloud[moments == moment])
        sweep = LidarScan(
            stamp(i / 10), 'left', points.astype(np.float32), moments.astype(np.float32)
        )
        prepared += end.prepare((sweep,))
    return prepared


def driven_on(steps):
    """T_room_base of a car that was driving before the first sweep already."""
    return gtsam.Pose3.Expmap(gtsam.Pose3.Logmap(STEP) * steps)


SWEEPS = [(-0.1, 0.0), (-0.05, 0.05), (0.0, 0.1)]
SWEEP_NAMES = ['stamp_at_the_end', 'stamp_in_the_middle', 'stamp_at_the_start']


def thickness(item, T_room_base):
    """Mean distance of a placed scan's wall points from the wall."""
    placed = item.thinned @ T_room_base.rotation().matrix().T + T_room_base.translation()
    wall = placed[(np.abs(placed[:, 0] + 12) < 1) & (placed[:, 1] > -13) & (placed[:, 2] > -1)]
    return float(np.abs(wall[:, 0] + 12).mean())


@pytest.mark.parametrize(('first', 'last'), SWEEPS, ids=SWEEP_NAMES)
def test_motion_within_a_sweep_is_undone_wherever_its_stamp_is(first, last):
    found = sweeps(front_end(), 12, first, last)
    # The first match only learns how fast the car is.
    for index in range(2, 12):
        assert_close(found[index].T_previous_current, STEP, 0.05, 0.005)
        assert thickness(found[index], driven_on(index)) < 0.03


@pytest.mark.parametrize(('first', 'last'), SWEEPS, ids=SWEEP_NAMES)
def test_wrong_guess_of_the_motion_within_a_sweep_is_forgotten(first, last):
    # The sweeps in which the car sets off are undone by the motion before, standing. An error
    # of that motion shifts the next sweep; if the shift were taken for motion again, the speed
    # would swing around the true one, by a third of it for ever where the stamp is at the start.
    found = sweeps(front_end(), 16, first, last, standing=4)
    for index in range(8, 16):
        assert_close(found[index].T_previous_current, STEP, 0.05, 0.005)
        assert thickness(found[index], driven(index, 4)) < 0.03


def test_motion_within_a_sweep_stays_where_the_settings_say_so():
    found = sweeps(front_end(deskew=False), 6, -0.1, 0.0)
    assert thickness(found[5], driven_on(5)) > 0.1


def test_fixes_are_placed_around_the_first_one_used_and_the_unusable_are_counted():
    end = FrontEnd(make_config({'fixes': {'min_status': 2}}))

    def fix(seconds, latitude, status):
        return GnssFix(stamp(seconds), 'gps', latitude, 127.0, 50.0, status)

    found = end.prepare(
        (
            fix(0, 36.0, FixStatus.FIX),
            fix(1, 36.0001, FixStatus.GBAS),
            fix(2, 36.0002, FixStatus.GBAS),
        )
    )
    assert [type(item) for item in found] == [PreparedFix, PreparedFix]
    assert found[0].enu == pytest.approx(np.zeros(3), abs=1e-9)
    assert found[1].enu[1] == pytest.approx(11.1, abs=0.1)
    assert end.drops == {('gps', 'low_status'): 1}
    assert end.datum.latitude == 36.0001


def test_coarse_map_takes_nothing_from_the_matching():
    end = FrontEnd(make_config({'map': {'voxel_size': 3.0}, 'lidars': {'left': {}}}))
    found = drive(end, [0.0, 0.1, 0.2, 0.3])
    for item in found[1:]:
        assert_close(item.T_previous_current, STEP, 0.03, 0.003)
    cells = np.floor(found[3].thinned / 3.0)
    assert len(np.unique(cells, axis=0)) == len(cells)


def test_scans_of_a_lidar_can_be_prepared_in_another_process():
    config = make_config({'lidars': {'left': {}}})
    here, there = (ScanPreparer('left', config, Counter()) for _ in range(2))
    for i, pose in enumerate(poses(3)):
        raw = scan(i / 10, seen_from(pose, room(seed=i)))
        expected = here.prepare(raw)
        found = pickle.loads(pickle.dumps(there.prepare(pickle.loads(pickle.dumps(raw)))))
        assert np.array_equal(found.thinned, expected.thinned)
        assert found.core == expected.core
        assert found.previous == expected.previous
    assert found.T_previous_current.equals(expected.T_previous_current, 1e-12)


def test_empty_window_prepares_nothing():
    assert front_end().prepare(()) == []


def test_scan_and_fix_keep_their_order():
    end = front_end()
    core = (
        scan(0.0, room()),
        GnssFix(stamp(0.02), 'gps', 36.0, 127.0, 50.0, FixStatus.GBAS),
        scan(0.04, room(), 'right'),
    )
    found = end.prepare(core)
    assert [type(item) for item in found] == [PreparedScan, PreparedFix, PreparedScan]
    assert [item.core.stamp for item in found] == [m.stamp for m in core]
