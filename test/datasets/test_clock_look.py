"""Bags and folders whose sensors have several clocks: found, mended, and in their turn."""

import numpy as np
import pytest
from bag_files import MS, START, STORES, USUAL, message, write_bag, write_ros1
from kaist_folders import START as KAIST_START
from kaist_folders import make_folder
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2

from incremental_mapper.checks.finding import Severity
from incremental_mapper.datasets.bag_files import open_bag
from incremental_mapper.datasets.headers import peek_header
from incremental_mapper.datasets.kaist import KaistSource
from incremental_mapper.datasets.open import open_source

SENSORS = USUAL[:4]
HOUR = 3600 * 10**9


def write(path, ahead, logged_ahead=False, ros=2, plugin=StoragePlugin.MCAP, mode=None, zero=()):
    """A bag whose stamps of a topic are ``ahead`` (ns); its record times are right, or go along."""
    path = path / ('a.bag' if ros == 1 else 'bag')
    writer = Writer1(path) if ros == 1 else Writer2(path, version=9, storage_plugin=plugin)
    if mode is not None:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    events = []
    with writer:
        for name, kind, phase, period, count in SENSORS:
            connection = writer.add_connection(name, kind, typestore=STORES[ros])
            for index in range(count):
                at = START + (phase + index * period) * MS
                stamp = 0 if name in zero else at + ahead.get(name, 0)
                logged = stamp if logged_ahead else at + 2 * MS
                events.append((logged, connection, stamp))
        for logged, connection, stamp in sorted(events, key=lambda event: event[0]):
            kind = connection.msgtype
            serialize = STORES[ros].serialize_ros1 if ros == 1 else STORES[2].serialize_cdr
            writer.write(connection, logged, bytes(serialize(message(kind, stamp, ros), kind)))
    return path


KINDS = {
    'mcap': {},
    'sqlite3': {'plugin': StoragePlugin.SQLITE3},
    'zstd': {'mode': CompressionMode.STORAGE},
    'zstd-messages': {'mode': CompressionMode.MESSAGE},
    'ros1': {'ros': 1},
}


def of_clocks(source):
    return [finding for finding in source.info.findings if finding.rule == 'clock_offset']


def assert_mended(source, expected):
    """Each of the sensors has its offset (s), and all measurements come by corrected stamp."""
    said = {finding.sensor: finding for finding in of_clocks(source)}
    assert said.keys() == expected.keys()
    for sensor, seconds in expected.items():
        assert said[sensor].severity is Severity.MENDED
        settings = source.info.settings
        section = settings[sensor] if sensor in settings else settings['lidars'][sensor]
        assert section['time_offset'] == pytest.approx(seconds, abs=1e-6)
    stamps = np.array([m.stamp for m in source.measurements()])
    assert len(stamps) == source.info.count
    assert stamps[0] == pytest.approx(START, abs=1000)
    assert (np.diff(stamps) >= -1000).all()


@pytest.mark.parametrize('logged_ahead', [False, True], ids=['recorded', 'converted'])
@pytest.mark.parametrize('kind', KINDS)
def test_an_hour_is_mended_in_every_kind_of_bag(tmp_path, kind, logged_ahead):
    bag = write(tmp_path, {'/imu': HOUR}, logged_ahead, **KINDS[kind])
    assert_mended(open_source(bag), {'imu': -3600.0})


@pytest.mark.parametrize('kind', KINDS)
def test_a_clock_from_power_up_is_mended(tmp_path, kind):
    shift = 731 * 10**9 - START
    bag = write(tmp_path, {'/points_left': shift, '/points_right': shift}, **KINDS[kind])
    expected = dict.fromkeys(('points_left', 'points_right'), -shift / 1e9)
    assert_mended(open_source(bag), expected)


@pytest.mark.parametrize('make', [write_bag, lambda path: write_ros1(path / 'a.bag')])
def test_headers_are_read_without_their_messages(tmp_path, make):
    (tmp_path / 'x').mkdir()
    reader = open_bag(make(tmp_path / 'x' if make is not write_bag else tmp_path / 'bag'))
    for connection, _, data in reader.messages():
        if connection.topic != '/chatter':
            header = reader.deserialize(data, connection.msgtype).header
            stamp = header.stamp.sec * 10**9 + header.stamp.nanosec
            assert peek_header(data, hasattr(connection.owner, 'indexes')) == (stamp, 'sensor')
    reader.close()


