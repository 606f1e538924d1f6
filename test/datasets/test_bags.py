"""Bags of every kind: choice of topics, real recordings, and damaged or foreign input."""

import sqlite3
from pathlib import Path

import numpy as np
import pytest
from bag_files import CLOUD, IMU, MS, ODOMETRY, START, TEXT, USUAL, count, write_bag, write_ros1
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from incremental_mapper.datasets.bags import BagSource
from incremental_mapper.datasets.open import open_source
from incremental_mapper.errors import ConfigError, InputError
from incremental_mapper.measurements import GnssFix, ImuSample, LidarScan
from incremental_mapper.settings import make_config, merge, write_ros_yaml

EXPECTED = {'points_left': 4, 'points_right': 4, 'imu': 40, 'gnss': 8}


@pytest.mark.parametrize(
    'make',
    [
        lambda p: write_bag(p / 'bag'),
        lambda p: next(write_bag(p / 'bag').glob('*.mcap')),
        lambda p: write_bag(p / 'bag', plugin=StoragePlugin.SQLITE3),
        lambda p: next(write_bag(p / 'bag', plugin=StoragePlugin.SQLITE3).glob('*.db3')),
        lambda p: write_bag(p / 'bag', mode=CompressionMode.STORAGE),
        lambda p: write_bag(p / 'bag', mode=CompressionMode.MESSAGE),
        lambda p: write_ros1(p / 'old.bag'),
    ],
    ids=['mcap', 'mcap-file', 'sqlite3', 'db3-file', 'zstd', 'zstd-messages', 'ros1'],
)
def test_every_kind_of_bag(tmp_path, make):
    source = open_source(make(tmp_path), {})
    assert count(source) == EXPECTED == source.info.counts
    assert source.drops == {}
    measurements = list(source.measurements())
    stamps = [m.stamp for m in measurements]
    assert stamps == sorted(stamps) and stamps[0] == START
    assert source.info.duration == pytest.approx(0.393, abs=1e-6)
    scan = next(m for m in measurements if isinstance(m, LidarScan))
    np.testing.assert_array_equal(scan.points.ravel(), np.arange(1, 31))
    assert {type(m) for m in measurements} == {LidarScan, ImuSample, GnssFix}
    assert source.truth() is None


def test_folders_of_loose_files(tmp_path):
    bag = write_bag(tmp_path / 'bag')
    (bag / 'metadata.yaml').unlink()
    assert count(open_source(bag, {})) == EXPECTED
    (bag / 'second.mcap').write_bytes((bag / 'bag.mcap').read_bytes())
    with pytest.raises(InputError, match=r'2 bag files but no metadata\.yaml'):
        open_source(bag, {})
    folder = tmp_path / 'ros1'
    folder.mkdir()
    write_ros1(folder / 'a.bag')
    assert count(open_source(folder, {})) == EXPECTED


def test_configured_lidars_find_their_topics(tmp_path):
    source = BagSource(write_bag(tmp_path / 'bag'), {'lidars': {'names': ['left', 'right']}})
    assert count(source) == {'left': 4, 'right': 4, 'imu': 40, 'gnss': 8}
    assert source.info.settings['lidars']['left'] == {'topic': '/points_left'}
    assert source.info.settings['imu'] == {'topic': '/imu'}


def test_topics_of_the_settings_win(tmp_path):
    tree = {
        'lidars': {'names': ['roof'], 'roof': {'topic': 'points_right', 'time_offset': 0.5}},
        'imu': {'topic': '/imu'},
    }
    source = BagSource(write_bag(tmp_path / 'bag'), tree)
    scans = [m for m in source.measurements() if isinstance(m, LidarScan)]
    assert [s.sensor for s in scans] == ['roof'] * 4
    assert scans[0].stamp == START + 537 * MS
    make_config(merge(source.info.settings, tree))


def test_one_configured_lidar_takes_the_only_cloud(tmp_path):
    topics = [('/velodyne_points', CLOUD, 0, 100, 3)]
    source = BagSource(write_bag(tmp_path / 'bag', topics), {'lidars': {'names': ['left']}})
    assert count(source) == {'left': 3}
    assert [note for note in source.info.notes if 'no sensor_msgs' in note]


def test_a_listed_lidar_may_be_missing(tmp_path):
    tree = {'lidars': {'names': ['left', 'right']}}
    source = BagSource(write_bag(tmp_path / 'bag', USUAL[:1]), tree)
    assert count(source) == {'left': 4}
    assert any('LiDAR right' in note for note in source.info.notes)
    make_config(merge(source.info.settings, tree))


