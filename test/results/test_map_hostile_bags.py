"""Bags with faults: what can be used is mapped, the rest is counted by its reason."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from incremental_mapper.datasets.bag_settings import SETTINGS_FILE
from incremental_mapper.measurements import NANOSECONDS

STORE = get_typestore(Stores.ROS2_JAZZY)
NO_FIX, UNKNOWN_STATUS = -1, -2


def read_bag(bag):
    """(log stamp, topic, message) of everything in a bag."""
    with AnyReader([bag], default_typestore=STORE) as reader:
        return [
            (logged, connection.topic, reader.deserialize(data, connection.msgtype))
            for connection, logged, data in reader.messages()
        ]


def write_bag(folder, messages, settings_of=None):
    """A bag of (log stamp, topic, message), with the settings file of another bag beside it."""
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {}
        for logged, topic, message in messages:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], logged, STORE.serialize_cdr(message, kind))
    if settings_of is not None:
        (folder / SETTINGS_FILE).write_text((settings_of / SETTINGS_FILE).read_text())
    return folder


@pytest.fixture(scope='module')
def messages(light_bag):
    return read_bag(light_bag)


@pytest.fixture
def rebuilt(tmp_path, light_bag):
    """Write a bag of other messages with the extrinsics of ``light_bag``."""
    return lambda messages: write_bag(tmp_path / 'bag', messages, light_bag)


def changed(messages, topic, which, change):
    """The messages with message number ``which`` of a topic replaced by ``change`` of it."""
    numbers = [i for i, (_, name, _) in enumerate(messages) if name == topic]
    index = numbers[which]
    logged, name, message = messages[index]
    return [*messages[:index], (logged, name, change(message)), *messages[index + 1 :]]


def restamped(message, nanoseconds):
    stamp = replace(
        message.header.stamp,
        sec=nanoseconds // NANOSECONDS,
        nanosec=nanoseconds % NANOSECONDS,
    )
    return replace(message, header=replace(message.header, stamp=stamp))


def stamp_of(message):
    return message.header.stamp.sec * NANOSECONDS + message.header.stamp.nanosec


def test_looped_bag_gives_the_map_of_one_round(map_light, rebuilt, messages, light_bag, tmp_path):
    shift = messages[-1][0] - messages[0][0] + 10**8
    second = [(logged + shift, topic, message) for logged, topic, message in messages]
    twice = map_light(rebuilt([*messages, *second]), out=tmp_path / 'twice')
    once = map_light(light_bag, out=tmp_path / 'once')
    assert twice.text('graph.json') == once.text('graph.json')
    for sensor, count in once.stats['input']['counts'].items():
        dropped = twice.stats['dropped'][sensor]
        assert dropped.keys() <= {'late', 'duplicate_stamp'}
        assert sum(dropped.values()) == count


def test_arrival_out_of_order_changes_nothing(map_light, rebuilt, messages, light_bag, tmp_path):
    rng = np.random.default_rng(2)
    delayed = [
        (logged + int(rng.integers(0, 200_000_000)), topic, message)
        for logged, topic, message in messages
    ]
    late = map_light(rebuilt(sorted(delayed, key=lambda item: item[0])), out=tmp_path / 'late')
    order = map_light(light_bag, out=tmp_path / 'order')
    assert late.stats['dropped'] == {}
    assert late.text('graph.json') == order.text('graph.json')
    assert late.text('trajectory.tum') == order.text('trajectory.tum')


@pytest.mark.parametrize('shift', [-100.0, 3.0, 100.0])
def test_one_wrong_stamp_costs_one_scan(map_light, rebuilt, messages, shift):
    def wrong(message):
        return restamped(message, stamp_of(message) + round(shift * NANOSECONDS))

    run = map_light(rebuilt(changed(messages, '/points_left', 8, wrong)))
    assert run.status == 0
    assert sum(sum(reasons.values()) for reasons in run.stats['dropped'].values()) <= 1
    assert run.stats['components'] == 1
    assert len(run.used('left')) + 1 >= run.stats['input']['counts']['left']


def test_first_stamp_far_ahead_does_not_cost_the_drive(map_light, rebuilt, messages):
    def ahead(message):
        return restamped(message, stamp_of(message) + 3600 * NANOSECONDS)

    run = map_light(rebuilt(changed(messages, '/points_left', 0, ahead)))
    assert run.status == 0
    counts = run.stats['input']['counts']
    assert len(run.used('right')) == counts['right']
    assert len(run.used('left')) >= counts['left'] - 1


@pytest.mark.parametrize('topic', ['/imu', '/points_left'])
def test_very_first_message_far_ahead_does_not_cost_the_drive(map_light, rebuilt, messages, topic):
    def ahead(message):
        return restamped(message, stamp_of(message) + 3600 * NANOSECONDS)

    wrong = changed(messages, topic, 0, ahead)
    first = next(item for item in wrong if item[1] == topic)
    start = messages[0][0]
    order = [(start - 1, topic, first[2]), *(item for item in wrong if item is not first)]
    run = map_light(rebuilt(order))
    assert run.status == 0
    counts = run.stats['input']['counts']
    assert len(run.used('right')) == counts['right']
    assert len(run.used('left')) >= counts['left'] - 1
    assert run.stats['factors_by_kind']['imu'] > 20
    assert run.stats['drive_s'] < 3.0


def test_stamp_of_zero(map_light, rebuilt, messages):
    run = map_light(rebuilt(changed(messages, '/points_left', 5, lambda m: restamped(m, 0))))
    assert run.status == 0
    assert run.stats['dropped'] == {'left': {'no_stamp': 1}}


def test_cloud_with_too_little_data(map_light, rebuilt, messages):
    bag = rebuilt(changed(messages, '/points_left', 5, lambda m: replace(m, data=m.data[:-100])))
    run = map_light(bag, strategy='mom')
    assert run.status == 0
    assert run.stats['dropped'] == {'left': {'truncated': 1}}


def test_cloud_without_points(map_light, rebuilt, messages):
    def empty(message):
        return replace(message, width=0, row_step=0, data=message.data[:0])

    run = map_light(rebuilt(changed(messages, '/points_left', 5, empty)))
    assert run.status == 0
    assert run.stats['dropped'] == {'left': {'empty_cloud': 1}}


def test_cloud_of_nothing_but_nan(map_light, rebuilt, messages):
    def nan(message):
        data = np.full(len(message.data) // 4, np.nan, dtype='<f4').view(np.uint8)
        return replace(message, data=data, is_dense=True)

    run = map_light(rebuilt(changed(messages, '/points_left', 5, nan)))
    assert run.status == 0
    assert run.stats['dropped'] == {'left': {'no_finite_points': 1}}


@pytest.mark.parametrize(('status', 'reason'), [(NO_FIX, 'no_fix'), (UNKNOWN_STATUS, 'no_status')])
def test_fix_that_is_none(map_light, rebuilt, messages, status, reason):
    def without(message):
        return replace(message, status=replace(message.status, status=status))

    run = map_light(rebuilt(changed(messages, '/fix', 1, without)))
    assert run.status == 0
    assert run.stats['dropped'] == {'gnss': {reason: 1}}


def test_fix_of_nan(map_light, rebuilt, messages):
    bag = rebuilt(changed(messages, '/fix', 0, lambda m: replace(m, latitude=float('nan'))))
    run = map_light(bag)
    assert run.status == 0
    assert run.stats['dropped'] == {'gnss': {'not_finite': 1}}


def test_fix_with_a_covariance_that_is_none(map_light, rebuilt, messages):
    """Positive on the diagonal, but no covariance: one eigenvalue is far below zero."""
    odd = np.array([1.0, 9.0, 0.0, 9.0, 1.0, 0.0, 0.0, 0.0, 1.0])
    bag = rebuilt(changed(messages, '/fix', 1, lambda m: replace(m, position_covariance=odd)))
    run = map_light(bag)
    assert run.status == 0
    assert run.stats['components'] == 1


def test_imu_without_orientation(map_light, rebuilt, messages):
    absent = np.array([-1.0, *[0.0] * 8])
    bag = rebuilt(
        [
            (logged, topic, replace(m, orientation_covariance=absent) if topic == '/imu' else m)
            for logged, topic, m in messages
        ]
    )
    run = map_light(bag)
    assert run.status == 0
    assert run.stats['dropped'] == {}
    assert run.stats['georeferenced'] is True
    assert run.stats['ate_rmse_m'] < 0.11  # measured: 0.072 m


def only(messages, *topics):
    return [item for item in messages if item[1] in topics]


@pytest.mark.parametrize('topics', [('/fix',), ('/imu',), ('/imu', '/fix')])
def test_bag_without_clouds(map_light, tmp_path, messages, topics):
    bag = write_bag(tmp_path / 'bag', only(messages, *topics))
    map_light(bag).assert_refused('no LiDAR messages', 'lidars.<name>.topic', *topics)


def test_bag_without_messages(map_light, tmp_path):
    bag = write_bag(tmp_path / 'bag', [])
    map_light(bag).assert_refused('no LiDAR messages', 'no topics')


def test_bag_without_settings_beside_it(map_light, tmp_path, messages):
    """Of two LiDARs that nobody places one is mapped: both at one place would make a wrong map."""
    run = map_light(write_bag(tmp_path / 'bag', messages))
    assert run.status == 0
    assert len(run.stats['input']['counts'].keys() & {'points_left', 'points_right'}) == 1
    assert 'lidar_left_out' in [warning['rule'] for warning in run.stats['warnings']]


def test_bag_cut_off_in_the_middle(map_light, light_bag, tmp_path):
    whole = next(light_bag.glob('*.mcap')).read_bytes()
    path = Path(tmp_path / 'cut.mcap')
    path.write_bytes(whole[: len(whole) // 2])
    run = map_light(path)
    assert run.status == 0 and 'truncated_bag' in run.err and 'mcap recover' in run.err
