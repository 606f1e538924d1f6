"""KAIST folders: order, values, and everything that may be wrong with such a folder."""

from pathlib import Path

import numpy as np
import pytest
from kaist_folders import IDENTITY, MS, START, make_folder, write_calibration, write_lines

from incremental_mapper.datasets.kaist import KaistSource
from incremental_mapper.datasets.open import open_source, read_truth
from incremental_mapper.errors import ConfigError, InputError
from incremental_mapper.measurements import FixStatus, GnssFix, ImuSample, LidarScan

DATA = Path(__file__).resolve().parents[3] / 'shared' / 'data'


def of(source, kind):
    return [m for m in source.measurements() if isinstance(m, kind)]


@pytest.fixture
def folder(tmp_path):
    return make_folder(tmp_path / 'urban00')


def test_measurements_come_in_the_order_of_their_stamps(folder):
    source = KaistSource(folder)
    measurements = list(source.measurements())
    stamps = [m.stamp for m in measurements]
    assert stamps == sorted(stamps)
    assert source.info.counts == {'left': 4, 'right': 4, 'imu': 40, 'gnss': 8}
    assert source.drops == {('gnss', 'no_fix'): 2}
    assert len(measurements) == source.info.count - 2
    assert source.info.duration == pytest.approx(0.393, abs=1e-6)


