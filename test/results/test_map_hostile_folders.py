"""KAIST folders with faults: what can be used is mapped, the rest is counted by its reason."""

import shutil
from itertools import pairwise

import numpy as np
import pymap3d
import pytest

from incremental_mapper.datasets.truth import read_truth
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.trajectory import match_truth

STATE, LATITUDE, LONGITUDE = 6, 1, 2


def scans(folder, side='left'):
    return sorted((folder / 'sensor_data' / f'VLP_{side}').glob('*.bin'))


def table(folder, name):
    return folder / 'sensor_data' / f'{name}.csv'


def lines(path):
    return path.read_text().splitlines()


def rewrite(path, rows):
    path.write_text('\n'.join(rows) + '\n')


def stamps(path):
    return [int(line.split(',')[0]) for line in lines(path)]


def keep_stamps(folder, side, wanted):
    """Leave only the scans of a side whose number in the drive is wanted."""
    listing = table(folder, f'VLP_{side}_stamp')
    rewrite(listing, [line for i, line in enumerate(lines(listing)) if wanted(i)])


def worst_offset(run, folder):
    """Largest horizontal distance to the truth, without any alignment but the first position."""
    estimate, truth = match_truth(run.trajectory, read_truth(folder / 'global_pose.csv'))
    shift = estimate.positions[:, :2] - truth.positions[:, :2]
    return np.linalg.norm(shift - np.median(shift, axis=0), axis=1).max()


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
    assert worst_offset(run, light_copy) < 0.5


def test_scan_that_is_one_point_many_times(map_light, light_copy):
    np.full((4000, 4), 7.0, dtype='<f4').tofile(scans(light_copy)[5])
    run = map_light(light_copy, strategy='mom')
    assert run.status == 0
    assert run.stats['notes'] == {'left: too few points to match': 1}


def test_scan_of_noise_does_not_bend_the_trajectory(map_light, light_copy):
    path = scans(light_copy)[8]
    rng = np.random.default_rng(0)
    rng.uniform(-30, 30, (5000, 4)).astype('<f4').tofile(path)
    run = map_light(light_copy)
    assert run.status == 0
    assert worst_offset(run, light_copy) < 0.7


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


def test_imu_gap_of_half_a_second(map_light, light_copy):
    path = table(light_copy, 'xsens_imu')
    begin = stamps(path)[0] + round(1.2 * NANOSECONDS)
    end = begin + NANOSECONDS // 2
    rewrite(path, [row for row in lines(path) if not begin < int(row.split(',')[0]) < end])
    run = map_light(light_copy, strategy='mom')
    assert run.status == 0
    assert run.stats['components'] == 1
    spans = [factor['span_ns'] for factor in run.factors('imu')]
    assert any(last <= begin + 10**8 for _, last in spans)
    assert any(first >= end - 10**8 for first, _ in spans)
    assert not any(first <= begin and last >= end for first, last in spans)
    # The velocity starts anew behind the gap; the bias is that of the same sensor.
    assert run.stats['factors_by_kind']['prior_velocity'] == 2
    assert run.stats['factors_by_kind']['prior_bias'] == 1
    assert run.stats['factors_by_kind']['continuity_bias'] == 1
    assert worst_offset(run, light_copy) < 0.5


def test_no_imu_at_all(map_light, light_copy):
    path = table(light_copy, 'xsens_imu')
    path.unlink()
    run = map_light(light_copy, strategy='mom')
    assert run.status == 0
    assert 'note: imu:' in run.err
    assert run.stats['vertices_by_kind'] == {
        'pose': run.stats['clusters'],
        'velocity': 0,
        'bias': 0,
    }
    assert run.stats['components'] == 1
    assert run.used('gnss') == stamps(table(light_copy, 'vrs_gps'))
    assert worst_offset(run, light_copy) < 1.0