def test_names_from_topics_and_the_richer_imu(tmp_path):
    topics = [
        ('/ns1/velodyne_points', CLOUD, 0, 100, 2),
        ('/ns2/velodyne_points', CLOUD, 1, 100, 2),
        ('/points', CLOUD, 2, 100, 2),
        ('/silent', CLOUD, 2, 100, 0),
        ('/a/imu', IMU, 0, 10, 3),
        ('/b/imu', IMU, 0, 10, 9),
    ]
    source = BagSource(write_bag(tmp_path / 'bag', topics))
    assert count(source) == {'ns1': 2, 'ns2': 2, 'points': 2, 'imu': 9}
    assert 'imu: topic /b/imu has more messages than /a/imu' in source.info.notes


@pytest.mark.parametrize(
    ('tree', 'words'),
    [
        ({'gnss': {'topic': '/imu'}}, 'is sensor_msgs/msg/Imu, expected sensor_msgs/msg/NavSatFix'),
        (
            {'lidars': {'names': ['roof'], 'roof': {'topic': '/chatter'}}},
            'expected sensor_msgs/msg/PointCloud2',
        ),
        ({'lidars': {'names': ['top', 'low']}}, 'no cloud for the LiDARs top, low'),
        (
            {
                'lidars': {
                    'names': ['a', 'b'],
                    'a': {'topic': '/points_left'},
                    'b': {'topic': '/points_left'},
                }
            },
            'a, b have the same topic',
        ),
    ],
)
def test_wrong_topics_are_explained(tmp_path, tree, words):
    with pytest.raises(InputError, match=words):
        BagSource(write_bag(tmp_path / 'bag'), tree)


@pytest.mark.parametrize(
    'topics', [[], [('/points', CLOUD, 0, 100, 0)], [('/chatter', TEXT, 0, 100, 2)]]
)
def test_bag_without_clouds(tmp_path, topics):
    with pytest.raises(InputError, match=r'no LiDAR messages.*The bag has'):
        BagSource(write_bag(tmp_path / 'bag', topics))


def test_settings_beside_the_bag(tmp_path):
    bag = write_bag(tmp_path / 'bag')
    turned = [0.0, -1.0, 0.0, 1.0, 1.0, 0.0, 0.0, 2.0, 0.0, 0.0, 1.0, 3.0]
    own = {
        'lidars': {
            'names': ['left', 'right'],
            'left': {'topic': '/points_left', 'T_base_sensor': turned},
            'right': {'topic': '/points_right'},
        },
        'imu': {'topic': '/imu', 'time_offset': 0.25},
    }
    write_ros_yaml(bag / 'incremental_mapper.yaml', own)
    source = BagSource(bag)
    assert count(source) == {'left': 4, 'right': 4, 'imu': 40, 'gnss': 8}
    assert source.info.settings['lidars']['left']['T_base_sensor'] == turned
    sample = next(m for m in source.measurements() if isinstance(m, ImuSample))
    assert sample.stamp == START + 253 * MS
    tree = {'lidars': {'names': ['left']}}
    source = BagSource(bag, tree)
    assert count(source) == {'left': 4, 'imu': 40, 'gnss': 8}
    make_config(merge(source.info.settings, tree))
    (bag / 'incremental_mapper.yaml').write_text('imu: {tpoic: /imu}')
    with pytest.raises(ConfigError, match='topic'):
        BagSource(bag)


