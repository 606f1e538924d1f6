"""KAIST folders with faults: what can be used is mapped, the rest is counted by its reason."""

import shutil

import numpy as np
import pymap3d
import pytest
from drive_edits import (
    LATITUDE,
    LONGITUDE,
    STATE,
    lines,
    rewrite,
    scans,
    stamps,
    table,
    worst_offset,
)


def test_truncated_scan(map_light, light_copy):
    path = scans(light_copy)[5]
    path.write_bytes(path.read_bytes()[:-7])
    run = map_light(light_copy)
    assert run.status == 0
    assert run.stats['dropped'] == {'left': {'truncated': 1}}
    assert '1 of left (truncated)' in run.out
    assert run.stats['components'] == 1


def test_empty_scan(map_light, light_copy):
    scans(light_copy)[5].write_bytes(b'')
    run = map_light(light_copy)
    assert run.status == 0
    assert run.stats['dropped'] == {'left': {'empty_cloud': 1}}


def test_missing_scan(map_light, light_copy):
    scans(light_copy)[5].unlink()
    run = map_light(light_copy)
    assert run.status == 0
    assert run.stats['dropped'] == {'left': {'missing_file': 1}}


@pytest.mark.parametrize('number', [np.nan, 0.0])
def test_scan_without_a_usable_point(map_light, light_copy, number):
    path = scans(light_copy)[0]
    np.full((4000, 4), number, dtype='<f4').tofile(path)
    run = map_light(light_copy, strategy='mom')
    assert run.status == 0
    assert run.stats['dropped'] == {'left': {'no_finite_points': 1}}


def test_scan_of_absurdly_far_points(map_light, light_copy):
    np.full((4000, 4), 1e30, dtype='<f4').tofile(scans(light_copy)[5])
    run = map_light(light_copy)
    assert run.status == 0
    assert run.stats['dropped'] == {'left': {'no_points_in_range': 1}}


def test_scan_of_five_points(map_light, light_copy):
    path = scans(light_copy)[5]
    np.fromfile(path, dtype='<f4').reshape(-1, 4)[:2000:400].tofile(path)
    run = map_light(light_copy, strategy='mom')
    assert run.status == 0
    assert run.stats['components'] == 1
    assert worst_offset(run, light_copy) < 0.25  # measured: 0.17 m


def test_scan_that_is_one_point_many_times(map_light, light_copy):
    np.full((4000, 4), 7.0, dtype='<f4').tofile(scans(light_copy)[5])
    run = map_light(light_copy, strategy='mom')
    assert run.status == 0
    assert run.stats['dropped'] == {'left': {'too_few_points': 1}}


def test_scan_of_noise_does_not_bend_the_trajectory(map_light, light_copy):
    path = scans(light_copy)[8]
    rng = np.random.default_rng(0)
    rng.uniform(-30, 30, (5000, 4)).astype('<f4').tofile(path)
    run = map_light(light_copy)
    assert run.status == 0
    assert worst_offset(run, light_copy) < 0.25  # measured: 0.17 m


def test_lines_out_of_order_change_nothing(map_light, light_drive, light_copy, tmp_path):
    rng = np.random.default_rng(1)
    for name in ('xsens_imu', 'vrs_gps', 'VLP_left_stamp', 'VLP_right_stamp'):
        rows = lines(table(light_copy, name))
        rewrite(table(light_copy, name), [rows[i] for i in rng.permutation(len(rows))])
    shuffled = map_light(light_copy, out=tmp_path / 'shuffled')
    ordered = map_light(light_drive, out=tmp_path / 'ordered')
    assert shuffled.text('graph.json') == ordered.text('graph.json')
    assert shuffled.text('trajectory.tum') == ordered.text('trajectory.tum')


def test_stamps_twice(map_light, light_drive, light_copy, tmp_path):
    for name, row in (('VLP_left_stamp', 3), ('xsens_imu', 40), ('vrs_gps', 1)):
        rows = lines(table(light_copy, name))
        rewrite(table(light_copy, name), [*rows[: row + 1], *rows[row:]])
    twice = map_light(light_copy, out=tmp_path / 'twice')
    once = map_light(light_drive, out=tmp_path / 'once')
    assert twice.stats['dropped'] == {
        name: {'duplicate_stamp': 1} for name in ('gnss', 'imu', 'left')
    }
    assert twice.text('graph.json') == once.text('graph.json')


def test_lines_that_are_no_numbers(map_light, light_copy):
    for name in ('xsens_imu', 'vrs_gps', 'VLP_right_stamp'):
        rows = lines(table(light_copy, name))
        rewrite(table(light_copy, name), ['stamp,what', rows[0][:15], '', *rows])
    run = map_light(light_copy)
    assert run.status == 0
    dropped = run.stats['dropped']
    assert dropped['imu'] == dropped['gnss'] == {'bad_line': 2}
    assert dropped['right']['bad_line'] >= 1


