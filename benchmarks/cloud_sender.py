"""Sends clouds of one LiDAR as a driver does, a process of its own.

    python benchmarks/cloud_sender.py TOPIC [--points 131072] [--count 60] [--best-effort]

The LiDAR stands in a round room: the same points every time, 48 bytes each, stamps of this clock.
It begins a second after somebody has subscribed.
"""

import argparse
import time

import numpy as np
import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2, PointField

POINT_STEP = 48
DEPTH = 10
NOBODY = 60.0
"""Seconds to wait for a subscription."""
AFTER = 2.0
"""Seconds in which what was sent last may be sent again."""


def main() -> None:
    """Send and end."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('topic')
    parser.add_argument('--points', type=int, default=131072)
    parser.add_argument('--count', type=int, default=60)
    parser.add_argument('--rate', type=float, default=10.0)
    parser.add_argument('--best-effort', action='store_true')
    args = parser.parse_args()
    rclpy.init()
    node = rclpy.create_node('cloud_sender')
    reliability = ReliabilityPolicy.BEST_EFFORT if args.best_effort else ReliabilityPolicy.RELIABLE
    quality = QoSProfile(depth=DEPTH, reliability=reliability)
    publisher = node.create_publisher(PointCloud2, args.topic, quality)
    cloud = room(args.points)
    end = time.monotonic() + NOBODY
    while publisher.get_subscription_count() == 0 and time.monotonic() < end:
        time.sleep(0.01)
    begin = time.monotonic() + 1.0
    for number in range(args.count):
        time.sleep(max(begin + number / args.rate - time.monotonic(), 0.0))
        cloud.header.stamp = node.get_clock().now().to_msg()
        publisher.publish(cloud)
    time.sleep(AFTER)
    rclpy.shutdown()


def room(count: int) -> PointCloud2:
    """A round room of 20 m, seen by ``count`` beams."""
    turn = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    table = np.zeros((count, POINT_STEP // 4), dtype='<f4')
    table[:, 0], table[:, 1] = 20.0 * np.cos(turn), 15.0 * np.sin(turn)
    table[:, 2] = 3.0 * np.sin(97.0 * turn)
    fields = [
        PointField(name=name, offset=4 * k, datatype=PointField.FLOAT32, count=1)
        for k, name in enumerate('xyz')
    ]
    cloud = PointCloud2(height=1, width=count, fields=fields, point_step=POINT_STEP)
    cloud.header.frame_id = 'top'
    cloud.row_step, cloud.is_dense = POINT_STEP * count, True
    cloud.data = table.tobytes()
    return cloud


if __name__ == '__main__':
    main()
