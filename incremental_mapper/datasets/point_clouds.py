"""Reading ``sensor_msgs/PointCloud2``: points and the time of each point.

Works on any object with the message's attributes, whether rclpy or a bag reader made it.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.errors import MeasurementError
from incremental_mapper.measurements import NANOSECONDS, Points

TIME_FIELDS = ('time', 't', 'timestamp', 'time_stamp', 'offset_time')

# sensor_msgs/PointField: datatype number to NumPy code.
_DATATYPES = {1: 'i1', 2: 'u1', 3: 'i2', 4: 'u2', 5: 'i4', 6: 'u4', 7: 'f4', 8: 'f8'}
_UNITS = {'s': 1.0, 'ms': 1e-3, 'us': 1e-6, 'ns': 1e-9}
# A sweep takes 0.05 s to 0.2 s. The bounds are wider, and their ratio of 1000 leaves one unit.
_MIN_SWEEP = 5e-4
_MAX_SWEEP = 0.5
# Times that are nearer to zero than this many seconds count from the header stamp.
_MAX_RELATIVE = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class PointTimes:
    """Time of every point in seconds after the header stamp, or None; ``note`` says why."""

    seconds: NDArray[np.float64] | None
    note: str


def cloud_table(message: Any) -> NDArray[np.void]:
    """The points of a cloud as a structured array (N,) with the message's field names.

    Honours field offsets, byte order, padding of points and rows, and clouds of several rows.
    Raises MeasurementError where layout and data do not fit.
    """
    width, height = int(message.width), int(message.height)
    point_step, row_step = int(message.point_step), int(message.row_step)
    layout = _layout(message, point_step)
    if width == 0 or height == 0:
        return np.empty(0, dtype=layout)
    # Some drivers leave row_step at zero in a cloud of one row, where it does not matter.
    if height == 1:
        row_step = width * point_step
    if row_step < width * point_step:
        raise MeasurementError(
            'bad_layout', f'row_step is {row_step}, below width {width} · point_step {point_step}'
        )
    try:
        data = np.frombuffer(message.data, dtype=np.uint8)
    except (TypeError, ValueError, BufferError) as error:
        raise MeasurementError('wrong_type', f'data is no buffer of bytes ({error})') from error
    needed = (height - 1) * row_step + width * point_step
    if len(data) < needed:
        raise MeasurementError(
            'truncated', f'data has {len(data)} bytes, {needed} are needed for {width}x{height}'
        )
    table: NDArray[np.void] = np.ndarray(
        (height, width), dtype=layout, buffer=data, strides=(row_step, point_step)
    )
    return table.reshape(-1)


def cloud_points(table: NDArray[np.void]) -> Points:
    """x, y, z of a cloud's table, (N, 3) float32 metres; not filtered."""
    points = np.empty((len(table), 3), dtype=np.float32)
    # A float64 beyond the range of float32 becomes infinite here and is filtered later.
    with np.errstate(over='ignore', invalid='ignore'):
        for column, name in enumerate('xyz'):
            points[:, column] = table[name]
    return points


def point_times(table: NDArray[np.void], stamp: int, points: Points) -> PointTimes:
    """Find each point's time; unit and origin follow from the values of the usable points.

    ``stamp`` is the header stamp in nanoseconds, ``points`` what ``cloud_points`` returned. Times
    that count from neither the header nor the epoch (a sensor's own clock) are taken from the
    first point of the sweep.
    """
    name = next((name for name in TIME_FIELDS if name in (table.dtype.names or ())), None)
    if name is None:
        return PointTimes(None, 'no time of the points')
    values = table[name].astype(np.float64)
    # Points without a return often carry a time of zero; they say nothing about the sweep.
    usable = np.isfinite(points).all(axis=1) & points.any(axis=1) & np.isfinite(values)
    if not usable.any():
        return PointTimes(None, f'field {name!r} holds no usable time')
    low, high = float(values[usable].min()), float(values[usable].max())
    if low == high:
        return PointTimes(None, f'field {name!r} is constant, points are not de-skewed')
    unit = next((u for u, s in _UNITS.items() if _MIN_SWEEP < (high - low) * s <= _MAX_SWEEP), None)
    if unit is None:
        return PointTimes(None, f'field {name!r} spans {high - low:g}, which is no sweep')
    scale = _UNITS[unit]
    if max(abs(low), abs(high)) * scale <= _MAX_RELATIVE:
        return PointTimes(values * scale, f'field {name!r} in {unit} from the header stamp')
    # Doubles resolve today's epoch to 0.3 us, in every unit.
    header = stamp / NANOSECONDS / scale
    if max(abs(low - header), abs(high - header)) * scale <= _MAX_RELATIVE:
        return PointTimes((values - header) * scale, f'field {name!r} in {unit} of the epoch')
    return PointTimes(
        (values - low) * scale,
        f'field {name!r} in {unit} on a clock of its own, taken from the first point',
    )


def _layout(message: Any, point_step: int) -> np.dtype[np.void]:
    """Structured dtype of x, y, z and the times; other fields are skipped."""
    order = '>' if message.is_bigendian else '<'
    names: list[str] = []
    formats: list[str] = []
    offsets: list[int] = []
    for field in message.fields:
        if field.name not in ('x', 'y', 'z', *TIME_FIELDS) or field.name in names:
            continue
        code = _DATATYPES.get(int(field.datatype))
        if code is None:
            raise MeasurementError(
                'wrong_type', f'field {field.name!r} has datatype {field.datatype}, expected 1 to 8'
            )
        names.append(field.name)
        formats.append(order + code)
        offsets.append(int(field.offset))
    missing = [name for name in 'xyz' if name not in names]
    if missing:
        raise MeasurementError('missing_field', f'the cloud has no field {missing[0]!r}')
    for name, code, offset in zip(names, formats, offsets, strict=True):
        if offset + np.dtype(code).itemsize > point_step:
            raise MeasurementError(
                'bad_layout', f'field {name!r} at {offset} exceeds point_step {point_step}'
            )
    return np.dtype(
        {'names': names, 'formats': formats, 'offsets': offsets, 'itemsize': point_step}
    )
