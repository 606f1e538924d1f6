"""Livox's own message, ``CustomMsg``, as if it were a ``sensor_msgs/PointCloud2``.

It is read from the serialised bytes: a decoder would make an object of each of its points.
"""

import struct
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.errors import MeasurementError

LIVOX_TYPES = (
    'livox_ros_driver/msg/CustomMsg',
    'livox_ros_driver2/msg/CustomMsg',
    'livox_interfaces/msg/CustomMsg',
)
"""The drivers' names for the one layout."""
_POINT_BYTES = 19
"""offset_time in ns, x, y, z in metres (4 bytes each), reflectivity, tag, line (1 byte each)."""
_CDR_HEAD = 4
"""Bytes of CDR that say how the rest is encoded; alignment counts from behind them."""


@dataclass(frozen=True, slots=True)
class _Stamp:
    sec: int
    nanosec: int


@dataclass(frozen=True, slots=True)
class _Header:
    stamp: _Stamp
    frame_id: str


@dataclass(frozen=True, slots=True)
class _Field:
    name: str
    datatype: int
    offset: int
    count: int = 1


_FIELDS = (
    _Field('offset_time', 6, 0),
    _Field('x', 7, 4),
    _Field('y', 7, 8),
    _Field('z', 7, 12),
    _Field('reflectivity', 2, 16),
)


@dataclass(frozen=True, slots=True, eq=False)
class LivoxCloud:
    """A ``CustomMsg`` with the attributes of a ``sensor_msgs/PointCloud2``."""

    header: _Header
    width: int
    point_step: int
    row_step: int
    data: NDArray[np.uint8]
    height: int = 1
    is_bigendian: bool = False
    is_dense: bool = True
    fields: tuple[_Field, ...] = field(default=_FIELDS)


def livox_cloud(data: bytes | memoryview, ros1: bool) -> LivoxCloud:
    """Lay out a ``CustomMsg``.

    Args:
        data: The serialised message.
        ros1: Whether that is in ROS 1's format, which is packed, or CDR, which is aligned.

    Raises:
        MeasurementError: It is shorter than it says, or of another layout.
    """
    try:
        return _lay_out(bytes(data), ros1)
    except (struct.error, UnicodeDecodeError) as error:
        raise MeasurementError('truncated', f'no Livox CustomMsg ({error})') from error


def _lay_out(data: bytes, ros1: bool) -> LivoxCloud:
    order = '<'
    if not ros1:
        order = '<' if data[1:2] == b'\x01' else '>'
        data = data[_CDR_HEAD:]
    at = 4 if ros1 else 0  # ROS 1 headers begin with a sequence number
    sec, nanosec, length = struct.unpack_from(f'{order}iII', data, at)
    at += 12
    # CDR counts the zero that ends a string.
    frame = data[at : at + length].rstrip(b'\0').decode()
    at += length
    if not ros1:
        at += -at % 8
    at += 8  # timebase, which the header's stamp says too
    (count,) = struct.unpack_from(f'{order}I', data, at)
    at += 4 + 4  # point_num, then lidar_id and three bytes that are kept
    (size,) = struct.unpack_from(f'{order}I', data, at)
    at += 4
    step = _POINT_BYTES if ros1 else _POINT_BYTES + 1
    needed = size * step - (step - _POINT_BYTES)
    if size != count and count:
        raise MeasurementError('bad_layout', f'point_num is {count}, there are {size} points')
    if size and len(data) < at + needed:
        raise MeasurementError(
            'truncated', f'data has {len(data)} bytes, {at + needed} are needed for {size} points'
        )
    # The last point of CDR has no padding behind it.
    points = np.zeros(size * step, dtype=np.uint8)
    points[: max(needed, 0)] = np.frombuffer(data, np.uint8, max(needed, 0), at)
    return LivoxCloud(
        _Header(_Stamp(sec, nanosec), frame),
        size,
        step,
        size * step,
        points,
        is_bigendian=order == '>',
    )
