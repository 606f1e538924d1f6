"""``~/odometry_imu``: what goes out with samples, and what diagnostics say of it."""

import time

import gtsam
import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (extra "ros")')

import rclpy
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from ros_helpers import next_domain, stamp_of

from incremental_mapper.mapping.following import PoseUpdate
from incremental_mapper.mapping.newest_state import NewestState
from incremental_mapper.mapping.odometry_frame import OdometryPose
from incremental_mapper.measurements import FixStatus, GnssFix, ImuSample
from incremental_mapper.results.messages.result_messages import read_status
from incremental_mapper.ros.imu_odometry import make_imu_odometry
from incremental_mapper.settings import make_config

SECOND = 1_000_000_000
CONFIG = make_config(
    {'imu_odometry': {'publish': True}, 'imu': {'time_offset': 0.5, 'acceleration_scale': 9.81}}
)
"""An IMU in g whose clock is behind by half a second."""
SPEED = np.array([5.0, 0.0, 0.0])


def sample(number):
    force = np.array([0.0, 1e-9 * number, 1.0])
    stamp = 10 * SECOND + number * SECOND // 100 - SECOND // 2
    return ImuSample(stamp, 'imu', np.zeros(3), force, None)


def window(stamp):
    """Of a car that drives straight on."""
    pose = gtsam.Pose3(gtsam.Rot3(), SPEED * (stamp / SECOND))
    known = np.eye(6) * 1e-4
    bias = gtsam.imuBias.ConstantBias()
    newest = NewestState(stamp, pose, known, SPEED, np.eye(3) * 1e-2, bias=bias)
    T_map_odom = gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 9.0, 0.0]))
    odometry = OdometryPose(T_map_odom.between(pose), known, T_map_odom)
    return PoseUpdate(newest, odometry)


@pytest.fixture
def node():
    context = Context()
    rclpy.init(context=context, domain_id=next_domain())
    made = Node('car', context=context)
    yield made
    made.destroy_node()
    rclpy.shutdown(context=context)


def test_it_is_off_unless_it_is_wanted(node):
    assert make_imu_odometry(node, make_config({})) is None


def test_samples_go_out_in_odom_from_the_newest_window_on(node):
    made, received = make_imu_odometry(node, CONFIG), []
    node.create_subscription(Odometry, '/car/odometry_imu', received.append, 100)
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    made.take(sample(0))
    assert made.status().level == b'\x01' and 'no window' in made.status().message
    made.pose(window(10 * SECOND))
    made.take(GnssFix(10 * SECOND, 'gnss', 37.0, 127.0, 5.0, FixStatus.FIX))
    end = time.monotonic() + 5.0
    while node.count_publishers('/car/odometry_imu') == 0 and time.monotonic() < end:
        executor.spin_once(0.01)
    executor.spin_once(0.2)
    for number in range(1, 21):
        made.take(sample(number))
    while len(received) < 20 and time.monotonic() < end:
        executor.spin_once(0.1)
    assert [stamp_of(m) for m in received] == [
        10 * SECOND + number * SECOND // 100 for number in range(1, 21)
    ]
    last = received[-1]
    assert (last.header.frame_id, last.child_frame_id) == ('odom', 'base_link')
    assert last.pose.pose.position.x == pytest.approx(51.0, abs=1e-3)
    assert last.pose.pose.position.y == pytest.approx(-9.0, abs=1e-3)
    assert last.pose.pose.position.z == pytest.approx(0.0, abs=1e-3)
    assert last.twist.twist.linear.x == pytest.approx(5.0, abs=1e-3)
    variances = [message.pose.covariance[0] for message in received]
    assert variances == sorted(variances) and variances[0] < variances[-1]
    told = made.status()
    assert told.level == b'\x00' and read_status(told)['rate_hz'] > 0.0
    assert made.status().level == b'\x01'  # nothing came since
    made.restart(CONFIG)
    made.take(sample(30))
    assert 'no window' in made.status().message