def test_an_offset_of_the_settings_stays_and_is_checked(tmp_path):
    bag = write(tmp_path, {'/imu': HOUR})
    right = open_source(bag, {'imu': {'time_offset': -3600.0}})
    assert of_clocks(right) == []
    assert 'time_offset' not in right.info.settings['imu']
    assert len(list(right.measurements())) == right.info.count
    wrong = open_source(bag, {'imu': {'time_offset': 3600.0}})
    (finding,) = of_clocks(wrong)
    assert finding.severity is Severity.WARNING
    assert finding.remedy == 'set imu.time_offset: -3600.0'
    assert 'time_offset' not in wrong.info.settings['imu']


def test_measurements_of_a_mended_folder_take_their_turn(tmp_path):
    folder = make_folder(tmp_path / 'urban00')
    for name in ('VLP_left', 'VLP_right'):
        (folder / 'sensor_data' / f'{name}_stamp.csv').unlink()
        for path in sorted((folder / 'sensor_data' / name).glob('*.bin')):
            path.rename(path.with_name(f'{int(path.stem) + HOUR}.bin'))
    source = KaistSource(folder)
    assert {f.sensor for f in of_clocks(source)} == {'left', 'right'}
    assert source.info.settings['lidars']['left']['time_offset'] == -3600.0
    stamps = [m.stamp for m in source.measurements()]
    assert stamps == sorted(stamps) and stamps[0] == KAIST_START
    assert sum(source.drops.values()) == 2  # the fixes that are none


@pytest.mark.parametrize('kind', KINDS)
def test_record_times_stand_in_for_stamps_that_are_all_zero(tmp_path, kind):
    bag = write(tmp_path, {}, zero=('/imu',), **KINDS[kind])
    source = open_source(bag)
    assert [f.sensor for f in source.info.findings if f.rule == 'no_stamps'] == ['imu']
    stamps = [m.stamp for m in source.measurements() if m.sensor == 'imu']
    assert stamps == [START + (5 + 10 * i) * MS for i in range(40)]
    assert source.drops == {}


def test_stamps_of_zero_without_record_times_are_told(tmp_path):
    source = open_source(write(tmp_path, {}, logged_ahead=True, zero=('/imu',)))
    (finding,) = [f for f in source.info.findings if f.rule == 'no_stamps']
    assert 'record times tell nothing' in finding.text
    assert {m.sensor for m in source.measurements()} == {'points_left', 'points_right', 'gnss'}
    assert source.drops == {('imu', 'no_stamp'): 40}


def test_without_record_times_the_whole_stretch_of_each_sensor_is_looked_at(tmp_path):
    # By one record time only the first messages are found: the receiver alone begins that late.
    path = tmp_path / 'bag'
    with Writer2(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {
            name: writer.add_connection(name, kind, typestore=STORES[2])
            for name, kind, *_ in SENSORS
        }
        events = [
            (START + (phase + index * period + (300 if name == '/points_left' else 0)) * MS, name)
            for name, kind, phase, period, count in SENSORS
            for index in range(count)
        ]
        for stamp, name in sorted(events):
            kind = connections[name].msgtype
            data = bytes(STORES[2].serialize_cdr(message(kind, stamp, 2), kind))
            writer.write(connections[name], 0, data)
    source = open_source(path)
    assert not [f for f in source.info.findings if f.rule == 'no_common_time']
    assert {m.sensor for m in source.measurements()} >= {'points_left', 'points_right', 'imu'}


def test_stamps_far_from_their_record_times_are_stray_where_most_are_near(tmp_path):
    path = tmp_path / 'bag'
    kind = SENSORS[2][1]
    with Writer2(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        clouds = writer.add_connection(*SENSORS[0][:2], typestore=STORES[2])
        imu = writer.add_connection('/imu', kind, typestore=STORES[2])
        for index in range(60):
            at = START + 10 * index * MS
            # An earlier drive's samples among those of now, as many as one in three.
            stamps = (at, at - 30_000 * MS) if index % 2 else (at,)
            for stamp in stamps:
                data = bytes(STORES[2].serialize_cdr(message(kind, stamp), kind))
                writer.write(imu, at + 2 * MS, data)
            if index % 10 == 0:
                cloud = message(SENSORS[0][1], at)
                writer.write(clouds, at, bytes(STORES[2].serialize_cdr(cloud, SENSORS[0][1])))
    source = open_source(path)
    stamps = [m.stamp for m in source.measurements() if m.sensor == 'imu']
    assert len(stamps) == 60 and min(stamps) == START
    assert source.drops == {('imu', 'stamp_leap'): 30}
