"""Simulated drives: the folder they are written to and what it says of the true motion."""

import argparse
import csv
import sys
from importlib.util import find_spec

import numpy as np
import pymap3d
import pytest

from incremental_mapper.cli import simulate as command
from incremental_mapper.datasets.simulated import receiver as gnss
from incremental_mapper.datasets.simulated.folder import simulate
from incremental_mapper.datasets.simulated.options import (
    MotionKind,
    SceneKind,
    SimulationOptions,
)
from incremental_mapper.datasets.simulated.sensors import T_BASE_VRS
from incremental_mapper.errors import ConfigError, InputError, MapperError, OutputError
from incremental_mapper.trajectory import from_matrices

needs_rays = pytest.mark.skipif(
    find_spec('embreex') is None, reason='embreex is not installed (extra "sim")'
)
SHORT = SimulationOptions(motion=MotionKind.CONST, duration=1.2, seed=3)


@pytest.fixture(scope='module')
def drive_dir(tmp_path_factory):
    out_dir = tmp_path_factory.mktemp('drives') / 'short'
    simulate(out_dir, SHORT)
    return out_dir


def contents(folder):
    return {
        path.relative_to(folder): path.read_bytes() for path in folder.rglob('*') if path.is_file()
    }


def rows(path):
    with path.open(newline='') as file:
        return list(csv.reader(file))


def truth(folder):
    table = rows(folder / 'global_pose.csv')
    matrices = np.tile(np.eye(4), (len(table), 1, 1))
    matrices[:, :3] = np.array([row[1:] for row in table], dtype=float).reshape(-1, 3, 4)
    matrices[:, :3, 3] -= gnss.ORIGIN_GRID
    return from_matrices(np.array([int(row[0]) for row in table]), matrices)


@needs_rays
def test_same_seed_same_bytes(drive_dir, tmp_path):
    simulate(tmp_path / 'again', SHORT)
    assert contents(tmp_path / 'again') == contents(drive_dir)


@needs_rays
def test_other_seed_other_drive(drive_dir, tmp_path):
    simulate(tmp_path / 'other', SimulationOptions(motion=MotionKind.CONST, duration=1.2, seed=4))
    first, other = truth(drive_dir), truth(tmp_path / 'other')
    assert np.abs(first.quaternions[0] - other.quaternions[0]).max() > 0.01


@needs_rays
def test_layout(drive_dir):
    data = drive_dir / 'sensor_data'
    for name in ('LeftVLP', 'RightVLP', 'IMU', 'VRS'):
        lines = (drive_dir / 'calibration' / f'Vehicle2{name}.txt').read_text().splitlines()
        rotation = next(line for line in lines if line.startswith('R:'))
        matrix = np.array(rotation[2:].split(), dtype=float).reshape(3, 3)
        np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-9)
        assert len(next(line for line in lines if line.startswith('T:'))[2:].split()) == 3
    assert {len(row) for row in rows(data / 'xsens_imu.csv')} == {17}
    assert {len(row) for row in rows(data / 'vrs_gps.csv')} == {18}
    entries = [(int(stamp), name) for stamp, name in rows(data / 'data_stamp.csv')]
    assert entries == sorted(entries)
    assert len({stamp for stamp, _ in entries}) == len(entries)
    for side in ('left', 'right'):
        stamps = [int(row[0]) for row in rows(data / f'VLP_{side}_stamp.csv')]
        assert sorted(int(path.stem) for path in (data / f'VLP_{side}').iterdir()) == stamps
        assert [stamp for stamp, name in entries if name == f'velodyne_{side}'] == stamps
    poses = truth(drive_dir)
    inertial = [int(row[0]) for row in rows(data / 'xsens_imu.csv')]
    assert inertial[0] < entries[0][0] + 1 and np.all(np.diff(inertial) > 0)
    assert poses.covers(np.array([stamp for stamp, _ in entries])).all()


@needs_rays
def test_scans_are_as_large_as_those_of_kaist(drive_dir):
    sizes = [
        len(np.fromfile(path, dtype=np.float32)) / 4
        for path in (drive_dir / 'sensor_data').glob('VLP_*/*.bin')
    ]
    assert min(sizes) > 12_000 and max(sizes) < 17_500
    assert np.mean(sizes) == pytest.approx(14_600, rel=0.1)


@needs_rays
def test_fixes_are_of_the_antenna(drive_dir):
    table = np.array([row[:13] for row in rows(drive_dir / 'sensor_data' / 'vrs_gps.csv')])
    stamps = table[:, 0].astype(np.int64)
    poses = truth(drive_dir).interpolate(stamps).matrices()
    antenna = (poses @ T_BASE_VRS)[:, :3, 3]
    latitude, longitude, altitude = table[:, [1, 2, 5]].astype(float).T
    measured = np.stack(pymap3d.geodetic2enu(latitude, longitude, altitude, *gnss.ORIGIN), axis=1)
    assert np.abs(measured - antenna).max() < 5 * 0.02 * gnss.VERTICAL
    np.testing.assert_allclose(
        table[:, [3, 4]].astype(float) - gnss.ORIGIN_GRID[:2], measured[:, :2], atol=1e-3
    )


def write_timing(path, lines):
    path.write_text('\n'.join(['stamp_ns,sensor', *lines]) + '\n')
    return path


