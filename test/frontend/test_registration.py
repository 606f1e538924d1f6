"""Scan matching recovers known motions, and the front end counts what it cannot match."""

import gtsam
import numpy as np
import pytest
from driven_room import METHODS, STEP, assert_close, poses, room, seen_from

from incremental_mapper.config import OdometryMethod, OdometrySettings
from incremental_mapper.frontend.registration import make_matcher


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


@pytest.mark.parametrize('method', METHODS)
def test_motion_is_in_the_frame_of_the_previous_scan_however_far_the_car_has_turned(method):
    bend = gtsam.Pose3(gtsam.Rot3.Yaw(0.1), np.array([0.4, 0.0, 0.0]))
    ahead = gtsam.Pose3(gtsam.Rot3(), np.array([0.4, 0.0, 0.0]))
    matcher = make_matcher(OdometrySettings(method=method))
    pose = gtsam.Pose3()
    for i, step in enumerate([bend] * 8 + [ahead] * 4):
        match = matcher.match(seen_from(pose, room(seed=i)), step)
        pose = pose.compose(step)
    # After 0.8 rad, straight on is another direction in the frame of the first scan.
    assert_close(match.T_previous_current, ahead, 0.06, 0.01)


@pytest.mark.parametrize('offset', [(80.0, 0.0), (-80.0, 0.0), (0.0, 80.0), (0.0, -80.0)])
def test_what_is_far_in_any_direction_takes_no_part_in_the_match(offset):
    settings = OdometrySettings(method=OdometryMethod.GICP, match_range=45)
    matcher, alone = make_matcher(settings), make_matcher(settings)
    for i, pose in enumerate(poses(2)):
        near, far = seen_from(pose, room(seed=i)), room(seed=5) + [*offset, 0.0]
        found = matcher.match(np.vstack([near, far]), STEP), alone.match(near, STEP)
    assert_close(*(item.T_previous_current for item in found), 1e-9, 1e-9)
