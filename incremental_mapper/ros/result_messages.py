"""Results as ROS messages."""

import array
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import gtsam
import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, Pose, PoseArray, PoseStamped, Quaternion, Vector3
from nav_msgs.msg import Odometry, Path
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from incremental_mapper.graph.factors import pose_numbers
from incremental_mapper.map.cloud import CLOUD_FIELDS
from incremental_mapper.mapping.newest_state import NewestState
from incremental_mapper.mapping.odometry_frame import OdometryPose
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.ros.live_map import PathView

UNKNOWN_VARIANCE = 1e6
"""Stands on the diagonal where the graph does not determine the pose, m^2 and rad^2."""
WINDOW_PREFIX = 'window.'
"""Stands before the keys of windows.csv in graph_stats; stats.json has the same names."""


def time_message(stamp: int) -> Time:
    """A stamp in nanoseconds as a message."""
    seconds, nanoseconds = divmod(stamp, NANOSECONDS)
    return Time(sec=seconds, nanosec=nanoseconds)


def header(stamp: int, frame: str) -> Header:
    """A header of a stamp in nanoseconds."""
    return Header(stamp=time_message(stamp), frame_id=frame)


def pose_message(numbers: Sequence[float]) -> Pose:
    """A pose of x, y, z, qx, qy, qz, qw."""
    x, y, z, *turn = numbers
    return Pose(
        position=Point(x=x, y=y, z=z),
        orientation=Quaternion(**dict(zip('xyzw', turn, strict=True))),
    )


def odometry_message(newest: NewestState, frame: str, child: str) -> Odometry:
    """Pose in ``frame``, twist in ``child``; what is not known has ``UNKNOWN_VARIANCE``."""
    message = Odometry(header=header(newest.stamp, frame), child_frame_id=child)
    message.pose.pose = pose_message(pose_numbers(newest.pose))
    rotation = newest.pose.rotation().matrix()
    if newest.covariance is None:
        covariance = np.eye(6) * UNKNOWN_VARIANCE
    else:
        covariance = ros_covariance(newest.covariance, rotation)
    message.pose.covariance = covariance.ravel()
    x, y, z = (float(value) for value in rotation.T @ newest.velocity)
    message.twist.twist.linear = Vector3(x=x, y=y, z=z)
    twist = np.eye(6) * UNKNOWN_VARIANCE
    if newest.velocity_covariance is not None:
        twist[:3, :3] = newest.velocity_covariance
    if newest.rate is not None and newest.rate_covariance is not None:
        x, y, z = newest.rate.tolist()
        message.twist.twist.angular = Vector3(x=x, y=y, z=z)
        twist[3:, 3:] = newest.rate_covariance
    message.twist.covariance = twist.ravel()
    return message


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


def pose_array(stamp: int, poses: Sequence[gtsam.Pose3], frame: str) -> PoseArray:
    """The poses of a window."""
    messages = [pose_message(pose_numbers(pose)) for pose in poses]
    return PoseArray(header=header(stamp, frame), poses=messages)


def path_message(stamp: int, view: PathView, frame: str) -> Path:
    """A trajectory."""
    poses = [
        PoseStamped(header=header(at, frame), pose=pose_message(numbers))
        for at, numbers in zip(view.stamps, view.poses, strict=True)
    ]
    return Path(header=header(stamp, frame), poses=poses)


def cloud_message(stamp: int, points: NDArray[np.floating], frame: str) -> PointCloud2:
    """Points (N, 3) in metres as x, y, z float32, and intensity where they are (N, 4)."""
    step = 4 * points.shape[1]
    # rclpy copies an array.array of bytes as a block and anything else element by element.
    data = array.array('B')
    data.frombytes(np.ascontiguousarray(points, dtype='<f4').reshape(-1).view(np.uint8).data)
    return PointCloud2(
        header=header(stamp, frame),
        height=1,
        width=len(points),
        fields=[
            PointField(name=name, offset=4 * index, datatype=PointField.FLOAT32, count=1)
            for index, name in enumerate(CLOUD_FIELDS[: points.shape[1]])
        ],
        is_bigendian=False,
        point_step=step,
        row_step=step * len(points),
        data=data,
        is_dense=True,
    )


def stats_message(
    stamp: int, row: Mapping[str, Any], stats: Mapping[str, Any], name: str
) -> DiagnosticArray:
    """One status: the keys of stats.json without the settings, those of windows.csv prefixed."""
    values = {key: value for key, value in stats.items() if key != 'settings'}
    values |= {WINDOW_PREFIX + key: value for key, value in row.items()}
    level = DiagnosticStatus.OK if stats['components'] <= 1 else DiagnosticStatus.WARN
    message = f'window {row["window"]}: {row["clusters"]} clusters'
    return DiagnosticArray(header=header(stamp, ''), status=[status(name, level, message, values)])


def status(
    name: str, level: bytes, message: str, values: Mapping[str, Any], hardware: str = ''
) -> DiagnosticStatus:
    """A diagnostic status; values other than text are written as JSON.

    Without ``hardware`` it is about the program, whose name comes before the colon.
    """
    pairs = [KeyValue(key=key, value=_text(value)) for key, value in values.items()]
    return DiagnosticStatus(
        name=name,
        level=level,
        message=message,
        hardware_id=hardware or name.partition(':')[0],
        values=pairs,
    )


def read_status(status: DiagnosticStatus) -> dict[str, Any]:
    """The values of a diagnostic status; what was written as JSON is read as such."""
    return {item.key: _value(item.value) for item in status.values}


def _value(text: str) -> Any:
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        return text


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)
