"""Results as messages: covariances and twists in the frames that ROS has them in."""

import gtsam
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from incremental_mapper.datasets.message_conversion import scan_from_message
from incremental_mapper.mapping.newest_state import NewestState
from incremental_mapper.results.messages.message_types import BagTypes
from incremental_mapper.results.messages.result_messages import ResultMessages, ros_covariance

SECOND = 1_000_000_000


@pytest.fixture(params=['bag', 'rclpy'])
def messages(request):
    if request.param == 'bag':
        return ResultMessages(BagTypes())
    pytest.importorskip('rclpy', reason='rclpy is not installed (extra "ros")')
    from incremental_mapper.ros.rclpy_types import MESSAGES

    return MESSAGES


def test_covariance_is_what_samples_of_the_pose_have():
    rng = np.random.default_rng(4)
    pose = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.3, -0.4, 1.2), np.array([5.0, -2.0, 1.0]))
    root = rng.normal(size=(6, 6)) * 1e-3
    covariance = root @ root.T
    translations, rotations = [], []
    for tangent in rng.multivariate_normal(np.zeros(6), covariance, 40_000):
        sample = pose.retract(tangent)
        translations.append(sample.translation() - pose.translation())
        # A small turn about the fixed axes of the parent.
        rotations.append(sample.rotation().matrix() @ pose.rotation().matrix().T)
    turns = Rotation.from_matrix(np.array(rotations)).as_rotvec()
    measured = np.cov(np.hstack([np.array(translations), turns]).T)
    expected = ros_covariance(covariance, pose.rotation().matrix())
    assert np.abs(measured - expected).max() < 0.03 * np.abs(expected).max()


def test_twist_is_along_the_axes_of_the_car(messages):
    pose = gtsam.Pose3(gtsam.Rot3.Yaw(np.pi / 2), np.zeros(3))
    newest = NewestState(7 * SECOND + 5, pose, None, np.array([0.0, 3.0, 0.0]))
    message = messages.odometry(newest, 'map', 'base_link')
    linear = message.twist.twist.linear
    assert [linear.x, linear.y, linear.z] == pytest.approx([3.0, 0.0, 0.0])
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (7, 5)
    assert message.pose.covariance[0] >= 1e6


def test_twist_has_its_covariance_and_what_is_unknown_says_so(messages):
    pose, still = gtsam.Pose3(), np.zeros(3)
    rate = np.array([0.1, 0.2, 0.3])
    known = NewestState(SECOND, pose, None, still, np.eye(3) * 0.04, rate, np.eye(3) * 0.01)
    twist = messages.odometry(known, 'map', 'base_link').twist
    angular = twist.twist.angular
    assert [angular.x, angular.y, angular.z] == pytest.approx([0.1, 0.2, 0.3])
    diagonal = np.diag(np.array(twist.covariance).reshape(6, 6))
    assert diagonal == pytest.approx([0.04] * 3 + [0.01] * 3)
    unknown = messages.odometry(NewestState(SECOND, pose, None, still), 'map', 'base_link').twist
    assert np.diag(np.array(unknown.covariance).reshape(6, 6)) == pytest.approx(1e6)


@pytest.mark.parametrize('columns', [3, 4])
def test_cloud_has_intensity_where_the_points_have(columns, messages):
    points = np.random.default_rng(1).uniform(1.0, 9.0, (7, columns)).astype(np.float32)
    message = messages.cloud(SECOND, points, 'map')
    assert [field.name for field in message.fields] == ['x', 'y', 'z', 'intensity'][:columns]
    assert message.point_step == 4 * columns and message.row_step == 28 * columns
    scan = scan_from_message(message, 'map')
    assert np.array_equal(scan.points, points[:, :3])
    assert columns == 3 or np.array_equal(scan.intensities, points[:, 3])