def test_no_gnss_at_all(map_light, light_copy):
    table(light_copy, 'vrs_gps').unlink()
    run = map_light(light_copy)
    assert run.status == 0
    assert 'note: gnss:' in run.err
    assert run.stats['georeferenced'] is False and run.stats['datum'] is None
    assert 'gnss' not in run.stats['factors_by_kind']
    assert run.stats['components'] == 1
    assert run.stats['ate_rmse_m'] < 0.3


def test_only_lidar(map_light, light_copy):
    table(light_copy, 'vrs_gps').unlink()
    table(light_copy, 'xsens_imu').unlink()
    run = map_light(light_copy, strategy='base')
    assert run.status == 0
    # Nothing joins the chains of the two LiDARs.
    assert run.stats['components'] == 2
    assert set(run.stats['factors_by_kind']) == {'odometry', 'prior_pose'}


@pytest.mark.parametrize('strategy', ['mom', 'min_time_shift', 'min_solver_error'])
def test_only_lidar_is_connected_by_merging(map_light, light_copy, strategy):
    table(light_copy, 'vrs_gps').unlink()
    table(light_copy, 'xsens_imu').unlink()
    run = map_light(light_copy, strategy=strategy)
    assert run.status == 0
    assert run.stats['components'] == 1
    assert run.stats['clusters'] < run.stats['base_clusters']


def test_one_lidar_only(map_light, light_copy):
    shutil.rmtree(light_copy / 'sensor_data' / 'VLP_right')
    run = map_light(light_copy, strategy='mom')
    assert run.status == 0
    assert 'note: LiDAR right:' in run.err
    assert run.stats['received'].keys() == {'left', 'imu', 'gnss'}
    assert run.stats['components'] == 1
    assert worst_offset(run, light_copy) < 0.5


def test_one_lidar_of_two_listed(map_light, light_drive):
    run = map_light(light_drive, config='lidars:\n  names: [right]\n')
    assert run.status == 0
    assert run.stats['input']['counts'].keys() == {'right', 'imu', 'gnss'}
    assert run.used('left') == []


def test_lidar_that_dies_half_way(map_light, light_copy):
    keep_stamps(light_copy, 'right', lambda number: number < 10)
    run = map_light(light_copy)
    assert run.status == 0
    assert len(run.used('right')) == 10
    assert len(run.used('left')) == len(scans(light_copy, 'left'))
    assert run.stats['components'] == 1
    assert worst_offset(run, light_copy) < 0.5


def test_lidar_that_dies_and_returns(map_light, light_copy):
    keep_stamps(light_copy, 'right', lambda number: not 5 <= number < 16)
    run = map_light(light_copy, strategy='mom')
    assert run.status == 0
    assert run.stats['notes'] == {'right: gap too long to match': 1}
    assert run.stats['components'] == 1
    odometry = [f for f in run.factors('odometry') if f['sensor'] == 'right']
    kept = stamps(table(light_copy, 'VLP_right_stamp'))
    assert [f['stamps_ns'] for f in odometry] == [
        [a, b] for a, b in pairwise(kept) if b - a < NANOSECONDS
    ]
    assert worst_offset(run, light_copy) < 0.5


def test_lidar_that_starts_late(map_light, light_copy):
    keep_stamps(light_copy, 'left', lambda number: number >= 12)
    run = map_light(light_copy)
    assert run.status == 0
    assert run.stats['components'] == 1
    assert worst_offset(run, light_copy) < 0.5