@needs_rays
def test_timing_file_is_followed_exactly(tmp_path):
    left = [1_544_581_126_000_000_001 + 100_858_123 * i for i in range(3)]
    right = [stamp + 3_400_077 for stamp in left]
    fixes = [left[0] + 5, left[2] - 7]
    named = [('left', left), ('right', right), ('gps', fixes)]
    lines = [f'{stamp},{name}' for name, stamps in named for stamp in reversed(stamps)]
    timing = write_timing(tmp_path / 'timing.csv', lines)
    out_dir = tmp_path / 'drive'
    simulate(out_dir, SimulationOptions(scene=SceneKind.FIELD, timing=timing))
    data = out_dir / 'sensor_data'
    assert [int(row[0]) for row in rows(data / 'VLP_left_stamp.csv')] == left
    assert [int(row[0]) for row in rows(data / 'VLP_right_stamp.csv')] == right
    assert [(int(row[0]), row[6]) for row in rows(data / 'vrs_gps.csv')] == [
        (stamp, '4') for stamp in fixes
    ]
    inertial = [int(row[0]) for row in rows(data / 'xsens_imu.csv')]
    assert inertial[0] <= left[0] - 200_000_000 + 300_000
    assert inertial[-1] >= right[-1] + 100_000_000 - 300_000


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('stamp,sensor\n1544581126000000000,left\n', 'the columns are'),
        ('', 'the columns are'),
        ('stamp_ns,sensor\n', 'holds no stamp'),
        ('stamp_ns,sensor\n1544581126000000000,middle\n', 'line 2 is'),
        ('stamp_ns,sensor\n1544581126.5,left\n', 'whole nanoseconds'),
        ('stamp_ns,sensor\n1544581126,left\n', 'whole nanoseconds'),
        ('stamp_ns,sensor\n1544581126000000000\n', 'line 2 is'),
        ('stamp_ns,sensor\n' + '1544581126000000000,gps\n' * 2, 'twice'),
        ('stamp_ns,sensor\n1544581126000000000,gps\n1554581126000000000,gps\n', 'the most is'),
    ],
)
@needs_rays
def test_bad_timing_files(tmp_path, text, message):
    timing = tmp_path / 'timing.csv'
    timing.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        simulate(tmp_path / 'drive', SimulationOptions(timing=timing))
    assert str(timing) in str(caught.value)
    assert not (tmp_path / 'drive').exists()


@needs_rays
def test_missing_timing_file(tmp_path):
    with pytest.raises(InputError, match=r'none\.csv'):
        simulate(tmp_path / 'drive', SimulationOptions(timing=tmp_path / 'none.csv'))


@needs_rays
def test_folders_in_use(drive_dir, tmp_path):
    before = contents(drive_dir)
    with pytest.raises(OutputError, match='--force'):
        simulate(drive_dir, SHORT)
    foreign = tmp_path / 'foreign'
    (foreign / 'sensor_data').mkdir(parents=True)
    with pytest.raises(OutputError, match='no simulation wrote'):
        simulate(foreign, SimulationOptions(duration=1.0, overwrite=True))
    (tmp_path / 'file').write_text('')
    with pytest.raises(OutputError, match='is a file'):
        simulate(tmp_path / 'file', SHORT)
    assert contents(drive_dir) == before


@needs_rays
def test_force_replaces_a_drive_and_keeps_the_rest(tmp_path):
    first = SimulationOptions(scene=SceneKind.FIELD, duration=1.2, overwrite=True)
    (tmp_path / 'notes.txt').write_text('mine')
    simulate(tmp_path, first)
    own = tmp_path / 'sensor_data' / 'VLP_left' / 'own.bin'
    own.write_bytes(b'mine')
    counts: list[int] = []
    second = SimulationOptions(scene=SceneKind.FIELD, duration=1.0, seed=9, overwrite=True)
    simulate(tmp_path, second, counts.append)
    own.unlink()
    scans = list((tmp_path / 'sensor_data').glob('VLP_*/*.bin'))
    assert len(scans) == sum(counts) == 20
    assert (tmp_path / 'notes.txt').read_text() == 'mine'


def test_without_the_ray_caster(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, 'embreex', None)
    with pytest.raises(InputError, match='pip install'):
        simulate(tmp_path / 'drive', SHORT)
    assert not (tmp_path / 'drive').exists()


@pytest.mark.parametrize('values', [{'duration': 0.0}, {'duration': float('nan')}, {'seed': -1}])
def test_options_out_of_range(values):
    with pytest.raises(ConfigError):
        SimulationOptions(**values)


def parse(words):
    parser = argparse.ArgumentParser()
    command.add_parser(parser.add_subparsers())
    return parser.parse_args(['simulate', *words])


@needs_rays
def test_command(tmp_path, capsys):
    args = parse([str(tmp_path / 'out'), '--scene', 'field', '--motion', 'zero', '--duration', '1'])
    assert args.func(args) == 0
    assert '20 scans' in capsys.readouterr().out
    poses = truth(tmp_path / 'out')
    assert np.ptp(poses.positions, axis=0).max() < 1e-9


def test_command_with_two_durations():
    args = parse(['out', '--duration', '3', '--timing', 'x.csv'])
    with pytest.raises(MapperError, match='exclude'):
        args.func(args)


@needs_rays
def test_points_are_raw(drive_dir):
    """The file's own order of points tells the azimuths, which turn clockwise all the way."""
    path = sorted((drive_dir / 'sensor_data' / 'VLP_left').iterdir())[0]
    points = np.fromfile(path, dtype=np.float32).reshape(-1, 4)
    azimuth = np.unwrap(np.arctan2(points[:, 1], points[:, 0]).astype(float))
    assert np.all(np.diff(azimuth) < 1e-3)
    assert azimuth[0] - azimuth[-1] == pytest.approx(2 * np.pi, abs=0.2)
