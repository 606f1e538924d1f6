"""Transforms: map to odom to base, or to the robot's own odom, and where sensors are."""

from types import SimpleNamespace

import gtsam
import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (extra "ros")')

from incremental_mapper.config import FrameSettings, TfSettings
from incremental_mapper.ros.robot_odometry import KEPT, WIDEST, RobotOdometry
from incremental_mapper.ros.transforms import Transforms, transform_message

SECOND = 1_000_000_000
IN_MAP = gtsam.Pose3(gtsam.Rot3.Yaw(1.0), np.array([1.0, 2.0, 3.0]))
IN_ODOM = gtsam.Pose3(gtsam.Rot3.Yaw(0.2), np.array([0.5, 0.0, 0.0]))


def made(**settings):
    sent, static = [], []
    return Transforms(TfSettings(**settings), FrameSettings(), sent.append, static.append), (
        sent,
        static,
    )


def pose(message):
    shift, turn = message.transform.translation, message.transform.rotation
    rotation = gtsam.Rot3(turn.w, turn.x, turn.y, turn.z)
    return gtsam.Pose3(rotation, np.array([shift.x, shift.y, shift.z]))


def names(messages):
    return [(message.header.frame_id, message.child_frame_id) for message in messages]


def tf(*messages):
    """As a tf2_msgs/TFMessage."""
    return SimpleNamespace(transforms=list(messages))


def test_transforms_chain_to_the_pose_in_the_map():
    transforms, (sent, _) = made()
    transforms.send(5, IN_MAP, IN_ODOM)
    assert names(sent[0]) == [('map', 'odom'), ('odom', 'base_link')]
    assert pose(sent[0][0]).compose(pose(sent[0][1])).equals(IN_MAP, 1e-9)
    assert not transforms.listens


def test_nothing_is_broadcast_where_nothing_is_wanted():
    transforms, (sent, _) = made(publish='none')
    transforms.send(5, IN_MAP, IN_ODOM)
    assert not sent


def test_map_to_odom_alone_is_held_against_the_odometry_of_the_robot():
    transforms, (sent, _) = made(publish='map_to_odom', ahead=0.2)
    # The robot has its own frames in between, and its own idea of where odom lies.
    own = [gtsam.Pose3(gtsam.Rot3.Yaw(yaw), np.array([yaw, 7.0, 0.0])) for yaw in (0.4, 0.6)]
    up = gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, 0.3]))
    transforms.robot.static(tf(transform_message(0, 'base_footprint', 'base_link', up)))
    transforms.robot.moving(tf(transform_message(10 * SECOND, 'odom', 'base_footprint', own[0])))
    transforms.send(10 * SECOND + SECOND // 10, IN_MAP, IN_ODOM)
    assert not sent  # the robot has not told where it was yet
    transforms.robot.moving(
        tf(transform_message(10 * SECOND + SECOND // 5, '/odom', 'base_footprint', own[1]))
    )
    transforms.look()
    transforms.look()
    assert [names(messages) for messages in sent] == [[('map', 'odom')]]
    message = sent[0][0]
    stamp = message.header.stamp.sec * SECOND + message.header.stamp.nanosec
    assert stamp == 10 * SECOND + 3 * SECOND // 10
    halfway = gtsam.Pose3(gtsam.Rot3.Yaw(0.5), own[0].slerp(0.5, own[1]).translation())
    assert pose(message).compose(halfway).compose(up).equals(IN_MAP, 1e-9)
    assert transforms.unanswered == 0


def test_windows_that_the_robot_tells_nothing_of_are_counted():
    transforms, (sent, _) = made(publish='map_to_odom')
    for stamp in range(3):
        transforms.send(stamp * SECOND, IN_MAP, IN_ODOM)
    assert not sent and transforms.unanswered == 2


@pytest.mark.parametrize(
    ('told', 'asked', 'known'),
    [
        ([], 0, False),
        ([5], 5, True),
        ([5], 6, False),
        ([5, 6], 4, False),
        ([5, 5 + WIDEST + 1], 6, False),
        ([5, 5 + WIDEST], 6, True),
        ([9, 5], 5, False),
        ([5, 5 + WIDEST, 5 + KEPT + WIDEST], 5, False),
        ([KEPT + 50, 7], 7, True),
    ],
)
def test_odometry_is_told_only_where_it_was_heard(told, asked, known):
    robot = RobotOdometry()
    for stamp in told:
        robot.moving(tf(transform_message(stamp, 'odom', 'base_link', IN_ODOM)))
    found = robot.at(asked, 'odom', 'base_link')
    assert (found is not None) is known
    if known:
        assert found.equals(IN_ODOM, 1e-9)


def test_a_ring_of_frames_and_a_transform_that_is_none_have_no_answer():
    robot = RobotOdometry()
    robot.static(
        tf(transform_message(0, 'a', 'b', IN_ODOM), transform_message(0, 'b', 'a', IN_MAP))
    )
    assert robot.at(0, 'odom', 'b') is None
    broken = transform_message(0, 'odom', 'base_link', IN_ODOM)
    broken.transform.rotation.w = float('nan')
    robot.moving(tf(broken))
    assert robot.at(0, 'odom', 'base_link') is None


def test_sensors_are_told_of_once_and_all_together():
    transforms, (_, static) = made()
    left, right = IN_MAP.matrix(), IN_ODOM.matrix()
    transforms.sensors(3, {'left': left})
    transforms.sensors(4, {})
    transforms.sensors(5, {'left': left})
    assert len(static) == 1
    transforms.sensors(6, {'right': right})
    assert [names(messages) for messages in static] == [
        [('base_link', 'left')],
        [('base_link', 'left'), ('base_link', 'right')],
    ]
    assert pose(static[1][1]).equals(IN_ODOM, 1e-9)
    silent, (_, static) = made(sensors=False)
    silent.sensors(3, {'left': left})
    assert not static
