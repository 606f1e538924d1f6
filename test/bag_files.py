"""Small bags of every kind that tests write, and what is in them."""

from pathlib import Path

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

START = 1_700_000_000_000_000_000
MS = 1_000_000
CLOUD = 'sensor_msgs/msg/PointCloud2'
IMU = 'sensor_msgs/msg/Imu'
FIX = 'sensor_msgs/msg/NavSatFix'
TEXT = 'std_msgs/msg/String'
ODOMETRY = 'nav_msgs/msg/Odometry'
STORES = {1: get_typestore(Stores.ROS1_NOETIC), 2: get_typestore(Stores.ROS2_JAZZY)}


def message(kind: str, stamp: int, ros: int = 2):
    """A small valid message of a type."""
    types = STORES[ros].types
    time = types['builtin_interfaces/msg/Time'](sec=stamp // 10**9, nanosec=stamp % 10**9)
    extra = {'seq': 0} if ros == 1 else {}
    header = types['std_msgs/msg/Header'](stamp=time, frame_id='sensor', **extra)
    vector = types['geometry_msgs/msg/Vector3'](x=1.0, y=2.0, z=9.8)
    turn = types['geometry_msgs/msg/Quaternion'](x=0.0, y=0.0, z=0.0, w=1.0)
    zeros = np.zeros(9)
    if kind == CLOUD:
        points = np.arange(1, 31, dtype=np.float32).reshape(10, 3)
        field = types['sensor_msgs/msg/PointField']
        return types[CLOUD](
            header=header,
            height=1,
            width=10,
            fields=[field(name=n, offset=4 * i, datatype=7, count=1) for i, n in enumerate('xyz')],
            is_bigendian=False,
            point_step=12,
            row_step=120,
            data=points.reshape(-1).view(np.uint8),
            is_dense=True,
        )
    if kind == IMU:
        return types[IMU](header, turn, zeros, vector, zeros, vector, zeros)
    if kind == FIX:
        status = types['sensor_msgs/msg/NavSatStatus'](status=2, service=1)
        return types[FIX](header, status, 36.5, 127.25, 50.0, np.eye(3).ravel(), 2)
    if kind == ODOMETRY:
        place = types['geometry_msgs/msg/Point'](x=1.0, y=2.0, z=3.0)
        pose = types['geometry_msgs/msg/PoseWithCovariance'](
            types['geometry_msgs/msg/Pose'](place, turn), np.zeros(36)
        )
        twist = types['geometry_msgs/msg/TwistWithCovariance'](
            types['geometry_msgs/msg/Twist'](vector, vector), np.zeros(36)
        )
        return types[ODOMETRY](header, 'base_link', pose, twist)
    return types[TEXT](data='hello')


USUAL = [
    ('/points_left', CLOUD, 0, 100, 4),
    ('/points_right', CLOUD, 37, 100, 4),
    ('/imu', IMU, 3, 10, 40),
    ('/fix', FIX, 5, 50, 8),
    ('/chatter', TEXT, 0, 100, 2),
]


def write_bag(path: Path, topics=USUAL, plugin=StoragePlugin.MCAP, damage=None, mode=None) -> Path:
    """A rosbag2; topics are (name, type, phase ms, period ms, count), ``damage`` alters data."""
    writer = Writer2(path, version=9, storage_plugin=plugin)
    if mode is not None:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        events = []
        for name, kind, phase, period, count in topics:
            connection = writer.add_connection(name, kind, typestore=STORES[2])
            events += [(START + (phase + i * period) * MS, connection) for i in range(count)]
        for stamp, connection in sorted(events, key=lambda event: event[0]):
            kind = connection.msgtype
            data = bytes(STORES[2].serialize_cdr(message(kind, stamp), kind))
            writer.write(connection, stamp, damage(connection.topic, data) if damage else data)
    return path


def write_ros1(path: Path, topics=USUAL) -> Path:
    with Writer1(path) as writer:
        events = []
        for name, kind, phase, period, count in topics:
            connection = writer.add_connection(name, kind, typestore=STORES[1])
            events += [(START + (phase + i * period) * MS, connection) for i in range(count)]
        for stamp, connection in sorted(events, key=lambda event: event[0]):
            kind = connection.msgtype
            data = STORES[1].serialize_ros1(message(kind, stamp, ros=1), kind)
            writer.write(connection, stamp, data)
    return path


def count(source) -> dict[str, int]:
    found: dict[str, int] = {}
    for measurement in source.measurements():
        found[measurement.sensor] = found.get(measurement.sensor, 0) + 1
    return found
