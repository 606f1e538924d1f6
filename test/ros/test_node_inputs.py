"""What comes in: clouds of every layout, faulty messages, sensors that are missing or die."""

import json
import time
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (extra "ros")')

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from ros_helpers import (
    INPUTS,
    assert_same_graph,
    bag_parameters,
    map_offline,
    next_domain,
    restamp,
    stamp_of,
)
from sensor_msgs.msg import PointField

from incremental_mapper.frontend.match_noise import WEAK
from incremental_mapper.ros.subscriptions import Inputs
from incremental_mapper.settings import make_config

LEFT, RIGHT, IMU, FIX = '/points_left', '/points_right', '/imu', '/fix'


def columns_of(message):
    """x, y, z of the points, and their time where they have one."""
    names = [field.name for field in message.fields]
    numbers = np.frombuffer(message.data, dtype='<f4').reshape(-1, len(names))
    return {
        name: numbers[:, names.index(name)] for name in ('x', 'y', 'z', 'time') if name in names
    }


def repack(message, table, rows=1, padding=0, big_endian=False):
    """The cloud with the structured array ``table`` as its data."""
    codes = {'f4': PointField.FLOAT32, 'f8': PointField.FLOAT64, 'u2': PointField.UINT16}
    layout = table.dtype
    message.fields = [
        PointField(
            name=name,
            offset=layout.fields[name][1],
            datatype=codes[layout.fields[name][0].str[1:]],
            count=1,
        )
        for name in layout.names
    ]
    message.height, message.width = rows, len(table) // rows
    message.point_step = layout.itemsize
    message.row_step = message.width * layout.itemsize + padding
    pad = bytes([255]) * padding
    lines = [part.tobytes() + pad for part in np.split(table, rows)]
    message.data = b''.join(lines)
    message.is_bigendian = big_endian
    message.is_dense = True  # drivers claim that even where it is not so
    return message


def big_endian_in_padded_rows(message):
    """Two rows with rests behind them; a NaN point where the number is odd."""
    columns = columns_of(message)
    count = len(columns['x'])
    table = np.zeros(count + count % 2, dtype=[(name, '>f4') for name in columns])
    for name, values in columns.items():
        table[name] = np.nan
        table[name][:count] = values
    return repack(message, table, rows=2, padding=5, big_endian=True)


def unordered_with_rests_and_nan(message):
    """Fields in another order, a foreign one between, double z, and points that are no numbers."""
    columns = columns_of(message)
    layout = {
        'names': ['z', 'ring', 'x', 'y', *(['time'] if 'time' in columns else [])],
        'formats': ['<f8', '<u2', '<f4', '<f4', '<f4'][: len(columns) + 1],
        'offsets': [0, 9, 12, 18, 22][: len(columns) + 1],
        'itemsize': 26,
    }
    table = np.zeros(2 * len(columns['x']), dtype=layout)
    for (name, values), other in zip(columns.items(), (np.nan, np.inf, 0.0, 0.0), strict=False):
        table[name][::2] = values
        table[name][1::2] = other
    return repack(message, table)


def no_z(message):
    message.fields = [field for field in message.fields if field.name != 'z']
    return message


def unknown_type(message):
    message.fields[0].datatype = 99
    return message


def truncated(message):
    message.data = bytes(message.data)[:100]
    return message


