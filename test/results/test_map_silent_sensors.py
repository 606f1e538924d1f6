"""Sensors that are absent, die, start late or return: what is there is mapped."""

import shutil
from itertools import pairwise

import numpy as np
import pytest
from drive_edits import STATE, keep_stamps, lines, rewrite, scans, stamps, table, worst_offset

from incremental_mapper.frontend.match_noise import WEAK
from incremental_mapper.measurements import NANOSECONDS


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
    # The velocity starts anew behind the gap; each bias goes on from the one before.
    assert run.stats['factors_by_kind']['prior_velocity'] == 2
    assert run.stats['factors_by_kind']['prior_bias'] == 1
    biases = run.stats['vertices_by_kind']['bias']
    assert run.stats['factors_by_kind']['continuity_bias'] == biases - 1
    assert worst_offset(run, light_copy) < 0.23  # measured: 0.154 m


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
    assert worst_offset(run, light_copy) < 0.3  # measured: 0.2 m


def test_no_gnss_at_all(map_light, light_copy):
    table(light_copy, 'vrs_gps').unlink()
    run = map_light(light_copy)
    assert run.status == 0
    assert 'note: gnss:' in run.err
    assert run.stats['georeferenced'] is False and run.stats['datum'] is None
    assert 'gnss' not in run.stats['factors_by_kind']
    assert run.stats['components'] == 1
    assert run.stats['ate_rmse_m'] < 0.14  # measured: 0.091 m


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
    assert worst_offset(run, light_copy) < 0.16  # measured: 0.108 m


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
    assert worst_offset(run, light_copy) < 0.24  # measured: 0.159 m


def test_lidar_that_dies_and_returns(map_light, light_copy):
    keep_stamps(light_copy, 'right', lambda number: not 5 <= number < 16)
    run = map_light(light_copy, strategy='mom')
    assert run.status == 0
    # With every fifth point some matches are weak, which is another matter.
    notes = {text: count for text, count in run.stats['notes'].items() if WEAK not in text}
    assert notes == {'right: no certain match over a gap': 1}
    assert run.stats['components'] == 1
    odometry = [f for f in run.factors('odometry') if f['sensor'] == 'right']
    kept = stamps(table(light_copy, 'VLP_right_stamp'))
    assert [f['stamps_ns'] for f in odometry] == [
        [a, b] for a, b in pairwise(kept) if b - a < NANOSECONDS
    ]
    assert worst_offset(run, light_copy) < 0.23  # measured: 0.15 m


def test_lidar_that_starts_late(map_light, light_copy):
    keep_stamps(light_copy, 'left', lambda number: number >= 12)
    run = map_light(light_copy)
    assert run.status == 0
    assert run.stats['components'] == 1
    assert worst_offset(run, light_copy) < 0.5  # measured: 0.36 m


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
