"""A KAIST folder and its converted bag give the same measurements."""

import argparse
import os
from dataclasses import fields

import numpy as np
import pytest
from kaist_folders import make_folder
from rosbags.highlevel import AnyReader

from incremental_mapper.cli.convert import add_parser, convert
from incremental_mapper.datasets.bag_writer import FEWEST_TIMED
from incremental_mapper.datasets.bags import BagSource
from incremental_mapper.datasets.kaist import KaistSource
from incremental_mapper.errors import InputError, OutputError
from incremental_mapper.measurements import LidarScan
from incremental_mapper.settings import make_config


@pytest.fixture
def folder(tmp_path):
    return make_folder(tmp_path / 'urban00')


def assert_same(one, other):
    assert type(one) is type(other)
    for field in fields(one):
        np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name))


@pytest.mark.parametrize('right', [True, False])
def test_folder_and_bag_are_the_same_source(tmp_path, right):
    folder = make_folder(tmp_path / 'urban00', right=right)
    clouds = sorted((folder / 'sensor_data' / 'VLP_left').iterdir())
    clouds[0].write_bytes(clouds[0].read_bytes()[:-1])
    clouds[1].write_bytes(b'')
    np.full((5, 4), np.nan, '<f4').tofile(clouds[2])
    imu = folder / 'sensor_data' / 'xsens_imu.csv'
    imu.write_text(imu.read_text() + imu.read_text().splitlines()[3].replace('0.1,', 'nan,'))
    summary = convert(folder, tmp_path / 'bag')
    kaist, bag = KaistSource(folder), BagSource(tmp_path / 'bag')
    expected, found = list(kaist.measurements()), list(bag.measurements())
    assert len(expected) == len(found) > 40
    for one, other in zip(expected, found, strict=True):
        assert_same(one, other)
    assert kaist.drops == summary.drops + bag.drops
    ours, theirs = make_config(kaist.info.settings), make_config(bag.info.settings)
    assert list(ours.lidars) == list(theirs.lidars)
    for name, sensor in ours.lidars.items():
        np.testing.assert_array_equal(sensor.matrix(), theirs.lidars[name].matrix())
    np.testing.assert_array_equal(ours.imu.matrix(), theirs.imu.matrix())
    np.testing.assert_array_equal(ours.gnss.matrix(), theirs.gnss.matrix())
    np.testing.assert_array_equal(kaist.truth().stamps, bag.truth().stamps)
    np.testing.assert_array_equal(kaist.truth().matrices(), bag.truth().matrices())


def write_sweeps(folder, points):
    """A turn of so many points as every cloud."""
    azimuths = -np.linspace(0.0, 2.0 * np.pi, points)
    sweep = np.column_stack([np.cos(azimuths), np.sin(azimuths), 0.0 * azimuths, 0.0 * azimuths])
    for path in (folder / 'sensor_data').glob('VLP_*/*.bin'):
        (9.0 * sweep).astype('<f4').tofile(path)


def test_times_by_the_order_of_firing_are_those_of_the_folder(folder, tmp_path):
    write_sweeps(folder, FEWEST_TIMED)
    convert(folder, tmp_path / 'bag')
    sources = KaistSource(folder), BagSource(tmp_path / 'bag')
    scans = [[m for m in it.measurements() if isinstance(m, LidarScan)] for it in sources]
    assert len(scans[0]) == len(scans[1]) == 8
    for one, other in zip(*scans, strict=True):
        np.testing.assert_allclose(one.point_times, np.linspace(-0.1, 0.0, FEWEST_TIMED), atol=1e-7)
        assert_same(one, other)


def test_a_cloud_that_was_thinned_has_x_y_z_and_intensity_alone(folder, tmp_path):
    write_sweeps(folder, FEWEST_TIMED - 1)
    convert(folder, tmp_path / 'bag')
    with AnyReader([tmp_path / 'bag']) as reader:
        clouds = [c for c in reader.connections if c.topic == '/points_left']
        for connection, _, data in reader.messages(clouds):
            message = reader.deserialize(data, connection.msgtype)
            assert [field.name for field in message.fields] == ['x', 'y', 'z', 'intensity']