def test_bad_messages_are_counted_and_the_rest_is_used(tmp_path):
    seen: dict[str, int] = {}

    def damage(topic: str, data: bytes) -> bytes:
        seen[topic] = seen.get(topic, 0) + 1
        return data[: len(data) // 2] if seen[topic] == 2 else data

    source = BagSource(write_bag(tmp_path / 'bag', damage=damage))
    assert count(source) == {'points_left': 3, 'points_right': 3, 'imu': 39, 'gnss': 7}
    assert {key: n for key, n in source.drops.items() if n != 1} == {}
    assert {sensor for sensor, _ in source.drops} == set(EXPECTED)


def test_stamps_of_zero_are_counted(tmp_path):
    seen: list[str] = []

    def damage(topic: str, data: bytes) -> bytes:
        seen.append(topic)
        zero = topic == '/fix' and seen.count('/fix') % 2 == 0
        return data[:4] + bytes(8) + data[12:] if zero else data

    source = BagSource(write_bag(tmp_path / 'bag', damage=damage))
    assert count(source)['gnss'] == 4
    assert source.drops == {('gnss', 'no_stamp'): 4}


def damaged(path: Path, begin: float, end: float) -> Path:
    data = bytearray(path.read_bytes())
    low, high = int(len(data) * begin), int(len(data) * end)
    data[low:high] = b'\x5a' * (high - low)
    path.write_bytes(bytes(data))
    return path


@pytest.mark.parametrize('begin', [0.0, 0.02, 0.3, 0.6, 0.9, 0.98])
@pytest.mark.parametrize('kind', ['mcap', 'db3', 'bag', 'zstd'])
def test_damage_never_makes_a_traceback(tmp_path, kind, begin):
    if kind == 'bag':
        path = write_ros1(tmp_path / 'old.bag')
    else:
        plugin = StoragePlugin.SQLITE3 if kind == 'db3' else StoragePlugin.MCAP
        mode = CompressionMode.STORAGE if kind == 'zstd' else None
        bag = write_bag(tmp_path / 'bag', plugin=plugin, mode=mode)
        path = next(file for file in bag.iterdir() if file.suffix != '.yaml')
    damaged(path, begin, begin + 0.05)
    try:
        source = open_source(path, {})
        read = sum(count(source).values())
    except InputError as error:
        assert str(path) in str(error)
    else:
        assert read + sum(source.drops.values()) == source.info.count


# Nine tenths of the small MCAP file hold all its messages.
@pytest.mark.parametrize(
    ('kind', 'share'),
    [
        (kind, share)
        for kind in ('mcap', 'db3', 'bag')
        for share in (0.0, 0.01, 0.5, 0.9)
        if (kind, share) != ('mcap', 0.9)
    ],
)
def test_truncated_bags_are_refused_in_one_line(tmp_path, kind, share):
    if kind == 'bag':
        path = write_ros1(tmp_path / 'old.bag')
    else:
        plugin = StoragePlugin.SQLITE3 if kind == 'db3' else StoragePlugin.MCAP
        bag = write_bag(tmp_path / 'bag', plugin=plugin)
        path = next(file for file in bag.iterdir() if file.suffix != '.yaml')
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    with pytest.raises(InputError) as caught:
        list(open_source(path, {}).measurements())
    assert '\n' not in str(caught.value) and str(path) in str(caught.value)


def test_a_bag_that_breaks_off_keeps_its_beginning(tmp_path):
    bag = write_bag(tmp_path / 'bag', [('/points', CLOUD, 0, 100, 9000)])
    data = bytearray((bag / 'bag.mcap').read_bytes())
    middle = len(data) // 2
    data[middle : middle + 200_000] = bytes(200_000)
    (bag / 'bag.mcap').write_bytes(bytes(data))
    source = BagSource(bag)
    read = count(source)['points']
    assert 0 < read < 9000
    assert read + sum(source.drops.values()) == 9000
    assert source.drops['points', 'damaged'] > 0


def test_metadata_without_storage(tmp_path):
    bag = write_bag(tmp_path / 'bag')
    (bag / 'bag.mcap').unlink()
    with pytest.raises(InputError, match='missing'):
        open_source(bag, {})
    (bag / 'metadata.yaml').write_text('nonsense: [')
    with pytest.raises(InputError, match='cannot be read as a bag'):
        open_source(bag, {})


def test_database_of_something_else(tmp_path):
    path = tmp_path / 'other.db3'
    with sqlite3.connect(path) as connection:
        connection.execute('CREATE TABLE stuff (x)')
    with pytest.raises(InputError, match='cannot be read as a bag'):
        open_source(path, {})


def test_truth_of_a_topic_and_of_files(tmp_path):
    topics = [*USUAL, ('/ground_truth/odometry', ODOMETRY, 0, 10, 30)]
    truth = BagSource(write_bag(tmp_path / 'with', topics)).truth()
    assert len(truth) == 30 and truth.stamps[1] == START + 10 * MS
    np.testing.assert_array_equal(truth.positions[0], [1, 2, 3])
    bag = write_bag(tmp_path / 'without')
    (tmp_path / 'ground_truth.tum').write_text('5.0 9 9 9 0 0 0 1\n')
    assert BagSource(bag).truth() is None, 'truth of another time must not be taken'
    (bag / 'ground_truth.tum').write_text(f'{START // 10**9}.1 4 5 6 0 0 0 1\n')
    np.testing.assert_array_equal(BagSource(bag).truth().positions, [[4, 5, 6]])
