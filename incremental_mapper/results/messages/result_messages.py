"""Results as ROS messages."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.graph.factors import pose_numbers
from incremental_mapper.map.cloud import CLOUD_FIELDS
from incremental_mapper.mapping.live_map import PathView
from incremental_mapper.mapping.newest_state import NewestState
from incremental_mapper.mapping.odometry_frame import OdometryPose
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.results.messages.message_types import MessageTypes

UNKNOWN_VARIANCE = 1e6
"""Stands on the diagonal where the graph does not determine the pose, m^2 and rad^2."""
WINDOW_PREFIX = 'window.'
"""Stands before the keys of windows.csv in graph_stats; stats.json has the same names."""
STATUS = 'diagnostic_msgs/msg/DiagnosticStatus'
FIELD = 'sensor_msgs/msg/PointField'


class ResultMessages:
    """Makes the messages of results with the types that it is given."""

    def __init__(self, types: MessageTypes) -> None:
        self.types = types
        self._make = types.make

    def time(self, stamp: int) -> Any:
        """A stamp in nanoseconds as a message."""
        seconds, nanoseconds = divmod(stamp, NANOSECONDS)
        return self._make('builtin_interfaces/msg/Time', sec=seconds, nanosec=nanoseconds)

    def header(self, stamp: int, frame: str) -> Any:
        """A header of a stamp in nanoseconds."""
        return self._make('std_msgs/msg/Header', stamp=self.time(stamp), frame_id=frame)

    def point(self, x: float, y: float, z: float) -> Any:
        """A point, metres."""
        return self._make('geometry_msgs/msg/Point', x=x, y=y, z=z)

    def vector(self, x: float, y: float, z: float) -> Any:
        """A vector."""
        return self._make('geometry_msgs/msg/Vector3', x=x, y=y, z=z)

    def pose(self, numbers: Sequence[float]) -> Any:
        """A pose of x, y, z, qx, qy, qz, qw."""
        x, y, z, *turn = numbers
        return self._make(
            'geometry_msgs/msg/Pose', position=self.point(x, y, z), orientation=self._turn(turn)
        )

    def odometry(self, newest: NewestState, frame: str, child: str) -> Any:
        """Pose in ``frame``, twist in ``child``; what is not known has ``UNKNOWN_VARIANCE``."""
        rotation = newest.pose.rotation().matrix()
        if newest.covariance is None:
            covariance = np.eye(6) * UNKNOWN_VARIANCE
        else:
            covariance = ros_covariance(newest.covariance, rotation)
        linear = self.vector(*(float(value) for value in rotation.T @ newest.velocity))
        angular = self.vector(0.0, 0.0, 0.0)
        twist = np.eye(6) * UNKNOWN_VARIANCE
        if newest.velocity_covariance is not None:
            twist[:3, :3] = newest.velocity_covariance
        if newest.rate is not None and newest.rate_covariance is not None:
            angular = self.vector(*newest.rate.tolist())
            twist[3:, 3:] = newest.rate_covariance
        return self._make(
            'nav_msgs/msg/Odometry',
            header=self.header(newest.stamp, frame),
            child_frame_id=child,
            pose=self._make(
                'geometry_msgs/msg/PoseWithCovariance',
                pose=self.pose(pose_numbers(newest.pose)),
                covariance=covariance.ravel(),
            ),
            twist=self._make(
                'geometry_msgs/msg/TwistWithCovariance',
                twist=self._make('geometry_msgs/msg/Twist', linear=linear, angular=angular),
                covariance=twist.ravel(),
            ),
        )

    def pose_array(self, stamp: int, poses: Sequence[gtsam.Pose3], frame: str) -> Any:
        """The poses of a window."""
        messages = [self.pose(pose_numbers(pose)) for pose in poses]
        return self._make(
            'geometry_msgs/msg/PoseArray', header=self.header(stamp, frame), poses=messages
        )

    def path(self, stamp: int, view: PathView, frame: str) -> Any:
        """A trajectory."""
        poses = [
            self._make(
                'geometry_msgs/msg/PoseStamped',
                header=self.header(at, frame),
                pose=self.pose(numbers),
            )
            for at, numbers in zip(view.stamps, view.poses, strict=True)
        ]
        return self._make('nav_msgs/msg/Path', header=self.header(stamp, frame), poses=poses)

    def cloud(self, stamp: int, points: NDArray[np.floating], frame: str) -> Any:
        """Points (N, 3) in metres as x, y, z float32, and intensity where they are (N, 4)."""
        step = 4 * points.shape[1]
        data = np.ascontiguousarray(points, dtype='<f4').reshape(-1).view(np.uint8)
        single = self.types.constant(FIELD, 'FLOAT32')
        return self._make(
            'sensor_msgs/msg/PointCloud2',
            header=self.header(stamp, frame),
            height=1,
            width=len(points),
            fields=[
                self._make(FIELD, name=name, offset=4 * index, datatype=single, count=1)
                for index, name in enumerate(CLOUD_FIELDS[: points.shape[1]])
            ],
            is_bigendian=False,
            point_step=step,
            row_step=step * len(points),
            data=self.types.blob(data),
            is_dense=True,
        )

    def stats(self, stamp: int, row: Mapping[str, Any], stats: Mapping[str, Any], name: str) -> Any:
        """One status: the keys of stats.json without the settings, those of windows.csv prefixed.

        Args:
            stamp: Of the window, ns.
            row: The columns of windows.csv.
            stats: The keys of stats.json so far.
            name: Of the status.
        """
        values = {key: value for key, value in stats.items() if key != 'settings'}
        values |= {WINDOW_PREFIX + key: value for key, value in row.items()}
        level = self.types.constant(STATUS, 'OK' if stats['components'] <= 1 else 'WARN')
        message = f'window {row["window"]}: {row["clusters"]} clusters'
        return self._make(
            'diagnostic_msgs/msg/DiagnosticArray',
            header=self.header(stamp, ''),
            status=[self.status(name, level, message, values)],
        )

    def status(
        self, name: str, level: Any, message: str, values: Mapping[str, Any], hardware: str = ''
    ) -> Any:
        """A diagnostic status; values other than text are written as JSON.

        Without ``hardware`` it is about the program, whose name comes before the colon.
        """
        pairs = [
            self._make('diagnostic_msgs/msg/KeyValue', key=key, value=_text(value))
            for key, value in values.items()
        ]
        return self._make(
            STATUS,
            name=name,
            level=level,
            message=message,
            hardware_id=hardware or name.partition(':')[0],
            values=pairs,
        )

    def datum(self, datum: Sequence[float], stamp: int, frame: str) -> Any:
        """A datum as a fix that knows nothing of its errors.

        Args:
            datum: Degrees, degrees, metres; NaN where there is none.
            stamp: When it was known, ns.
            frame: Whose origin it is.
        """
        latitude, longitude, altitude = datum
        status = 'sensor_msgs/msg/NavSatStatus'
        known = 'STATUS_NO_FIX' if math.isnan(latitude) else 'STATUS_FIX'
        return self._make(
            'sensor_msgs/msg/NavSatFix',
            header=self.header(stamp, frame),
            status=self._make(status, status=self.types.constant(status, known)),
            latitude=latitude,
            longitude=longitude,
            altitude=altitude,
        )

    def transform(self, stamp: int, parent: str, child: str, pose: gtsam.Pose3) -> Any:
        """T_parent_child as a message; names have no slash in front."""
        x, y, z, *turn = pose_numbers(pose)
        return self._make(
            'geometry_msgs/msg/TransformStamped',
            header=self.header(stamp, parent),
            child_frame_id=child,
            transform=self._make(
                'geometry_msgs/msg/Transform',
                translation=self.vector(x, y, z),
                rotation=self._turn(turn),
            ),
        )

    def _turn(self, numbers: Sequence[float]) -> Any:
        x, y, z, w = numbers
        return self._make('geometry_msgs/msg/Quaternion', x=x, y=y, z=z, w=w)


def in_odom(newest: NewestState, odometry: OdometryPose) -> NewestState:
    """The newest state as the continuous frame has it."""
    velocity = odometry.T_map_odom.rotation().unrotate(newest.velocity)
    return replace(newest, pose=odometry.pose, covariance=odometry.covariance, velocity=velocity)


def ros_covariance(
    covariance: NDArray[np.float64], rotation: NDArray[np.float64]
) -> NDArray[np.float64]:
    """A pose covariance (6, 6) as ROS has it, from GTSAM's.

    GTSAM: rotation before translation, both along the axes of the body. ROS: translation before
    rotation, along the fixed axes of the parent frame. ``rotation`` (3, 3) is R_parent_body.
    """
    turn = np.zeros((6, 6))
    turn[:3, 3:] = rotation
    turn[3:, :3] = rotation
    turned: NDArray[np.float64] = turn @ covariance @ turn.T
    return 0.5 * (turned + turned.T)


def read_status(status: Any) -> dict[str, Any]:
    """The values of a diagnostic status; what was written as JSON is read as such."""
    return {item.key: _value(item.value) for item in status.values}


def _value(text: str) -> Any:
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        return text


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)
