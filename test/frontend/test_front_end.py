"""The front end: each measurement to its place, drops and notes, the order kept."""

import gtsam
import numpy as np
import pytest
from driven_room import STEP, assert_close, front_end, poses, room, scan, seen_from, stamp

from incremental_mapper.frontend.front_end import FrontEnd, PreparedFix
from incremental_mapper.frontend.prepared_scan import PreparedScan
from incremental_mapper.measurements import FixStatus, GnssFix, ImuSample
from incremental_mapper.settings import make_config


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


def test_of_dozens_of_fixes_in_one_window_those_are_used_that_a_receiver_can_measure():
    end = FrontEnd(make_config({}))
    fixes = tuple(
        GnssFix(stamp(0.002 * i), 'gps', 36.0, 127.0, 50.0, FixStatus.GBAS) for i in range(50)
    )
    found = end.prepare(fixes)
    assert [item.core.stamp for item in found] == [one.stamp for one in fixes[::5]]
    assert end.drops == {('gps', 'too_dense'): 40}


def test_scans_and_samples_of_no_time_leave_no_trace():
    """They were stamped an hour ahead, and begun before that was known."""
    drive = [(scan(t, seen_from(pose, room()))) for t, pose in zip((0, 0.1), poses(2), strict=True)]
    expected = front_end().prepare(tuple(drive))
    end = front_end()
    for t in (3600.0, 3600.1):
        end.imu(ImuSample(stamp(t), 'imu', np.array([0.0, 0.0, 9.0]), np.zeros(3)))
        end.begin(scan(t, room(seed=7)))
    end.restart()
    found = end.prepare(tuple(drive))
    assert [item.previous for item in found] == [None, stamp(0)]
    assert_close(found[1].T_previous_current, expected[1].T_previous_current, 1e-6, 1e-7)
    assert not end.drops and not end.notes