def only_nan(message):
    message.data = np.full(len(message.data) // 4, np.nan, dtype='<f4').tobytes()
    return message


def unstamped(message):
    return restamp(message, 0)


def nan_rate(message):
    message.angular_velocity.x = float('nan')
    return message


def no_fix(message):
    message.status.status = -1
    return message


FAULTS = [
    (LEFT, no_z, 'left', 'missing_field'),
    (LEFT, unknown_type, 'left', 'wrong_type'),
    (RIGHT, truncated, 'right', 'truncated'),
    (RIGHT, only_nan, 'right', 'no_finite_points'),
    (LEFT, unstamped, 'left', 'no_stamp'),
    (IMU, nan_rate, 'imu', 'not_finite'),
    (FIX, no_fix, 'gnss', 'no_fix'),
]


def test_layout_of_clouds_makes_no_difference_and_faults_are_counted(
    start_node, messages, light_bag, tmp_path
):
    changes = {LEFT: big_endian_in_padded_rows, RIGHT: unordered_with_rests_and_nan}
    played = []
    for item in messages:
        played.append(item.changed(changes[item.topic]) if item.topic in changes else item)
    for topic, fault, _, _ in FAULTS:
        index, victim = [(i, m) for i, m in enumerate(played) if m.topic == topic][1]
        original = next(item for item in messages if item.logged == victim.logged)
        played.insert(index, replace(original.changed(fault), topic=topic))
    session = start_node()
    session.play(played)
    session.finish()
    for _, _, sensor, reason in FAULTS:
        assert session.dropped(sensor)[reason] == 1
    assert session.call('save_map')[0]
    assert_same_graph(tmp_path / 'saved', map_offline(light_bag, bag_parameters(light_bag)))


def test_clouds_whose_fields_change_are_told_of_once(start_node, messages, capfd):
    half = messages[len(messages) // 2].logged

    def unnamed(message):
        kept = [field for field in message.fields if field.name in 'xyz']
        message.fields = kept
        return message

    session = start_node()
    session.play(
        item.changed(unnamed) if item.topic == LEFT and item.logged > half else item
        for item in messages
    )
    session.finish()
    said = [line for line in capfd.readouterr().err.splitlines() if 'other fields' in line]
    assert len(said) == 1 and 'left: ' in said[0] and '(x, y, z): no time' in said[0]


@pytest.mark.parametrize('missing', [IMU, FIX], ids=['no_imu', 'no_gnss'])
def test_drive_without(start_node, messages, missing):
    session = start_node({'window': {'lateness': 0.3}})
    session.play([item for item in messages if item.topic != missing])
    stats = session.finish()
    assert stats['components'] == 1
    kinds = stats['factors_by_kind']
    assert kinds['odometry'] == 44
    assert kinds.get('imu', 0) == 0 if missing == IMU else kinds['imu'] > 0
    assert kinds.get('gnss', 0) == (3 if missing == IMU else 0)
    assert len(session.received['odometry']) > 20


def test_lidar_that_dies_and_returns(start_node, messages):
    first = messages[0].logged
    dead = range(first + 800_000_000, first + 1_600_000_000)
    played = [item for item in messages if item.topic != LEFT or item.logged not in dead]
    session = start_node({'window': {'lateness': 0.3}, 'odometry': {'max_gap': 0.5}})
    session.play(played)
    # While it was dead, the windows went on.
    stats = session.finish()
    assert stats['components'] == 1
    assert stats['unused_measurements'] == 0 and stats['dropped'] == {}
    assert stats['received']['left'] == sum(item.topic == LEFT for item in played)
    # With every fifth point some matches are weak, which is another matter.
    notes = {text: count for text, count in stats['notes'].items() if WEAK not in text}
    assert notes == {'left: gap too long to match': 1}
    stamps = np.array([stamp_of(message) for message in session.received['odometry']])
    assert np.diff(stamps).max() < 250_000_000


def test_best_effort_publishers_are_heard(start_node, messages):
    session = start_node()
    session.play(messages[:40], reliable=False)
    session.wait(lambda: session.arrived().get(IMU, 0) > 20, 'IMU samples')


def test_flood_is_shed_in_order_and_nothing_is_lost_unseen(start_node, messages, tmp_path):
    session = start_node({'queue': {'core': 10}, 'time_jump': {'policy': 'ignore'}})
    session.play(messages, rate=100.0)
    # What the middleware still holds comes in; how much it lost is not the matter here.
    seen = [{}, session.arrived()]
    while seen[-1] != seen[-2]:
        seen.append(session.arrived())
    session.finish(lossless=False)
    assert session.call('save_map')[0]
    stats = json.loads((tmp_path / 'saved' / 'stats.json').read_text())
    found = session.diagnostics()
    assert stats['merged_windows'] > 0 or found['left']['dropped'].get('queue_full')
    assert stats['components'] == 1
    for sensor in ('left', 'right', 'gnss', 'imu'):
        lost = found[sensor]['dropped'].get('queue_full', 0)
        assert found[sensor]['received'] - lost == stats['received'].get(sensor, 0), sensor
        assert stats['dropped'].get(sensor, {}).get('queue_full', 0) == lost


@pytest.fixture
def unattended(light_bag):
    """Inputs whose executor runs only when it is told to: (publish, spin, inputs, handed on)."""
    context = Context()
    rclpy.init(
        context=context,
        domain_id=next_domain(),
        signal_handler_options=SignalHandlerOptions.NO,
    )
    node, handed_on = Node('unattended', context=context), []
    config = make_config(bag_parameters(light_bag))
    inputs = Inputs(node, config, lambda item, frame: handed_on.append(item))
    quality = QoSProfile(depth=1000)
    publishers = {
        topic: node.create_publisher(kind, topic, quality) for topic, kind in INPUTS.items()
    }
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)

    def spin():
        time.sleep(0.5)  # until the middleware has passed on what was published
        for _ in range(20):
            executor.spin_once(0.01)

    def publish(items):
        for item in items:
            publishers[item.topic].publish(item.content)
            time.sleep(0.001)

    yield publish, spin, inputs, handed_on
    executor.shutdown()
    node.destroy_node()
    rclpy.try_shutdown(context=context)


def test_messages_that_waited_come_in_the_order_of_their_arrival(unattended, messages):
    publish, spin, _, handed_on = unattended
    waiting = messages[:60]
    publish(waiting)
    spin()
    assert {item.topic for item in waiting} == set(INPUTS)
    expected = [stamp_of(item.message()) for item in waiting]
    assert [item.stamp for item in handed_on] == expected


def test_messages_that_the_middleware_overwrote_are_counted(unattended, messages):
    publish, spin, inputs, handed_on = unattended
    fixes = [item for item in messages if item.topic == FIX]
    publish(fixes[:1])
    spin()
    publish(fixes[:1] * 180)
    spin()
    assert inputs.received['gnss'] == len(handed_on) == 1 + 50
    losses = inputs.losses()
    assert losses['gnss'].total == 130
    assert inputs.received['imu'] == losses['imu'].total == 0


def test_another_publisher_is_no_loss(unattended, messages):
    publish, spin, inputs, _ = unattended
    fixes = [item for item in messages if item.topic == FIX]
    publish(fixes[:1] * 40)
    spin()
    second = inputs._node.create_publisher(INPUTS[FIX], FIX, QoSProfile(depth=10))
    for _ in range(3):
        second.publish(fixes[0].message())
        publish(fixes[:1])
        spin()
    assert inputs.received['gnss'] == 46 and inputs.losses()['gnss'].total == 0