def test_imu_samples_that_are_not_finite(map_light, light_copy):
    path = table(light_copy, 'xsens_imu')
    rows = lines(path)
    for index in (50, 90):
        words = rows[index].split(',')
        words[8] = 'nan'
        rows[index] = ','.join(words)
    rewrite(path, rows)
    run = map_light(light_copy)
    assert run.status == 0
    assert run.stats['dropped'] == {'imu': {'not_finite': 2}}


def test_fix_without_a_position_solution(map_light, light_copy):
    path = table(light_copy, 'vrs_gps')
    rows = [row.split(',') for row in lines(path)]
    rows[1][STATE] = '0'
    rewrite(path, [','.join(row) for row in rows])
    run = map_light(light_copy)
    assert run.status == 0
    assert run.stats['dropped'] == {'gnss': {'no_fix': 1}}
    assert len(run.factors('gnss')) == len(rows) - 1


@pytest.mark.parametrize('which', [0, 1, 2])
def test_fix_that_is_50_m_off_does_not_shear_the_map(map_light, light_copy, which):
    path = table(light_copy, 'vrs_gps')
    rows = [row.split(',') for row in lines(path)]
    rows[which][LATITUDE] = f'{float(rows[which][LATITUDE]) + 50.0 / 111_000.0:.11f}'
    rewrite(path, [','.join(row) for row in rows])
    run = map_light(light_copy)
    assert run.status == 0
    assert run.stats['components'] == 1
    # The map's shape is that of the drive, wherever the fixes say that it lies.
    assert run.stats['ate_rmse_m'] < 0.26  # measured: 0.087, 0.068 and 0.174 m


def test_one_of_four_fixes_that_is_50_m_off_is_left_out(map_light, drive, tmp_path):
    """Of three it could not be told which one is wrong; three of four agree with odometry."""
    copy = shutil.copytree(drive, tmp_path / 'drive')
    path = table(copy, 'vrs_gps')
    rows = [row.split(',') for row in lines(path)]
    rows[1][LATITUDE] = f'{float(rows[1][LATITUDE]) + 50.0 / 111_000.0:.11f}'
    rewrite(path, [','.join(row) for row in rows])
    run = map_light(copy)
    assert run.stats['georeferenced'] is True
    assert run.stats['dropped'] == {'gnss': {'datum_outlier': 1}}
    assert worst_offset(run, copy) < 0.34  # measured: 0.229 m


def test_fix_on_the_other_side_of_the_earth(map_light, light_copy):
    path = table(light_copy, 'vrs_gps')
    rows = [row.split(',') for row in lines(path)]
    rows[1][LATITUDE], rows[1][LONGITUDE] = '-37.0', '-53.0'
    rewrite(path, [','.join(row) for row in rows])
    run = map_light(light_copy)
    assert run.status == 0
    assert run.stats['ate_rmse_m'] < 0.14  # measured: 0.091 m


def test_nothing_but_unusable_scans(map_light, tmp_path):
    folder = tmp_path / 'bare'
    folder.mkdir()
    for index in range(3):
        (folder / f'{1_544_581_126_000_000_000 + index * 10**8}.bin').write_bytes(b'1234567')
    map_light(folder).assert_refused('no scan and no fix could be used', '3 of left (truncated)')


@pytest.mark.parametrize('strategy', ['mom', 'min_solver_error'])
def test_fixes_alone_where_no_scan_has_a_point_in_range(map_light, light_drive, strategy):
    config = 'odometry:\n  min_range: 0.1\n  max_range: 0.2\n'
    run = map_light(light_drive, config=config, strategy=strategy)
    assert run.status == 1 and 'no_scan_used' in run.err
    counts = run.stats['input']['counts']
    assert run.stats['dropped'] == {
        side: {'no_points_in_range': counts[side]} for side in ('left', 'right')
    }
    assert run.stats['clusters'] == counts['gnss']


def test_truth_of_another_day(map_light, light_drive, tmp_path):
    path = tmp_path / 'truth.tum'
    path.write_text('100.0 0 0 0 0 0 0 1\n110.0 1 0 0 0 0 0 1\n')
    run = map_light(light_drive, '--truth', path)
    assert run.status == 0
    assert 'ate_rmse_m' not in run.stats


def test_time_offset_moves_every_stamp_of_its_sensor(map_light, light_drive):
    run = map_light(light_drive, config='gnss:\n  time_offset: -0.025\n')
    assert run.status == 0
    moved = [stamp - 25_000_000 for stamp in stamps(table(light_drive, 'vrs_gps'))]
    assert run.used('gnss') == moved


def test_first_fix_is_the_datum(map_light, light_drive):
    run = map_light(light_drive, strategy='base')
    words = lines(table(light_drive, 'vrs_gps'))[0].split(',')
    first = [float(words[i]) for i in (1, 2, 5)]
    assert run.stats['datum'] == pytest.approx(first, abs=1e-12)
    first_fix = run.factors('gnss')[0]['position']
    assert np.abs(first_fix).max() < 1e-6
    second = [float(lines(table(light_drive, 'vrs_gps'))[1].split(',')[i]) for i in (1, 2, 5)]
    enu = pymap3d.geodetic2enu(*second, *first)
    assert run.factors('gnss')[1]['position'] == pytest.approx([float(v) for v in enu], abs=1e-6)
