"""Reading ``sensor_msgs/PointCloud2``: the points, even where the layout is declared wrongly.

Works on any object with the message's attributes, whether rclpy or a bag reader made it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.datasets.point_times import TIME_FIELDS
from incremental_mapper.errors import MeasurementError
from incremental_mapper.measurements import Points, Remark

# sensor_msgs/PointField: datatype number to NumPy code. The last two are PCL's own.
_DATATYPES = {
    1: 'i1', 2: 'u1', 3: 'i2', 4: 'u2', 5: 'i4', 6: 'u4', 7: 'f4', 8: 'f8', 9: 'i8', 10: 'u8',
}  # fmt: skip
# Read in the wrong byte order, a float has a random exponent: 16 % of them fall between these.
_LEAST, _MOST = 1e-6, 1e6
_MILLIMETRES = 2e3, 2e5
"""Bounds of the median of the coordinates' sizes where they are millimetres; in metres it is below
100 on every road. Maps in grid coordinates are above, or far off the origin on all sides."""
_IMPLAUSIBLE, _PLAUSIBLE = 0.5, 0.9
_JUDGED = 200
"""Points of a cloud that are looked at to judge its layout."""

_MAX_STEP = 1 << 16
"""Bytes of a point; those of known drivers are 12 to 48, and NumPy's limit is 2^31."""

_FEWEST_JUDGED = 20
"""Points with which a cloud's unit is judged."""

_FLOAT32, _FLOAT64, _UINT64 = 7, 8, 10
_LONG = 8
"""Bytes of a 64-bit integer."""

INTENSITY_FIELDS = ('intensity', 'reflectivity', 'i')
"""What drivers call it, the first one that is there counts; Ouster's have the first two."""


@dataclass(frozen=True, slots=True)
class _Field:
    """A field that is read: name, datatype as in ``sensor_msgs/PointField``, offset in bytes."""

    name: str
    datatype: int
    offset: int


@dataclass(frozen=True, slots=True, eq=False)
class CloudTable:
    """The points of a cloud as a structured array (N,) with the message's field names.

    ``remarks`` are what the message says wrongly of its layout; ``scale`` makes metres of x, y, z.
    """

    points: NDArray[np.void]
    remarks: tuple[Remark, ...]
    scale: float = 1.0

    def xyz(self) -> Points:
        """x, y, z, (N, 3) float32 metres; not filtered."""
        points = cloud_points(self.points)
        return points if self.scale == 1.0 else points * np.float32(self.scale)

    def intensities(self) -> NDArray[Any] | None:
        """Intensities (N,) as the message has them, None without such a field; not filtered."""
        for name in INTENSITY_FIELDS:
            if name in (self.points.dtype.names or ()):
                return np.asarray(self.points[name])
        return None


def cloud_table(message: Any) -> CloudTable:
    """Lay out the data of a cloud.

    Honours field offsets, byte order, padding of points and rows, and clouds of several rows. The
    data come before what the message says of them: where their length is that of the points alone
    no ``row_step`` is needed, and where the points are implausible as they are declared another
    byte order or float type is tried.

    Args:
        message: a ``sensor_msgs/PointCloud2``.

    Returns:
        The table of its points.

    Raises:
        MeasurementError: layout and data do not fit.
    """
    declared, renamed = _declared_fields(message)
    width, height = int(message.width), int(message.height)
    point_step = int(message.point_step)
    layout = _layout(declared, point_step, bool(message.is_bigendian))
    if width == 0 or height == 0:
        return CloudTable(np.empty(0, dtype=layout), ())
    try:
        data = np.frombuffer(message.data, dtype=np.uint8)
    except (TypeError, ValueError, BufferError) as error:
        raise MeasurementError('wrong_type', f'data is no buffer of bytes ({error})') from error
    row_step, remarks = _row_step(message, len(data))
    remarks += renamed
    needed = (height - 1) * row_step + width * point_step
    if len(data) < needed:
        raise MeasurementError(
            'truncated', f'data has {len(data)} bytes, {needed} are needed for {width}x{height}'
        )

    def table(dtype: np.dtype[np.void]) -> NDArray[np.void]:
        rows: NDArray[np.void] = np.ndarray(
            (height, width), dtype=dtype, buffer=data, strides=(row_step, point_step)
        )
        return rows.reshape(-1)

    points = table(layout)
    if _overlap(declared) or _plausible_share(points) < _IMPLAUSIBLE:
        for other, what in _other_layouts(declared, point_step, bool(message.is_bigendian)):
            reread = table(other)
            if _plausible_share(reread) > _PLAUSIBLE:
                return CloudTable(reread, (*remarks, Remark('wrong_layout', what)))
    share = _plausible_share(points)
    if share < _IMPLAUSIBLE:
        raise MeasurementError(
            'implausible_points',
            f'only {100 * share:.0f} % of the coordinates are 0 or between {_LEAST:g} and {_MOST:g}'
            ', in no byte order and float type more: the data are not what the fields say',
        )
    if _in_millimetres(points):
        text = 'x, y, z are in millimetres by their size; taken for that'
        return CloudTable(points, (*remarks, Remark('millimetres', text)), 1e-3)
    return CloudTable(points, remarks)