def test_everything_falls_silent_and_returns(map_light, light_copy):
    """Four seconds without anything: only a bridge can join what comes before and after."""
    shift = 4 * NANOSECONDS
    middle = stamps(table(light_copy, 'xsens_imu'))[0] + round(1.3 * NANOSECONDS)

    def moved(stamp):
        return stamp + shift if stamp > middle else stamp

    for name in ('xsens_imu', 'vrs_gps', 'VLP_left_stamp', 'VLP_right_stamp'):
        path = table(light_copy, name)
        rows = [row.partition(',') for row in lines(path)]
        rewrite(path, [f'{moved(int(stamp))}{comma}{rest}' for stamp, comma, rest in rows])
    for path in [*scans(light_copy, 'left'), *scans(light_copy, 'right')]:
        path.rename(path.with_name(f'{moved(int(path.stem))}.bin'))
    (light_copy / 'global_pose.csv').unlink()
    run = map_light(light_copy)
    assert run.status == 0
    assert run.stats['components'] == 1
    assert run.stats['dropped'] == {}
    assert run.stats['bridges'] == len(run.factors('bridge')) == 1


def test_fix_without_a_position_solution(map_light, light_copy):
    path = table(light_copy, 'vrs_gps')
    rows = [row.split(',') for row in lines(path)]
    rows[1][STATE] = '0'
    rewrite(path, [','.join(row) for row in rows])
    run = map_light(light_copy)
    assert run.status == 0
    assert run.stats['dropped'] == {'gnss': {'no_fix': 1}}
    assert len(run.factors('gnss')) == len(rows) - 1


def test_no_fix_ever(map_light, light_copy):
    path = table(light_copy, 'vrs_gps')
    rows = [row.split(',') for row in lines(path)]
    for row in rows:
        row[STATE] = '0'
    rewrite(path, [','.join(row) for row in rows])
    run = map_light(light_copy)
    assert run.status == 0
    assert run.stats['dropped'] == {'gnss': {'no_fix': len(rows)}}
    assert run.stats['georeferenced'] is False


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
    assert run.stats['ate_rmse_m'] < 0.3


def test_later_fix_that_is_50_m_off_does_not_turn_the_map(map_light, light_copy):
    path = table(light_copy, 'vrs_gps')
    rows = [row.split(',') for row in lines(path)]
    rows[1][LATITUDE] = f'{float(rows[1][LATITUDE]) + 50.0 / 111_000.0:.11f}'
    rewrite(path, [','.join(row) for row in rows])
    run = map_light(light_copy)
    assert run.stats['georeferenced'] is True
    assert worst_offset(run, light_copy) < 0.7


def test_fix_on_the_other_side_of_the_earth(map_light, light_copy):
    path = table(light_copy, 'vrs_gps')
    rows = [row.split(',') for row in lines(path)]
    rows[1][LATITUDE], rows[1][LONGITUDE] = '-37.0', '-53.0'
    rewrite(path, [','.join(row) for row in rows])
    run = map_light(light_copy)
    assert run.status == 0
    assert run.stats['ate_rmse_m'] < 0.3


def test_bare_folder_of_scans(map_light, light_drive, tmp_path):
    folder = shutil.copytree(light_drive / 'sensor_data' / 'VLP_left', tmp_path / 'bare')
    (folder / 'readme.bin').write_bytes(b'')
    run = map_light(folder, pictures=True, strategy='mom')
    assert run.status == 0
    assert 'no calibration' in run.err
    assert run.stats['dropped'] == {'left': {'bad_name': 1}}
    assert run.stats['components'] == 1
    assert 'rpe_translation_rmse_m' not in run.stats
    assert {'trajectory.png', 'map.png', 'graph.png'} <= {*run.names()}


def test_a_single_scan(map_light, light_drive, tmp_path):
    path = scans(light_drive)[0]
    (tmp_path / 'one').mkdir()
    shutil.copy(path, tmp_path / 'one')
    run = map_light(tmp_path / 'one', pictures=True, strategy='mom')
    assert run.status == 0
    assert run.stats['clusters'] == 1
    assert run.trajectory.stamps.tolist() == [int(path.stem)]
    assert {'trajectory.png', 'map.png', 'graph.png'} <= {*run.names()}
    assert pytest.approx(0.0, abs=1e-6) == np.abs(run.trajectory.positions).max()


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
    assert run.status == 0
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
