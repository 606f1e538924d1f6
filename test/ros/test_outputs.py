"""What the publishers let out: real topics of a node that maps nothing."""

import gtsam
import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (extra "ros")')

import rclpy
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from ros_helpers import next_domain

from incremental_mapper.config import QueueSettings
from incremental_mapper.mapping.following import PoseUpdate
from incremental_mapper.mapping.newest_state import NewestState
from incremental_mapper.mapping.odometry_frame import OdometryPose
from incremental_mapper.ros.inbox import Inbox
from incremental_mapper.ros.parameters import NodeParameters
from incremental_mapper.ros.publishers import Outputs, reliable

SECOND = 1_000_000_000


@pytest.fixture
def node():
    context = Context()
    options = SignalHandlerOptions.NO
    rclpy.init(args=[], context=context, domain_id=next_domain(), signal_handler_options=options)
    made = rclpy.create_node('mapper', context=context)
    yield made
    made.destroy_node()
    context.try_shutdown()


def update(seconds, x):
    pose = gtsam.Pose3(gtsam.Rot3(), np.array([x, 2.0, 3.0]))
    newest = NewestState(seconds * SECOND, pose, None, np.zeros(3))
    return PoseUpdate(newest, OdometryPose(gtsam.Pose3(), np.eye(6), gtsam.Pose3()))


def test_pose_that_is_none_is_not_published_and_the_next_one_is(node):
    outputs = Outputs(node, NodeParameters(node), Inbox(QueueSettings()))
    heard = []
    node.create_subscription(Odometry, '~/odometry', heard.append, reliable(10))
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    while node.count_subscribers('/mapper/odometry') == 0:
        executor.spin_once(timeout_sec=0.01)
    for seconds, x in ((1, 0.5), (2, np.nan), (3, np.inf), (4, 0.7)):
        outputs.pose(update(seconds, x))
    while not heard or heard[-1].header.stamp.sec < 4:
        executor.spin_once(timeout_sec=1.0)
    executor.shutdown()
    assert [message.header.stamp.sec for message in heard] == [1, 4]
    assert [message.pose.pose.position.x for message in heard] == [0.5, 0.7]
