"""ROS messages to measurements, duck-typed: rclpy's messages and those of a bag reader.

Every function raises MeasurementError, with a reason to count, where a message is unusable.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from incremental_mapper.checks.constant_range import without_constant_ranges
from incremental_mapper.datasets.point_clouds import cloud_table
from incremental_mapper.datasets.point_times import point_times
from incremental_mapper.errors import MeasurementError
from incremental_mapper.measurements import (
    NANOSECONDS,
    GnssFix,
    ImuSample,
    LidarScan,
    Vector,
    make_fix,
    make_imu,
    make_scan,
)

STATUS_UNKNOWN = -2
COVARIANCE_UNKNOWN = 0

Value = TypeVar('Value')


def header_stamp(message: Any) -> int:
    """Read the header stamp, in nanoseconds.

    Raises:
        MeasurementError: ``no_stamp``, it is not set.
    """
    stamp = message.header.stamp
    nanoseconds = int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)
    if nanoseconds <= 0:
        raise MeasurementError('no_stamp', f'the header stamp is {nanoseconds}')
    return nanoseconds


def scan_from_message(
    message: Any, sensor: str, offset_ns: int = 0, min_points: int = 1
) -> LidarScan:
    """Make a scan of a ``sensor_msgs/PointCloud2``.

    Args:
        message: the cloud, x, y, z in metres in the LiDAR's frame.
        sensor: name of the LiDAR.
        offset_ns: nanoseconds that are added to the header stamp.
        min_points: usable points below which it is no scan.

    Returns:
        The scan, with the points' times and intensities where the cloud has them.

    Raises:
        MeasurementError: the message is unusable; its ``reason`` says why.
    """

    def make() -> LidarScan:
        stamp = header_stamp(message)
        table = cloud_table(message)
        points = table.xyz()
        times = point_times(table.points, stamp, points)
        light = table.intensities()
        points, constant = without_constant_ranges(points)
        scan = make_scan(stamp + offset_ns, sensor, points, times.seconds, min_points, light)
        remarks = (*table.remarks, *times.remarks, *constant)
        return replace(scan, remarks=remarks) if remarks else scan

    return _checked(sensor, make)


def describe_times(message: Any) -> str:
    """Say what ``scan_from_message`` takes a cloud's time field for, in words for a log.

    Raises:
        MeasurementError: the message is unusable.
    """

    def describe() -> str:
        table = cloud_table(message)
        return point_times(table.points, header_stamp(message), table.xyz()).note

    return _checked('cloud', describe)


def fix_from_message(message: Any, sensor: str = 'gnss', offset_ns: int = 0) -> GnssFix:
    """Make a fix of a ``sensor_msgs/NavSatFix``.

    Args:
        message: position in degrees and metres, covariance in m^2, east, north, up.
        sensor: name of the receiver.
        offset_ns: nanoseconds that are added to the header stamp.

    Returns:
        The fix, without covariance where its type is unknown.

    Raises:
        MeasurementError: the message is unusable or holds no fix; its ``reason`` says why.
    """

    def make() -> GnssFix:
        stamp = header_stamp(message)
        status = getattr(getattr(message, 'status', None), 'status', None)
        if status is None or int(status) <= STATUS_UNKNOWN:
            raise MeasurementError('no_status', f'the status of the fix is {status}')
        covariance = None
        if int(message.position_covariance_type) != COVARIANCE_UNKNOWN:
            covariance = np.asarray(message.position_covariance, dtype=np.float64)
        return make_fix(
            stamp + offset_ns,
            sensor,
            float(message.latitude),
            float(message.longitude),
            float(message.altitude),
            int(status),
            covariance,
        )

    return _checked(sensor, make)


def imu_from_message(message: Any, sensor: str = 'imu', offset_ns: int = 0) -> ImuSample:
    """Make an inertial sample of a ``sensor_msgs/Imu``.

    Args:
        message: rates in rad/s, accelerations in m/s^2 with gravity in them, and perhaps an
            orientation. A covariance that begins with -1 says that a part was not measured.
        sensor: name of the IMU.
        offset_ns: nanoseconds that are added to the header stamp.

    Returns:
        The sample, in the IMU's frame.

    Raises:
        MeasurementError: the message is unusable or lacks a part; its ``reason`` says why.
    """

    def make() -> ImuSample:
        stamp = header_stamp(message)
        if _is_absent(message.angular_velocity_covariance):
            raise MeasurementError('no_gyro', 'the message says that it has no angular velocity')
        if _is_absent(message.linear_acceleration_covariance):
            raise MeasurementError('no_acceleration', 'the message says it has no acceleration')
        turn = message.orientation
        orientation = None
        if not _is_absent(message.orientation_covariance):
            orientation = np.array([turn.x, turn.y, turn.z, turn.w], dtype=np.float64)
        return make_imu(
            stamp + offset_ns,
            sensor,
            _vector(message.angular_velocity),
            _vector(message.linear_acceleration),
            orientation,
        )

    return _checked(sensor, make)


def _checked(sensor: str, make: Callable[[], Value]) -> Value:
    """Run ``make``; a message that lacks what ``make`` reads becomes a MeasurementError."""
    try:
        return make()
    except (AttributeError, TypeError, ValueError, IndexError) as error:
        raise MeasurementError(
            'wrong_type', f'{sensor}: the message has not the expected form ({error})'
        ) from error


def _is_absent(covariance: Any) -> bool:
    return bool(covariance[0] == -1)


def _vector(value: Any) -> Vector:
    return np.array([value.x, value.y, value.z], dtype=np.float64)