def test_what_the_bag_holds(folder, tmp_path):
    summary = convert(folder, tmp_path / 'bag')
    assert summary.messages == {
        '/points_left': 4,
        '/points_right': 4,
        '/imu': 40,
        '/fix': 8,
        '/ground_truth/odometry': 40,
    }
    assert 'note' not in str(summary) and '/imu: 40' in str(summary)
    with AnyReader([tmp_path / 'bag']) as reader:
        statuses = []
        for connection, logged, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            stamp = message.header.stamp
            assert logged == stamp.sec * 10**9 + stamp.nanosec
            if connection.topic == '/points_left':
                assert [f.name for f in message.fields] == ['x', 'y', 'z', 'intensity']
                assert message.header.frame_id == 'left_lidar' and message.width == 20
            elif connection.topic == '/fix':
                statuses.append(message.status.status)
                np.testing.assert_allclose(message.position_covariance[[0, 4]], [9e-4, 4e-4])
            elif connection.topic == '/ground_truth/odometry':
                assert (message.header.frame_id, message.child_frame_id) == ('world', 'base_link')
    assert statuses == [2, 1, 0, -1] * 2
    assert sorted(p.name for p in (tmp_path / 'bag').iterdir()) == [
        'bag.mcap',
        'incremental_mapper.yaml',
        'metadata.yaml',
    ]
    assert sorted(p.name for p in tmp_path.iterdir()) == ['bag', 'urban00']


def test_missing_sensors_and_truth(folder, tmp_path):
    (folder / 'sensor_data' / 'xsens_imu.csv').unlink()
    (folder / 'sensor_data' / 'vrs_gps.csv').unlink()
    (folder / 'global_pose.csv').unlink()
    summary = convert(folder, tmp_path / 'bag')
    assert set(summary.messages) == {'/points_left', '/points_right'}
    assert 'note: imu' in str(summary)
    assert BagSource(tmp_path / 'bag').info.counts == {'left': 4, 'right': 4}


def test_existing_output_needs_force_and_keeps_other_files(folder, tmp_path):
    out = tmp_path / 'bag'
    convert(folder, out)
    (out / 'notes.txt').write_text('mine')
    (out / 'bag.mcap').write_text('old')
    with pytest.raises(OutputError, match='--force'):
        convert(folder, out)
    assert (out / 'bag.mcap').read_text() == 'old'
    convert(folder, out, force=True)
    assert (out / 'notes.txt').read_text() == 'mine'
    assert BagSource(out).info.counts['imu'] == 40


def test_force_spares_a_foreign_bag_and_the_input(folder, tmp_path):
    convert(folder, tmp_path / 'first')
    foreign = (tmp_path / 'first').rename(tmp_path / 'renamed')
    with pytest.raises(OutputError, match='did not write'):
        convert(folder, foreign, force=True)
    with pytest.raises(OutputError, match='KAIST folder itself'):
        convert(folder, folder, force=True)
    (tmp_path / 'file').write_text('x')
    with pytest.raises(OutputError, match='is a file'):
        convert(folder, tmp_path / 'file', force=True)
    with pytest.raises(OutputError, match='cannot be written'):
        convert(folder, tmp_path / 'file' / 'bag')


def test_failure_leaves_nothing_behind(folder, tmp_path, monkeypatch):
    with pytest.raises(InputError, match='no KAIST folder'):
        convert(tmp_path, tmp_path / 'bag')

    def full(*_):
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr('incremental_mapper.datasets.bag_writer.BagWriter.write', full)
    with pytest.raises(OutputError, match='No space left'):
        convert(folder, tmp_path / 'bag')
    assert sorted(p.name for p in tmp_path.iterdir()) == ['urban00']


@pytest.mark.skipif(os.geteuid() == 0, reason='root may write everywhere')
def test_output_that_may_not_be_written(folder, tmp_path):
    sealed = tmp_path / 'sealed'
    sealed.mkdir(mode=0o500)
    with pytest.raises(OutputError, match='cannot be written'):
        convert(folder, sealed / 'bag')


def test_command_line(folder, tmp_path, capsys):
    parser = argparse.ArgumentParser()
    add_parser(parser.add_subparsers())
    args = parser.parse_args(['convert', str(folder), str(tmp_path / 'bag')])
    assert args.func(args) == 0
    assert '/points_left: 4' in capsys.readouterr().out
