"""Scans of one LiDAR linked to one another: what is matched, rejected, and how motion is undone."""

import pickle
from collections import Counter
from dataclasses import replace

import gtsam
import numpy as np
import pytest
from driven_room import (
    METHODS,
    STEP,
    assert_close,
    drive,
    front_end,
    poses,
    room,
    scan,
    seen_from,
    stamp,
)
from scipy.spatial import cKDTree

from incremental_mapper.frontend.front_end import FrontEnd
from incremental_mapper.frontend.prepared_scan import ScanPreparer
from incremental_mapper.measurements import LidarScan
from incremental_mapper.settings import make_config
from incremental_mapper.voxels import thin


@pytest.mark.parametrize('method', METHODS)
def test_first_scan_of_a_lidar_has_no_odometry_and_the_next_ones_have(method):
    found = drive(front_end(method=method), [0.0, 0.1, 0.2, 0.3])
    assert [item.previous for item in found] == [None, stamp(0.0), stamp(0.1), stamp(0.2)]
    assert found[0].T_previous_current is None
    for item in found[1:]:
        assert_close(item.T_previous_current, STEP, 0.05, 0.005)


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


def leaping(end, times):
    """Prepared scans of a room that leaps by 3 m from each scan to the next."""
    prepared = []
    for seconds in times:
        away = gtsam.Pose3(gtsam.Rot3(), np.array([30.0 * (seconds - times[0]) + 3.0, 0.0, 0.0]))
        cloud = room(seed=round(seconds * 10))
        prepared += end.prepare((scan(seconds, seen_from(away, cloud)),))
    return prepared


def test_motion_is_forgotten_after_three_bad_matches_and_not_before():
    # Two bad ones, and steady motion again: what was known of it is still believed.
    end = front_end(max_correspondence=10.0)
    found = drive(end, [0.0, 0.1, 0.2])
    found += leaping(end, [0.3, 0.4, 0.5, 0.6, 0.7])
    # The third bad match in a row: the motion that it was held against may be what is wrong.
    assert end.notes == {'left: match rejected': 3}
    linked = [item.previous for item in found[3:]]
    assert linked == [None, None, None, stamp(0.5), stamp(0.6)]
    assert found[6].T_previous_current.x() == pytest.approx(3.0, abs=0.1)


def test_good_match_makes_up_for_bad_ones_before_it():
    end = front_end(max_correspondence=10.0)
    found = drive(end, [0.0, 0.1, 0.2])
    found += leaping(end, [0.3, 0.4])
    assert end.notes == {'left: match rejected': 2}
    after = gtsam.Pose3(gtsam.Rot3(), np.array([6.0, 0.0, 0.0]))
    for i, seconds in enumerate((0.5, 0.6), 1):
        pose = after.compose(gtsam.Pose3.Expmap(gtsam.Pose3.Logmap(STEP) * i))
        found += end.prepare((scan(seconds, seen_from(pose, room(seed=20 + i))),))
    assert [item.previous for item in found[5:]] == [stamp(0.4), stamp(0.5)]
    assert_close(found[6].T_previous_current, STEP, 0.05, 0.005)
    # The count began anew: two more bad ones leave the motion known.
    again = leaping(end, [0.7, 0.8])
    assert [item.previous for item in again] == [None, None]
    assert end.notes == {'left: match rejected': 4}


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


def test_match_that_explains_too_little_of_a_scan_is_rejected():
    end = front_end(method='gicp')
    found = end.prepare((scan(0.0, room()),))
    found += end.prepare((scan(0.1, room(seed=1) + np.array([45.0, 45.0, 10.0])),))
    assert [item.previous for item in found] == [None, None]
    assert end.notes == {'left: match rejected': 1}


@pytest.mark.parametrize('voxel', [0.1, 3.0])
def test_intensity_changes_nothing_else_and_comes_with_the_points_of_the_map(voxel):
    tree = {'map': {'voxel_size': voxel}, 'odometry': {'voxel_size': 2.0}, 'lidars': {'left': {}}}
    plain, bright = (ScanPreparer('left', make_config(tree), Counter()) for _ in range(2))
    for seconds in (0.0, 0.1, 0.2):
        given = scan(seconds, room())
        height = given.points[:, 2] + np.float32(50.0)  # so that each point's is known
        one, other = plain.prepare(given), bright.prepare(replace(given, intensities=height))
        assert one.thinned.shape[1] == 3 and other.thinned.shape[1] == 4
        assert np.array_equal(one.thinned, other.thinned[:, :3])
        assert np.array_equal(one.sparse, other.sparse) and one.sparse.shape[1] == 3
        assert other.thinned[:, 3] == pytest.approx(other.thinned[:, 2] + 50.0, abs=1e-3)
        assert other.thinned.flags.c_contiguous and other.thinned.dtype == np.float32


def test_scan_for_a_coarse_map_is_thinned_finely_enough_to_be_matched_first():
    tree = {'map': {'voxel_size': 3.0}, 'odometry': {'voxel_size': 2.0}, 'lidars': {'left': {}}}
    preparer = ScanPreparer('left', make_config(tree), Counter())
    points = room().astype(np.float32)
    expected = thin(thin(points.astype(np.float64), 0.3 * 2.0), 3.0)
    found = preparer.prepare(scan(0.0, points)).thinned
    # But for points that rounding moves across the edge of a voxel.
    apart, _ = cKDTree(expected).query(found)
    assert np.median(apart) < 1e-4


def along(end, places, seconds=None):
    """Prepared scans of a car at some places ahead of where it began, metres, every 0.1 s."""
    seconds = [0.1 * number for number in range(len(places))] if seconds is None else seconds
    prepared = []
    for number, (metres, moment) in enumerate(zip(places, seconds, strict=True)):
        pose = gtsam.Pose3(gtsam.Rot3(), np.array([metres, 0.0, 0.0]))
        prepared += end.prepare((scan(moment, seen_from(pose, room(seed=number))),))
    return prepared


def test_a_first_motion_that_the_second_refutes_is_left():
    """No car has 5 m/s within a tenth of a second: one of the two matches went astray."""
    end = front_end(method='gicp')
    still, moved, after = along(end, [0.0, 0.0, 0.6, 1.2, 1.8])[1:4]
    assert still.previous is not None
    assert (moved.previous, moved.T_previous_current) == (None, None)
    assert end.notes['left: first motions disagree'] == 1
    assert after.previous == stamp(0.2)
    assert_close(after.T_previous_current, gtsam.Pose3(gtsam.Rot3(), [0.6, 0.0, 0.0]), 0.05, 0.01)


def test_a_car_that_brakes_hard_as_it_is_first_seen_goes_on():
    end = front_end(method='gicp')
    speeds = 6.0 - 4.0 * 0.1 * np.arange(5)
    scans = along(end, np.cumsum([0.0, *(0.1 * speeds)]))
    assert all(one.previous is not None for one in scans[1:])
    assert not end.notes


@pytest.mark.parametrize(('gap', 'sure'), [(0.2, True), (0.5, False)])
def test_a_first_match_over_a_long_gap_is_not_sure(gap, sure):
    end = front_end(method='gicp')
    _, first, second = along(end, [0.0, 0.5, 0.6], [0.0, gap, gap + 0.1])
    deviation = np.sqrt(first.covariance[3:, 3:].diagonal().max())
    assert deviation < 0.1 if sure else deviation > 2.0
    assert np.sqrt(second.covariance[3:, 3:].diagonal().max()) < 0.1
