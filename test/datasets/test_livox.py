"""Livox's CustomMsg, as its drivers serialise it."""

import numpy as np
import pytest
from bag_files import MS, START, STORES
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import get_types_from_msg

from incremental_mapper.datasets.livox import LIVOX_TYPES, livox_cloud
from incremental_mapper.datasets.open import open_source
from incremental_mapper.errors import MeasurementError

POINTS = np.random.default_rng(1).uniform(-40, 40, (500, 3)).astype(np.float32)
OFFSETS = (np.arange(500) * 199_000).astype(np.uint32)
LIGHT = np.arange(500) % 256
DEFINITION = """std_msgs/Header header
uint64 timebase
uint32 point_num
uint8 lidar_id
uint8[3] rsvd
{package}/CustomPoint[] points
"""
POINT = """uint32 offset_time
float32 x
float32 y
float32 z
uint8 reflectivity
uint8 tag
uint8 line
"""


def store(kind, ros):
    package = kind.split('/')[0]
    types = STORES[ros]
    found = get_types_from_msg(DEFINITION.format(package=package), kind)
    found |= get_types_from_msg(POINT, f'{package}/msg/CustomPoint')
    if kind not in types.types:
        types.register(found)
    return types


def custom(kind, stamp, ros, frame='livox_frame'):
    """A message with the random points."""
    types = store(kind, ros).types
    time = types['builtin_interfaces/msg/Time'](sec=stamp // 10**9, nanosec=stamp % 10**9)
    extra = {'seq': 7} if ros == 1 else {}
    header = types['std_msgs/msg/Header'](stamp=time, frame_id=frame, **extra)
    point = types[f'{kind.split("/")[0]}/msg/CustomPoint']
    points = [
        point(int(t), *map(float, xyz), int(light), 16, 3)
        for t, xyz, light in zip(OFFSETS, POINTS, LIGHT, strict=True)
    ]
    return types[kind](header, stamp, len(points), 1, np.zeros(3, np.uint8), points)


def serialised(made, ros):
    types = STORES[ros]
    write = types.serialize_cdr if ros == 2 else types.serialize_ros1
    return bytes(write(made, made.__msgtype__))


def bag(path, kind, ros):
    if ros == 1:
        writer = Writer1(path.with_suffix('.bag'))
    else:
        writer = Writer2(path, version=9, storage_plugin=StoragePlugin.MCAP)
    with writer:
        connection = writer.add_connection('/livox/lidar', kind, typestore=store(kind, ros))
        for i in range(3):
            stamp = START + i * 100 * MS
            writer.write(connection, stamp, serialised(custom(kind, stamp, ros), ros))
    return path.with_suffix('.bag') if ros == 1 else path


@pytest.mark.parametrize('kind', LIVOX_TYPES)
@pytest.mark.parametrize('ros', [1, 2])
def test_clouds_of_a_livox_are_read(tmp_path, kind, ros):
    source = open_source(bag(tmp_path / 'bag', kind, ros), {})
    assert source.info.counts == {'lidar': 3}
    scans = list(source.measurements())
    assert [scan.stamp for scan in scans] == [START + i * 100 * MS for i in range(3)]
    np.testing.assert_array_equal(scans[0].points, POINTS)
    np.testing.assert_array_equal(scans[0].intensities, LIGHT)
    np.testing.assert_allclose(scans[0].point_times, OFFSETS * 1e-9, atol=1e-8)
    assert any("'offset_time' in ns" in note for note in source.info.notes)


def test_a_settings_file_may_name_the_topic(tmp_path):
    tree = {'lidars': {'names': ['mid360'], 'mid360': {'topic': 'livox/lidar'}}}
    source = open_source(bag(tmp_path / 'bag', LIVOX_TYPES[1], 2), tree)
    assert source.info.counts == {'mid360': 3}


@pytest.mark.parametrize('frame', ['', 'a', 'ab', 'abc', 'livox_frame_12'])
@pytest.mark.parametrize('ros', [1, 2])
def test_the_frame_moves_what_stands_behind_it(frame, ros):
    data = serialised(custom(LIVOX_TYPES[0], START, ros, frame), ros)
    cloud = livox_cloud(data, ros1=ros == 1)
    assert cloud.header.frame_id == frame and cloud.width == 500
    assert cloud.header.stamp.sec == START // 10**9


@pytest.mark.parametrize('ros', [1, 2])
def test_cut_messages_are_counted(ros):
    data = serialised(custom(LIVOX_TYPES[0], START, ros), ros)
    for length in (0, 3, 10, 20, 40, 60, len(data) // 2, len(data) - 1):
        with pytest.raises(MeasurementError):
            livox_cloud(data[:length], ros1=ros == 1)
