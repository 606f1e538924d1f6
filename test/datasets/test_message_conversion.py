"""ROS messages to measurements: layouts of clouds, times of points, and unusable messages."""

from array import array
from types import SimpleNamespace

import numpy as np
import pytest

from incremental_mapper.datasets.message_conversion import (
    describe_times,
    fix_from_message,
    imu_from_message,
    scan_from_message,
)
from incremental_mapper.errors import MeasurementError
from incremental_mapper.measurements import FixStatus

STAMP = 1_544_676_777_015_627_000
NUMBERS = {'i1': 1, 'u1': 2, 'i2': 3, 'u2': 4, 'i4': 5, 'u4': 6, 'f4': 7, 'f8': 8}
POINTS = np.array([[1, 2, 3], [4, 5, 6], [-7, 8, 9], [10, 11, 12]], dtype=np.float64)


def header(stamp: int = STAMP) -> SimpleNamespace:
    time = SimpleNamespace(sec=stamp // 10**9, nanosec=stamp % 10**9)
    return SimpleNamespace(stamp=time, frame_id='sensor')


def cloud(columns: dict, order='<', padding=0, rows=1, row_padding=0, stamp=STAMP, **changes):
    """A PointCloud2 of columns {name: (code, values)}, laid out in the order of the dictionary."""
    count = len(next(iter(columns.values()))[1])
    formats = [order + code for code, _ in columns.values()]
    step = sum(np.dtype(code).itemsize for code in formats) + padding
    offsets = np.cumsum([0] + [np.dtype(code).itemsize for code in formats])[:-1].tolist()
    layout = np.dtype(
        {'names': list(columns), 'formats': formats, 'offsets': offsets, 'itemsize': step}
    )
    table = np.zeros(count, dtype=layout)
    for name, (_, values) in columns.items():
        table[name] = values
    width = count // rows
    raw = table.tobytes()
    parts = [raw[i * width * step : (i + 1) * width * step] for i in range(rows)]
    data = b''.join(row + b'\xff' * row_padding for row in parts)
    fields = [
        SimpleNamespace(name=name, offset=offset, datatype=NUMBERS[code[1:]], count=1)
        for name, code, offset in zip(columns, formats, offsets, strict=True)
    ]
    message = SimpleNamespace(
        header=header(stamp),
        height=rows,
        width=width,
        fields=fields,
        is_bigendian=order == '>',
        point_step=step,
        row_step=width * step + row_padding,
        data=array('B', data),
        is_dense=True,
    )
    return SimpleNamespace(**(vars(message) | changes))


def xyz(code='f4', points=POINTS) -> dict:
    return {name: (code, points[:, i]) for i, name in enumerate('xyz')}


def reason(function, *args) -> str:
    with pytest.raises(MeasurementError) as caught:
        function(*args)
    return caught.value.reason


@pytest.mark.parametrize('code', ['f4', 'f8', 'i1', 'i2', 'i4'])
@pytest.mark.parametrize('order', ['<', '>'])
def test_datatypes_and_byte_orders(code, order):
    scan = scan_from_message(cloud(xyz(code), order), 'left')
    np.testing.assert_array_equal(scan.points, POINTS)
    assert scan.points.dtype == np.float32 and scan.stamp == STAMP and scan.point_times is None


def test_fields_in_any_order_with_padding_everywhere():
    columns = {
        'intensity': ('u1', [9, 9, 9, 9]),
        'z': ('f8', POINTS[:, 2]),
        'ring': ('u2', [1, 2, 3, 4]),
        'x': ('f4', POINTS[:, 0]),
        'y': ('i2', POINTS[:, 1]),
    }
    message = cloud(columns, padding=5, rows=2, row_padding=7)
    np.testing.assert_array_equal(scan_from_message(message, 'left').points, POINTS)


@pytest.mark.parametrize('name', ['intensity', 'reflectivity', 'i'])
@pytest.mark.parametrize('code', ['u1', 'u2', 'f4', 'f8'])
@pytest.mark.parametrize('order', ['<', '>'])
def test_intensity_is_read_whatever_it_is_called(name, code, order):
    points = POINTS.copy()
    points[1, 2] = np.nan  # goes, and its intensity with it
    columns = xyz('f4', points) | {name: (code, [3, 5, 200, 0])}
    scan = scan_from_message(cloud(columns, order, padding=3), 'left')
    assert scan.intensities.dtype == np.float32
    np.testing.assert_array_equal(scan.intensities, [3, 200, 0])
    np.testing.assert_array_equal(scan.points, POINTS[[0, 2, 3]])


def test_intensities_that_are_none_count_as_zero_and_cost_no_point():
    absurd = ('f8', [np.nan, -np.inf, 1e300, 7.5])
    scan = scan_from_message(cloud(xyz() | {'intensity': absurd}), 'left')
    np.testing.assert_array_equal(scan.intensities, [0, 0, 0, 7.5])
    np.testing.assert_array_equal(scan.points, POINTS)


@pytest.mark.parametrize('change', [{'datatype': 77}, {'offset': 14}, {'offset': -1}])
def test_field_of_intensity_that_cannot_be_read_costs_no_cloud(change):
    message = cloud(xyz() | {'intensity': ('f4', [1, 2, 3, 4])})
    vars(message.fields[3]).update(change)
    scan = scan_from_message(message, 'left')
    assert scan.intensities is None
    np.testing.assert_array_equal(scan.points, POINTS)


@pytest.mark.parametrize('kind', [bytes, bytearray, lambda d: np.frombuffer(d, np.uint8)])
def test_any_buffer_is_taken(kind):
    message = cloud(xyz())
    message.data = kind(bytes(message.data))
    assert len(scan_from_message(message, 'left').points) == 4


def test_not_finite_points_go_even_from_a_dense_cloud():
    points = POINTS.copy()
    points[0, 1], points[1, 2], points[2, 0] = np.nan, np.inf, 1e300
    times = ('f4', [0.0, 0.01, 0.02, 0.03])
    scan = scan_from_message(cloud(xyz('f8', points) | {'time': times}), 'left')
    np.testing.assert_array_equal(scan.points, POINTS[3:])


@pytest.mark.parametrize(
    ('changes', 'expected'),
    [
        ({'width': 5}, 'truncated'),
        ({'data': array('B')}, 'truncated'),
        ({'width': 2**31, 'height': 2**31, 'row_step': 2**40}, 'truncated'),
        ({'width': 0}, 'empty_cloud'),
        ({'height': 0}, 'empty_cloud'),
        ({'height': 2, 'row_step': 4}, 'bad_layout'),
        ({'point_step': 8}, 'bad_layout'),
        ({'fields': []}, 'missing_field'),
        ({'data': ['text']}, 'wrong_type'),
        ({'data': None}, 'wrong_type'),
        ({'header': header(0)}, 'no_stamp'),
        ({'header': None}, 'wrong_type'),
    ],
)
def test_unusable_clouds(changes, expected):
    assert reason(scan_from_message, cloud(xyz(), **changes), 'left') == expected


def test_unknown_datatype_and_missing_field():
    message = cloud(xyz())
    message.fields[1].datatype = 42
    assert reason(scan_from_message, message, 'left') == 'wrong_type'
    del message.fields[1]
    assert reason(scan_from_message, message, 'left') == 'missing_field'


def test_row_step_of_zero_does_not_matter_in_one_row():
    assert len(scan_from_message(cloud(xyz(), row_step=0), 'left').points) == 4


def test_too_few_points():
    assert reason(scan_from_message, cloud(xyz()), 'left', 0, 5) == 'no_finite_points'


FRACTIONS = np.array([0.0, 0.03, 0.06, 0.1])


@pytest.mark.parametrize('field', ['time', 't', 'timestamp', 'time_stamp', 'offset_time'])
@pytest.mark.parametrize(
    ('code', 'values', 'expected'),
    [
        ('f4', FRACTIONS, FRACTIONS),
        ('f4', FRACTIONS - 0.1, FRACTIONS - 0.1),
        ('f8', FRACTIONS * 1e3, FRACTIONS),
        ('u4', FRACTIONS * 1e6, FRACTIONS),
        ('u4', FRACTIONS * 1e9, FRACTIONS),
        ('f8', STAMP * 1e-9 + FRACTIONS, FRACTIONS),
        ('f8', STAMP * 1e-9 + FRACTIONS - 0.1, FRACTIONS - 0.1),
        ('f8', STAMP * 1e-3 + FRACTIONS * 1e6, FRACTIONS),
        ('f8', STAMP + FRACTIONS * 1e9, FRACTIONS),
        # The sensor's own clock, here microseconds of the hour: from the first point on.
        ('u4', 1.9e9 + FRACTIONS * 1e6, FRACTIONS),
        # The same shortly after such a counter began anew.
        ('u4', 4e8 + FRACTIONS * 1e9, FRACTIONS),
    ],
)
def test_units_and_origins_of_point_times(field, code, values, expected):
    scan = scan_from_message(cloud(xyz() | {field: (code, values)}), 'left')
    np.testing.assert_allclose(scan.point_times, expected, atol=1e-6)


def nanoseconds(order='<'):
    """A cloud whose points have the nanoseconds of the epoch, as 64-bit integers."""
    times = STAMP + np.rint(FRACTIONS * 1e9).astype(np.int64)
    if order == '>':
        halves = {'t': ('u4', times >> 32), 'low': ('u4', times & 0xFFFFFFFF)}
    else:
        halves = {'t': ('u4', times & 0xFFFFFFFF), 'high': ('u4', times >> 32)}
    message = cloud(xyz() | halves, order)
    message.fields.pop()
    return message


@pytest.mark.parametrize('order', ['<', '>'])
@pytest.mark.parametrize(('datatype', 'count'), [(6, 2), (5, 2), (2, 8), (10, 1), (9, 1)])
def test_times_of_64_bits_are_read_however_they_are_declared(order, datatype, count):
    """``PointField`` knows none: two halves, eight bytes, or the numbers that PCL has for them."""
    message = nanoseconds(order)
    message.fields[-1].datatype, message.fields[-1].count = datatype, count
    scan = scan_from_message(message, 'left')
    np.testing.assert_allclose(scan.point_times, FRACTIONS, atol=1e-6)
    assert describe_times(message) == "field 't' in ns of the epoch"


def test_two_numbers_at_the_end_of_a_point_are_no_64_bits():
    """Of a field that would reach beyond the point only its first number is read."""
    message = cloud(xyz() | {'t': ('u4', FRACTIONS * 1e9)})
    message.fields[-1].count = 2
    np.testing.assert_allclose(scan_from_message(message, 'left').point_times, FRACTIONS, atol=1e-6)


@pytest.mark.parametrize(
    ('code', 'values', 'words'),
    [
        ('f4', [0.05] * 4, 'constant'),
        ('f4', [np.nan] * 4, 'no usable time'),
        ('f4', STAMP * 1e-9 + FRACTIONS, 'constant'),
        ('f8', [0, 1, 2, 1e12], 'no sweep'),
    ],
)
def test_unusable_times_leave_the_points(code, values, words):
    message = cloud(xyz() | {'time': (code, values)})
    scan = scan_from_message(message, 'left')
    assert scan.point_times is None and len(scan.points) == 4
    assert words in describe_times(message)


def test_description_of_times_names_the_unit():
    message = cloud(xyz() | {'t': ('u4', FRACTIONS * 1e6)})
    assert describe_times(message) == "field 't' in us from the header stamp"
    assert describe_times(cloud(xyz())) == 'no time of the points'


def test_times_of_points_without_return_do_not_count():
    points = POINTS.copy()
    points[0] = 0.0
    values = STAMP * 1e-9 + FRACTIONS
    values[0] = 0.0
    scan = scan_from_message(cloud(xyz('f4', points) | {'timestamp': ('f8', values)}), 'left')
    np.testing.assert_allclose(scan.point_times, FRACTIONS[1:], atol=1e-6)


def test_offset_moves_the_stamp_not_the_times():
    message = cloud(xyz() | {'time': ('f4', FRACTIONS)})
    scan = scan_from_message(message, 'left', 5_000_000)
    assert scan.stamp == STAMP + 5_000_000
    np.testing.assert_allclose(scan.point_times, FRACTIONS, atol=1e-6)


def fix(**changes):
    message = {
        'header': header(),
        'status': SimpleNamespace(status=2, service=1),
        'latitude': 36.5,
        'longitude': 127.25,
        'altitude': 50.0,
        'position_covariance': np.diag([1.0, 2.0, 3.0]).ravel(),
        'position_covariance_type': 2,
    }
    return SimpleNamespace(**(message | changes))


def test_fix():
    made = fix_from_message(fix(), 'gnss', -7)
    assert (made.stamp, made.status) == (STAMP - 7, FixStatus.GBAS)
    assert (made.latitude, made.longitude, made.altitude) == (36.5, 127.25, 50.0)
    np.testing.assert_array_equal(np.diag(made.covariance), [1, 2, 3])
    assert fix_from_message(fix(position_covariance_type=0)).covariance is None
    assert fix_from_message(fix(position_covariance=np.zeros(9))).covariance is None


@pytest.mark.parametrize(
    ('changes', 'expected'),
    [
        ({'status': SimpleNamespace(status=-2)}, 'no_status'),
        ({'status': SimpleNamespace()}, 'no_status'),
        ({'status': None}, 'no_status'),
        ({'status': SimpleNamespace(status=-1)}, 'no_fix'),
        ({'latitude': float('nan')}, 'not_finite'),
        ({'latitude': 0.0, 'longitude': 0.0}, 'out_of_range'),
        ({'latitude': 123.0}, 'out_of_range'),
        ({'header': header(0)}, 'no_stamp'),
        ({'position_covariance': [1.0]}, 'wrong_type'),
    ],
)
def test_unusable_fixes(changes, expected):
    assert reason(fix_from_message, fix(**changes)) == expected


def test_fix_without_status_attribute():
    message = fix()
    del message.status
    assert reason(fix_from_message, message) == 'no_status'


def imu(**changes):
    message = {
        'header': header(),
        'orientation': SimpleNamespace(x=0.0, y=0.0, z=0.6, w=0.8),
        'orientation_covariance': np.zeros(9),
        'angular_velocity': SimpleNamespace(x=0.1, y=0.2, z=0.3),
        'angular_velocity_covariance': np.zeros(9),
        'linear_acceleration': SimpleNamespace(x=1.0, y=2.0, z=9.8),
        'linear_acceleration_covariance': np.zeros(9),
    }
    return SimpleNamespace(**(message | changes))


ABSENT = np.array([-1.0] + [0.0] * 8)


def test_imu():
    sample = imu_from_message(imu(), 'imu', 3)
    assert sample.stamp == STAMP + 3
    np.testing.assert_array_equal(sample.gyro, [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(sample.acceleration, [1.0, 2.0, 9.8])
    np.testing.assert_allclose(sample.orientation, [0, 0, 0.6, 0.8])


@pytest.mark.parametrize(
    'changes',
    [
        {'orientation_covariance': ABSENT},
        {'orientation': SimpleNamespace(x=0.0, y=0.0, z=0.0, w=0.0)},
        {'orientation': SimpleNamespace(x=float('nan'), y=0.0, z=0.0, w=1.0)},
    ],
)
def test_imu_without_orientation(changes):
    assert imu_from_message(imu(**changes)).orientation is None


@pytest.mark.parametrize(
    ('changes', 'expected'),
    [
        ({'angular_velocity_covariance': ABSENT}, 'no_gyro'),
        ({'linear_acceleration_covariance': ABSENT}, 'no_acceleration'),
        ({'angular_velocity': SimpleNamespace(x=float('inf'), y=0.0, z=0.0)}, 'not_finite'),
        ({'angular_velocity': SimpleNamespace(x=0.0)}, 'wrong_type'),
        ({'header': header(0)}, 'no_stamp'),
    ],
)
def test_unusable_imu(changes, expected):
    assert reason(imu_from_message, imu(**changes)) == expected
