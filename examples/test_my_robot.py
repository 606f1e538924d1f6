"""A test of a robot against the mapper's node: both in this process, over real DDS.

pytest examples/test_my_robot.py
"""

import threading
import time

import numpy as np
import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import PointCloud2, PointField

from incremental_mapper.ros.client import open_client
from incremental_mapper.ros.node import MapperNode
from incremental_mapper.ros.programs import free_domain

SECOND = 10**9
START = 1_700_000_000 * SECOND
SPEED = 1.0
"""Metres a second, ahead."""


@pytest.fixture
def robot(tmp_path):
    """A node of the robot's; a mapper listens in the same ROS domain until the test has ended."""
    context, stop, domain = Context(), threading.Event(), free_domain()
    rclpy.init(context=context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
    settings = {'lidars.names': '[front]', 'save.folder': tmp_path / 'map'}
    words = [word for item in settings.items() for word in ('-p', '{}:={}'.format(*item))]
    mapper = MapperNode(context, ['--ros-args', *words])
    mapping = threading.Thread(target=mapper.spin, args=(stop.is_set,))
    mapping.start()
    node = Node('my_robot', context=context)
    try:
        with open_client(domain) as client:
            yield node, client
    finally:
        stop.set()
        mapping.join()
        node.destroy_node()
        rclpy.shutdown(context=context)


def cloud(seconds):
    """What a LiDAR sees of a hall that it drives through."""
    random = np.random.default_rng(0)
    points = random.uniform([-20.0, -8.0, -1.0], [20.0, 8.0, 5.0], (6000, 3))
    side = random.integers(3, size=len(points))
    points[side == 0, 1] = np.sign(points[side == 0, 1]) * 8.0
    points[side == 1, 2] = -1.0
    points[side == 2, 0] = np.sign(points[side == 2, 0]) * 20.0
    points[:, 0] -= SPEED * seconds
    message = PointCloud2(height=1, width=len(points), point_step=12, row_step=12 * len(points))
    message.header.frame_id = 'front_lidar'
    stamp = START + round(seconds * SECOND)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, SECOND)
    message.fields = [
        PointField(name=name, offset=4 * i, datatype=PointField.FLOAT32, count=1)
        for i, name in enumerate('xyz')
    ]
    message.data = points.astype('<f4').tobytes()
    return message


def seconds(heard):
    """Stamp of a message, seconds since the start."""
    stamp = heard.message.header.stamp
    return (stamp.sec * SECOND + stamp.nanosec - START) / SECOND


def test_the_hall_is_mapped_as_it_is_driven_through(robot, tmp_path):
    """What was sent before a flush is mapped when it answers."""
    node, client = robot
    publisher = node.create_publisher(PointCloud2, '/points_front', 10)
    client.wait(lambda: publisher.get_subscription_count() > 0, 'the mapper', 60.0)
    for number in range(20):
        publisher.publish(cloud(number / 10))
        time.sleep(0.05)
    assert client.call('flush')[0] and client.call('save_map')[0]
    # What was published before this client was found by the mapper did not come here.
    client.wait(lambda: client.odometry and seconds(client.odometry[-1]) > 1.85, 'odometry', 30.0)
    newest = client.odometry[-1].message
    assert newest.header.frame_id == 'map'
    assert newest.pose.pose.position.x == pytest.approx(1.9 * SPEED, abs=0.1)
    assert (tmp_path / 'map' / 'map.ply').exists()