def _in_millimetres(table: NDArray[np.void]) -> bool:
    """Whether a cloud around its LiDAR has coordinates too large for metres."""
    sample = table[:: max(len(table) // _JUDGED, 1)]
    with np.errstate(over='ignore', invalid='ignore'):  # signalling NaNs
        points = np.stack([sample[name].astype(np.float64) for name in 'xyz'], axis=1)
        distance = np.abs(points).max(axis=1)
    points = points[np.isfinite(distance) & (distance > 0.0)]
    if len(points) < _FEWEST_JUDGED:
        return False
    least, most = _MILLIMETRES
    around = np.median(np.abs(points - np.median(points, axis=0)), axis=0).max()
    return bool(least < np.median(np.abs(points).max(axis=1)) < most and around > least / 4.0)


def _row_step(message: Any, size: int) -> tuple[int, tuple[Remark, ...]]:
    """Bytes from row to row for ``size`` bytes of data, and what is wrong with the message's."""
    width, height = int(message.width), int(message.height)
    packed = width * int(message.point_step)
    row_step = int(message.row_step)
    # Some drivers leave row_step at zero in a cloud of one row, where it does not matter.
    if height == 1 or row_step == packed:
        return packed, ()
    if size == packed * height:
        text = (
            f'row_step is {row_step} where rows have {packed} bytes, and the data are just that '
            'long: row_step is ignored (set it to width times point_step in the driver)'
        )
        return packed, (Remark('wrong_row_step', text),)
    if row_step < packed:
        raise MeasurementError(
            'bad_layout',
            f'row_step is {row_step}, below width {width} · point_step {message.point_step}, and '
            f'{size} bytes of data are not {height} rows of {packed} either',
        )
    return row_step, ()


def _overlap(fields: list[_Field]) -> bool:
    """Whether two of x, y, z share bytes, as floats do that are declared to be doubles."""
    places = sorted(
        (f.offset, np.dtype(_DATATYPES[f.datatype]).itemsize) for f in fields if f.name in 'xyz'
    )
    return any(a + size > b for (a, size), (b, _) in pairwise(places))


def _plausible_share(table: NDArray[np.void]) -> float:
    """Share of a cloud's coordinates that can be metres; infinity, NaN and zero say nothing."""
    sample = table[:: max(len(table) // _JUDGED, 1)]
    if any(sample.dtype[name].kind != 'f' for name in 'xyz'):
        return 1.0
    with np.errstate(invalid='ignore'):  # signalling NaNs
        size = np.abs(np.concatenate([sample[name].astype(np.float64) for name in 'xyz']))
    size = size[np.isfinite(size) & (size != 0.0)]
    return float(((size >= _LEAST) & (size <= _MOST)).mean()) if len(size) else 1.0


def cloud_points(table: NDArray[np.void]) -> Points:
    """x, y, z of a cloud's table, (N, 3) float32 metres; not filtered."""
    points = np.empty((len(table), 3), dtype=np.float32)
    # A float64 beyond the range of float32 becomes infinite here and is filtered later.
    with np.errstate(over='ignore', invalid='ignore'):
        for column, name in enumerate('xyz'):
            points[:, column] = table[name]
    return points


def _declared_fields(message: Any) -> tuple[list[_Field], tuple[Remark, ...]]:
    """x, y, z, times, intensity as the message declares them; other fields are skipped.

    A name in capitals is taken for the one in small letters that is missing, and remarked.
    """
    fields: dict[str, _Field] = {}
    known = ('x', 'y', 'z', *TIME_FIELDS, *INTENSITY_FIELDS)
    exact = {field.name for field in message.fields}
    renamed = []
    for field in message.fields:
        name = field.name
        if name not in known and name.lower() not in exact:
            name = name.lower()
        if name not in known or name in fields:
            continue
        datatype = int(field.datatype)
        if name in INTENSITY_FIELDS and not _readable(field, int(message.point_step)):
            continue  # the points are of use without it
        if datatype not in _DATATYPES:
            raise MeasurementError(
                'wrong_type',
                f'field {field.name!r} has datatype {field.datatype}, expected 1 to 10',
            )
        if name in TIME_FIELDS and _is_long(field, int(message.point_step)):
            datatype = _UINT64
        fields[name] = _Field(name, datatype, int(field.offset))
        if name != field.name and name not in INTENSITY_FIELDS:
            renamed.append(field.name)
    missing = [name for name in 'xyz' if name not in fields]
    if missing:
        raise MeasurementError('missing_field', f'the cloud has no field {missing[0]!r}')
    if not renamed:
        return list(fields.values()), ()
    text = f'fields {", ".join(renamed)} are taken for {", ".join(renamed).lower()}'
    return list(fields.values()), (Remark('field_names', text),)


def _is_long(field: Any, point_step: int) -> bool:
    """Whether integers that are one field are the bytes of a 64-bit one, which has no number."""
    code = np.dtype(_DATATYPES[int(field.datatype)])
    whole = int(field.count) > 1 and int(field.count) * code.itemsize == _LONG
    return whole and code.kind in 'iu' and int(field.offset) + _LONG <= point_step


def _readable(field: Any, point_step: int) -> bool:
    """Whether a field has a type that is known and lies within a point."""
    code = _DATATYPES.get(int(field.datatype))
    offset = int(field.offset)
    return code is not None and 0 <= offset <= point_step - np.dtype(code).itemsize


def _layout(fields: list[_Field], point_step: int, bigendian: bool) -> np.dtype[np.void]:
    """Structured dtype of the fields."""
    order = '>' if bigendian else '<'
    formats = [order + _DATATYPES[field.datatype] for field in fields]
    for field, code in zip(fields, formats, strict=True):
        if field.offset + np.dtype(code).itemsize > point_step:
            raise MeasurementError(
                'bad_layout',
                f'field {field.name!r} at {field.offset} exceeds point_step {point_step}',
            )
    if point_step > _MAX_STEP:
        raise MeasurementError('bad_layout', f'point_step is {point_step}')
    return np.dtype(
        {
            'names': [field.name for field in fields],
            'formats': formats,
            'offsets': [field.offset for field in fields],
            'itemsize': point_step,
        }
    )


def _other_layouts(
    fields: list[_Field], point_step: int, bigendian: bool
) -> Iterator[tuple[np.dtype[np.void], str]]:
    """What the data may be instead, and how to say so."""
    is_big = 'true' if bigendian else 'false'
    yield (
        _layout(fields, point_step, not bigendian),
        f'the points make sense in the other byte order only, is_bigendian {is_big} is ignored '
        '(correct it in the driver)',
    )
    for wrong, right in ((_FLOAT32, _FLOAT64), (_FLOAT64, _FLOAT32)):
        if not any(field.name in 'xyz' and field.datatype == wrong for field in fields):
            continue
        changed = [
            _Field(field.name, right, field.offset)
            if field.name in 'xyz' and field.datatype == wrong
            else field
            for field in fields
        ]
        try:
            other = _layout(changed, point_step, bigendian)
        except MeasurementError:
            continue
        yield (
            other,
            f'x, y, z make sense as {_DATATYPES[right]} only, datatype {wrong} is ignored '
            '(correct it in the driver)',
        )