def test_values_and_units(folder):
    source = KaistSource(folder)
    scan = of(source, LidarScan)[0]
    raw = np.fromfile(folder / 'sensor_data' / 'VLP_left' / f'{START}.bin', '<f4').reshape(-1, 4)
    np.testing.assert_array_equal(scan.points, raw[:, :3])
    sample = of(source, ImuSample)[1]
    assert sample.stamp == START + 13 * MS + 11
    np.testing.assert_array_equal(sample.gyro, [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(sample.acceleration, [1, 2, 10])
    np.testing.assert_array_equal(sample.orientation, [0, 0, 0, 1])
    fixes = of(source, GnssFix)
    assert [f.status for f in fixes[:3]] == [FixStatus.GBAS, FixStatus.SBAS, FixStatus.FIX]
    assert (fixes[1].latitude, fixes[1].longitude, fixes[1].altitude) == (36.5, 127.25, 100.0)
    # East comes first: the standard deviation of the longitude.
    np.testing.assert_allclose(np.diag(fixes[0].covariance), [0.0009, 0.0004, 0.0016])


def test_extrinsics_and_truth(folder):
    source = KaistSource(folder)
    settings = source.info.settings
    assert settings['lidars']['names'] == ['left', 'right']
    expected = [-1, 0, 0, -1.5, 0, -1, 0, 0.5, 0, 0, 1, 1.75]
    assert settings['lidars']['left']['T_base_sensor'] == expected
    assert settings['gnss']['T_base_sensor'][3] == -0.32
    truth = source.truth()
    assert len(truth) == 40
    np.testing.assert_array_equal(truth.positions[2], [20, 5, 6])


def test_second_run_counts_its_drops_anew(folder):
    source = KaistSource(folder)
    first = len(list(source.measurements()))
    assert len(list(source.measurements())) == first
    assert source.drops == {('gnss', 'no_fix'): 2}


def test_time_offset_moves_the_stamps(folder):
    source = KaistSource(folder, {'imu': {'time_offset': 0.001}})
    assert of(source, ImuSample)[0].stamp == START + 4 * MS + 11


def test_damaged_clouds_are_counted(folder):
    clouds = folder / 'sensor_data' / 'VLP_left'
    names = sorted(clouds.iterdir())
    names[0].write_bytes(names[0].read_bytes()[:-3])
    names[1].write_bytes(b'')
    np.full((5, 4), np.nan, '<f4').tofile(names[2])
    names[3].unlink()
    source = KaistSource(folder)
    scans = of(source, LidarScan)
    assert [s.sensor for s in scans] == ['right'] * 4
    assert {k: n for k, n in source.drops.items() if k[0] == 'left'} == {
        ('left', 'truncated'): 1,
        ('left', 'empty_cloud'): 1,
        ('left', 'no_finite_points'): 1,
        ('left', 'missing_file'): 1,
    }


def test_nan_and_infinite_points_are_removed(folder):
    path = folder / 'sensor_data' / 'VLP_left' / f'{START}.bin'
    points = np.fromfile(path, '<f4').reshape(-1, 4)
    points[3, 1], points[5, 2] = np.nan, np.inf
    points.tofile(path)
    scan = of(KaistSource(folder), LidarScan)[0]
    assert scan.points.shape == (18, 3) and np.isfinite(scan.points).all()


def test_unsorted_and_repeated_stamps_stay_sorted_and_are_not_dropped(folder):
    path = folder / 'sensor_data' / 'xsens_imu.csv'
    lines = path.read_text().splitlines()
    write_lines(path, [lines[5], *lines, lines[7]])
    source = KaistSource(folder)
    stamps = [m.stamp for m in source.measurements()]
    assert stamps == sorted(stamps)
    assert len(of(source, ImuSample)) == 42


def test_malformed_lines_are_counted(folder):
    path = folder / 'sensor_data' / 'xsens_imu.csv'
    lines = path.read_text().splitlines()
    bad = ['', 'garbage', lines[0][:40], '-5,' + lines[0], '0,' + lines[0].partition(',')[2]]
    huge = f'{10**30},' + lines[0].partition(',')[2]
    not_finite = lines[1].replace('0.1,', 'nan,')
    write_lines(path, [*bad, huge, not_finite, '\udcff'.encode('utf-8', 'replace'), *lines])
    source = KaistSource(folder)
    assert len(of(source, ImuSample)) == 40
    assert source.drops['imu', 'bad_line'] == 6
    assert source.drops['imu', 'not_finite'] == 1


def test_first_release_without_gyro(folder):
    path = folder / 'sensor_data' / 'xsens_imu.csv'
    write_lines(path, [','.join(line.split(',')[:8]) for line in path.read_text().splitlines()])
    source = KaistSource(folder)
    assert source.drops['imu', 'no_gyro'] == 40
    assert of(source, ImuSample) == [] and 'imu' not in source.info.counts
    assert any('xsens_imu.csv' in note for note in source.info.notes)


@pytest.mark.parametrize('file', ['xsens_imu.csv', 'vrs_gps.csv'])
def test_optional_sensors_may_be_missing(folder, file):
    (folder / 'sensor_data' / file).unlink()
    source = KaistSource(folder)
    assert len(of(source, LidarScan)) == 8
    assert any(file in note for note in source.info.notes)


def test_one_lidar(tmp_path):
    source = KaistSource(make_folder(tmp_path / 'one', right=False))
    assert {s.sensor for s in of(source, LidarScan)} == {'left'}
    assert source.info.settings['lidars']['names'] == ['left']
    assert any('VLP_right' in note for note in source.info.notes)


def test_settings_may_list_one_lidar_or_a_missing_one(tmp_path):
    both = make_folder(tmp_path / 'both')
    source = KaistSource(both, {'lidars': {'names': ['right']}})
    assert {s.sensor for s in of(source, LidarScan)} == {'right'}
    one = make_folder(tmp_path / 'one', right=False)
    source = KaistSource(one, {'lidars': {'names': ['left', 'right']}})
    assert {s.sensor for s in of(source, LidarScan)} == {'left'}
    with pytest.raises(InputError, match='roof'):
        KaistSource(both, {'lidars': {'names': ['left', 'roof']}})
    with pytest.raises(InputError, match='right'):
        KaistSource(one, {'lidars': {'names': ['right']}})
    with pytest.raises(ConfigError):
        KaistSource(both, {'lidar': {}})


def test_stamp_files_may_be_missing(folder):
    (folder / 'sensor_data' / 'VLP_left_stamp.csv').unlink()
    (folder / 'sensor_data' / 'VLP_left' / 'readme.bin').write_bytes(b'')
    source = KaistSource(folder)
    assert source.info.counts['left'] == 4
    assert source.drops['left', 'bad_name'] == 1


def test_scans_that_are_numbered_are_refused_with_the_names_that_are_looked_for(folder):
    for number, path in enumerate(sorted((folder / 'sensor_data' / 'VLP_left').glob('*.bin'))):
        path.rename(path.with_name(f'{number:06}.bin'))
    with pytest.raises(InputError, match=rf'such as {START}\.bin.*such as 000000\.bin'):
        KaistSource(folder)


@pytest.mark.parametrize('name', ['LeftVLP', 'RightVLP', 'IMU', 'VRS'])
def test_missing_calibration(folder, name):
    (folder / 'calibration' / f'Vehicle2{name}.txt').unlink()
    with pytest.raises(InputError, match=f'Vehicle2{name}.txt: does not exist'):
        KaistSource(folder)


@pytest.mark.parametrize(
    ('rotation', 'translation', 'message'),
    [
        ('2 0 0 0 1 0 0 0 1', '0 0 0', 'R is 2 0 0 .*no rotation'),
        ('-1 0 0 0 1 0 0 0 1', '0 0 0', 'no rotation'),
        ('nan 0 0 0 1 0 0 0 1', '0 0 0', '"R:" with 9 numbers'),
        ('1 0 0 0 1 0 0 0', '0 0 0', '"R:" with 9 numbers'),
        (IDENTITY, 'a b c', '"T:" with 3 numbers'),
    ],
)
def test_bad_extrinsic(folder, rotation, translation, message):
    write_calibration(folder, 'LeftVLP', rotation, translation)
    with pytest.raises(InputError, match=message) as caught:
        KaistSource(folder)
    assert 'Vehicle2LeftVLP.txt' in str(caught.value)


def test_no_lidar_at_all(folder):
    for name in ('VLP_left', 'VLP_right'):
        for path in (folder / 'sensor_data' / name).iterdir():
            path.unlink()
        (folder / 'sensor_data' / f'{name}_stamp.csv').write_text('')
    with pytest.raises(InputError, match='no LiDAR scans'):
        KaistSource(folder)


@pytest.mark.parametrize('make', ['missing', 'empty', 'other', 'file'])
def test_anything_else_is_named_with_what_was_expected(tmp_path, make):
    path = tmp_path / 'input'
    if make == 'file':
        path.write_text('x')
    elif make != 'missing':
        path.mkdir()
    if make == 'other':
        (path / 'photo.png').write_text('x')
    with pytest.raises(InputError, match='expected a rosbag2 folder'):
        open_source(path, {})


def test_global_pose_skips_broken_lines(tmp_path):
    path = tmp_path / 'global_pose.csv'
    good = f'{START},1,0,0,1,0,1,0,2,0,0,1,3'
    write_lines(
        path, [good, f'{START + 1},9,0,0,1,0,1,0,2,0,0,1,3', f'{START + 2},1,0,0,nan', good]
    )
    truth = read_truth(path)
    assert len(truth) == 1
    np.testing.assert_array_equal(truth.positions, [[1, 2, 3]])
    write_lines(path, ['a,b,c'])
    with pytest.raises(InputError, match='no pose'):
        read_truth(path)
    with pytest.raises(InputError, match='is no file'):
        read_truth(tmp_path / 'nothing.tum')


def test_truth_may_be_tum(tmp_path):
    path = tmp_path / 'truth.txt'
    path.write_text('# stamp x y z qx qy qz qw\n12.500000001 1 2 3 0 0 0 1\n')
    assert read_truth(path).stamps.tolist() == [12_500_000_001]


def test_real_scans():
    path = DATA / 'kaist_urban30_left'
    if not path.is_dir():
        pytest.skip(f'{path} is absent')
    source = open_source(path, {})
    scans = list(source.measurements())
    assert [s.stamp for s in scans] == sorted(int(file.stem) for file in path.glob('*.bin'))
    assert source.drops == {} and all(len(s.points) > 14_000 for s in scans)
    assert source.info.settings['lidars']['names'] == ['left']
    assert 'no calibration' in source.info.notes[0]
