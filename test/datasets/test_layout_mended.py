"""Clouds whose message lies about its layout or its times: the data come first."""

import numpy as np
import pytest
from test_message_conversion import POINTS, cloud, reason, xyz

from incremental_mapper.datasets.message_conversion import scan_from_message

MANY = np.random.default_rng(3).uniform(-60.0, 60.0, (400, 3))


def words(scan) -> list[str]:
    return [remark.reason for remark in scan.remarks]


def test_nothing_is_remarked_of_a_sound_cloud():
    times = ('f4', np.linspace(0.0, 0.1, 400))
    for rows, padding in ((1, 0), (4, 8)):
        message = cloud(xyz(points=MANY) | {'t': times}, rows=rows, row_padding=padding)
        assert scan_from_message(message, 'left').remarks == ()


@pytest.mark.parametrize('row_step', [0, 100, 12 * 400, 2**31 - 1])
def test_row_step_is_ignored_where_the_length_tells_the_layout(row_step):
    scan = scan_from_message(cloud(xyz(points=MANY), rows=4, row_step=row_step), 'left')
    np.testing.assert_allclose(scan.points, MANY, rtol=1e-6)
    assert words(scan) == ['wrong_row_step']
    assert f'row_step is {row_step} where rows have 1200 bytes' in scan.remarks[0].text


def test_row_step_counts_where_rows_are_padded():
    message = cloud(xyz(points=MANY), rows=4, row_padding=6, row_step=100)
    assert reason(scan_from_message, message, 'left') == 'bad_layout'


@pytest.mark.parametrize('code', ['f4', 'f8'])
@pytest.mark.parametrize('order', ['<', '>'])
def test_wrong_byte_order_shows_in_the_points(code, order):
    message = cloud(xyz(code, MANY), order, is_bigendian=order == '<')
    scan = scan_from_message(message, 'left')
    np.testing.assert_allclose(scan.points, MANY, rtol=1e-6)
    assert words(scan) == ['wrong_layout']
    assert 'byte order' in scan.remarks[0].text


def test_missing_returns_do_not_hide_a_wrong_byte_order():
    points = MANY.copy()
    points[::2] = np.nan
    scan = scan_from_message(cloud(xyz(points=points), is_bigendian=True), 'left')
    np.testing.assert_allclose(scan.points, points[1::2], rtol=1e-6)


@pytest.mark.parametrize(('code', 'declared'), [('f4', 8), ('f8', 7)])
def test_wrong_float_type_shows_in_the_points(code, declared):
    message = cloud(xyz(code, MANY), padding=8)
    for field in message.fields:
        field.datatype = declared
    scan = scan_from_message(message, 'left')
    np.testing.assert_allclose(scan.points, MANY, rtol=1e-6)
    assert words(scan) == ['wrong_layout']


def test_cloud_of_points_that_make_no_sense_either_way_is_none():
    noise = np.frombuffer(np.random.default_rng(0).bytes(4 * 1200), '<f4').reshape(-1, 3)
    message = cloud(xyz(points=noise))
    assert reason(scan_from_message, message, 'left') == 'implausible_points'


def test_cloud_whose_lost_returns_are_infinite_is_sound():
    points = np.full((4 * len(MANY), 3), np.inf, dtype=np.float32)
    points[::4] = MANY
    scan = scan_from_message(cloud(xyz(points=points)), 'left')
    assert len(scan.points) == len(MANY) and scan.remarks == ()


@pytest.mark.parametrize('step', [1 << 17, 2**31, 2**32 - 1])
def test_cloud_whose_points_are_larger_than_any_is_none(step):
    message = cloud(xyz(points=MANY))
    message.point_step = step
    assert reason(scan_from_message, message, 'left') == 'bad_layout'


@pytest.mark.parametrize(
    ('code', 'scale'), [('f4', 1.0), ('f8', 1e3), ('u4', 1e9)], ids=['s', 'ms', 'ns']
)
@pytest.mark.parametrize('absurd', [4.2, 60.0, 1e3])
def test_a_few_absurd_times_cost_their_points_only(code, scale, absurd):
    times = np.linspace(0.0, 0.1, 400) * scale
    times[[3, 200, 390]] = min(absurd * scale, 4e9)
    scan = scan_from_message(cloud(xyz(points=MANY) | {'t': (code, times)}), 'left')
    kept = np.delete(np.arange(400), [3, 200, 390])
    np.testing.assert_allclose(scan.points, MANY[kept], rtol=1e-6)
    np.testing.assert_allclose(scan.point_times, times[kept] / scale, atol=1e-6)
    assert words(scan) == ['absurd_times']
    assert '3 of 400 points' in scan.remarks[0].text


def test_absurd_times_before_the_sweep():
    times = np.linspace(0.0, 0.1, 400)
    times[7] = -1e9
    scan = scan_from_message(cloud(xyz(points=MANY) | {'time': ('f4', times)}), 'left')
    assert len(scan.points) == 399 and scan.point_times is not None


@pytest.mark.parametrize('times', [np.zeros(400), np.linspace(0.0, 1e15, 400)])
def test_clouds_that_stay_skewed_are_remarked(times):
    scan = scan_from_message(cloud(xyz(points=MANY) | {'time': ('f8', times)}), 'left')
    assert scan.point_times is None and words(scan) == ['not_deskewed']


def test_a_cloud_without_times_is_no_fault():
    assert scan_from_message(cloud(xyz(points=POINTS)), 'left').remarks == ()


@pytest.mark.parametrize('code', ['i2', 'i4', 'f4', 'f8'])
def test_millimetres_show_in_the_size_of_the_points(code):
    near = MANY / 2.0
    scan = scan_from_message(cloud(xyz(code, np.round(near * 1000.0))), 'left')
    np.testing.assert_allclose(scan.points, near, atol=1e-3)
    assert words(scan) == ['millimetres']


def test_points_of_a_grid_are_metres():
    grid = MANY + np.array([40_000.0, 12_000.0, 30.0])
    scan = scan_from_message(cloud(xyz('f8', grid)), 'left')
    assert scan.remarks == () and scan.points.max() > 30_000.0


@pytest.mark.parametrize(('share', 'kept'), [(0.2, True), (0.4, False)])
@pytest.mark.parametrize('absurd', [5.5, -3.0])
def test_times_in_two_parts_are_no_sweep(share, kept, absurd):
    times = np.linspace(0.0, 0.1, 400)
    times[: int(400 * share)] = absurd
    scan = scan_from_message(cloud(xyz(points=MANY) | {'time': ('f4', times)}), 'left')
    assert words(scan) == ['absurd_times' if kept else 'not_deskewed']
    assert len(scan.points) == (320 if kept else 400)
    if kept:
        np.testing.assert_allclose(scan.point_times, times[80:], atol=1e-6)


def test_names_of_fields_in_capitals():
    table = {name.upper(): column for name, column in xyz(points=MANY).items()}
    scan = scan_from_message(cloud(table | {'T': ('f4', np.linspace(0.0, 0.1, 400))}), 'left')
    np.testing.assert_allclose(scan.points, MANY, rtol=1e-6)
    assert scan.point_times is not None and words(scan) == ['field_names']


def test_small_letters_come_before_capitals():
    other = {name.upper(): column for name, column in xyz(points=MANY + 1.0).items()}
    scan = scan_from_message(cloud(other | xyz(points=MANY)), 'left')
    np.testing.assert_allclose(scan.points, MANY, rtol=1e-6)
    assert words(scan) == []
