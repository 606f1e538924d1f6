"""Writing a KAIST recording as a rosbag2 bag (MCAP)."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from incremental_mapper.config import Tree
from incremental_mapper.datasets.kaist import extrinsic_settings
from incremental_mapper.datasets.kaist_files import (
    LIDARS,
    Recording,
    Table,
    fix_parts,
    imu_parts,
    point_times,
)
from incremental_mapper.datasets.topics import CLOUD, FIX, IMU, ODOMETRY, TRUTH_TOPIC
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.settings import merge
from incremental_mapper.trajectory import Trajectory

TOPICS = {
    'left': '/points_left',
    'right': '/points_right',
    'imu': '/imu',
    'gnss': '/fix',
    'truth': TRUTH_TOPIC,
}
FRAMES = {
    'left': 'left_lidar',
    'right': 'right_lidar',
    'imu': 'imu',
    'gnss': 'gnss',
    'truth': 'world',
}

FEWEST_TIMED = 2880
"""Points of a cloud whose order is written as times: a tenth of what a VLP-16 fires in a turn. Of
a cloud that was thinned further the order is nobody's promise, and who reads x, y, z, intensity
alone finds just that."""
POINT_FIELDS = ('x', 'y', 'z', 'intensity', 'time')
"""Those of a cloud, the last where it is known: seconds after the stamp."""
_NUMBER = 4
_DIAGONAL_KNOWN = 2
_SERVICE_GPS = 1


class MessageBuilder:
    """Raw records to ROS messages; ``types`` are the bag library's message classes."""

    def __init__(self) -> None:
        self.store = get_typestore(Stores.ROS2_JAZZY)
        self._types: dict[str, Any] = dict(self.store.types)

    def message(self, sensor: str, stamp: int, record: NDArray[np.floating]) -> object:
        """The message of one record of ``sensor``."""
        header = self._header(stamp, FRAMES[sensor])
        if sensor in LIDARS:
            return self._cloud(header, record)
        make = {'imu': self._imu, 'gnss': self._fix, 'truth': self._odometry}[sensor]
        return make(header, record)

    def _odometry(self, header: object, row: NDArray[np.floating]) -> object:
        """A true pose T_world_base; the twist is left at zero."""
        pose = self._make(
            'geometry_msgs/msg/Pose',
            position=self._make('geometry_msgs/msg/Point', **_named('xyz', row[:3])),
            orientation=self._make('geometry_msgs/msg/Quaternion', **_named('xyzw', row[3:])),
        )
        twist = self._make(
            'geometry_msgs/msg/Twist',
            linear=self._vector(np.zeros(3)),
            angular=self._vector(np.zeros(3)),
        )
        nothing = np.zeros(36)
        return self._make(
            ODOMETRY,
            header=header,
            child_frame_id='base_link',
            pose=self._make('geometry_msgs/msg/PoseWithCovariance', pose=pose, covariance=nothing),
            twist=self._make(
                'geometry_msgs/msg/TwistWithCovariance', twist=twist, covariance=nothing
            ),
        )

    def _cloud(self, header: object, points: NDArray[np.floating]) -> object:
        if len(points) < FEWEST_TIMED or point_times(points) is None:
            points = points[:, :4]
        fields = [
            self._make('sensor_msgs/msg/PointField', name=name, offset=4 * i, datatype=7, count=1)
            for i, name in enumerate(POINT_FIELDS[: points.shape[1]])
        ]
        return self._make(
            CLOUD,
            header=header,
            height=1,
            width=len(points),
            fields=fields,
            is_bigendian=False,
            point_step=_NUMBER * points.shape[1],
            row_step=_NUMBER * points.size,
            data=points.astype('<f4').reshape(-1).view(np.uint8),
            is_dense=False,
        )

    def _imu(self, header: object, row: NDArray[np.floating]) -> object:
        gyro, acceleration, quaternion = imu_parts(row)
        return self._make(
            IMU,
            header=header,
            orientation=self._make('geometry_msgs/msg/Quaternion', **_named('xyzw', quaternion)),
            orientation_covariance=np.zeros(9),
            angular_velocity=self._vector(gyro),
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=self._vector(acceleration),
            linear_acceleration_covariance=np.zeros(9),
        )

    def _fix(self, header: object, row: NDArray[np.floating]) -> object:
        latitude, longitude, altitude, status, covariance = fix_parts(row)
        return self._make(
            FIX,
            header=header,
            status=self._make(
                'sensor_msgs/msg/NavSatStatus', status=int(status), service=_SERVICE_GPS
            ),
            latitude=latitude,
            longitude=longitude,
            altitude=altitude,
            position_covariance=covariance.ravel(),
            position_covariance_type=_DIAGONAL_KNOWN,
        )

    def _make(self, name: str, /, **fields: object) -> object:
        made: object = self._types[name](**fields)
        return made

    def _header(self, stamp: int, frame: str) -> object:
        seconds, nanoseconds = divmod(stamp, NANOSECONDS)
        time = self._make('builtin_interfaces/msg/Time', sec=seconds, nanosec=nanoseconds)
        return self._make('std_msgs/msg/Header', stamp=time, frame_id=frame)

    def _vector(self, values: NDArray[np.floating]) -> object:
        return self._make('geometry_msgs/msg/Vector3', **_named('xyz', values))


class BagWriter:
    """A new rosbag2 folder that takes the raw records of ``sensors``; a context manager.

    Every message is logged at its header stamp.
    """

    def __init__(self, folder: Path, sensors: list[str]) -> None:
        self._builder = MessageBuilder()
        self._writer = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
        self._sensors = sensors
        self._connections: dict[str, Any] = {}

    def __enter__(self) -> 'BagWriter':
        """Create the folder and declare the topics."""
        self._writer.open()
        kinds = dict.fromkeys(LIDARS, CLOUD) | {'imu': IMU, 'gnss': FIX, 'truth': ODOMETRY}
        for sensor in self._sensors:
            self._connections[sensor] = self._writer.add_connection(
                TOPICS[sensor], kinds[sensor], typestore=self._builder.store
            )
        return self

    def __exit__(self, *error: Any) -> None:
        """Finish the bag, or leave it unfinished after an error."""
        self._writer.__exit__(*error)

    def write(self, sensor: str, stamp: int, record: NDArray[np.floating]) -> None:
        """Append a record.

        Args:
            sensor: one of those that the bag was made for.
            stamp: nanoseconds; the message is logged at it.
            record: what the sensor's stream in a ``Recording`` loads.
        """
        connection = self._connections[sensor]
        message = self._builder.message(sensor, stamp, record)
        data = self._builder.store.serialize_cdr(message, connection.msgtype)
        self._writer.write(connection, stamp, data)


def with_truth(recording: Recording, truth: Trajectory) -> Recording:
    """Add the true poses T_world_base to a recording as one more stream, ``truth``."""
    table = Table(truth.stamps, np.hstack([truth.positions, truth.quaternions]))
    return replace(recording, streams={**recording.streams, 'truth': table})


def bag_settings(recording: Recording) -> Tree:
    """Make the settings that go with the bag of a recording: topics and T_base_sensor, 3x4."""
    sensors = list(recording.streams)
    topics: Tree = {sensor: {'topic': TOPICS[sensor]} for sensor in sensors}
    lidars = {sensor: topics.pop(sensor) for sensor in recording.lidars}
    return merge({'lidars': lidars, **topics}, extrinsic_settings(recording, sensors))


def _named(names: str, values: NDArray[np.floating]) -> dict[str, float]:
    return {name: float(value) for name, value in zip(names, values, strict=True)}
