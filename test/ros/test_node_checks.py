"""What is wrong with inputs and settings reaches log, diagnostics and the saved map."""

import json

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (extra "ros")')

from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import Log
from ros_helpers import NodeSession, bag_parameters, read_status

LEFT, RIGHT, IMU = '/points_left', '/points_right', '/imu'
IDENTITY = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]


@pytest.fixture
def start(start_node):
    """As ``start_node``, and collects what the node logs."""

    def make(*trees):
        session = start_node(*trees)
        session.listen('/rosout', Log, 'log', latched=True)
        return session

    return make


def checks(session):
    """Level, message and values of the findings in the newest diagnostics."""
    session.diagnostics()
    newest = session.received['diagnostics'][-1]
    (found,) = [item for item in newest.status if item.name == 'incremental_mapper: checks']
    return found.level, found.message, read_status(found)


def logged(session, word):
    return [item.msg for item in session.received['log'] if word in item.msg]


def test_equal_extrinsics_are_said_everywhere(start, messages, tmp_path):
    session = start(
        {
            'lidars': {
                'left': {'T_base_sensor': list(IDENTITY)},
                'right': {'T_base_sensor': list(IDENTITY)},
            }
        }
    )
    session.play(messages[:150])
    session.finish()
    session.wait(lambda: 'equal_extrinsics' in checks(session)[2], 'the finding')
    level, message, values = checks(session)
    assert level == DiagnosticStatus.WARN and '(equal_extrinsics)' in message
    assert values['equal_extrinsics'].startswith('warning: LiDARs left, right')
    # /rosout and /diagnostics come in any order
    session.wait(lambda: logged(session, 'equal_extrinsics'), 'the line in the log')
    assert session.call('save_map')[1].startswith(f'saved to {tmp_path / "saved"}')
    saved = json.loads((tmp_path / 'saved' / 'stats.json').read_text())
    assert 'equal_extrinsics' in {item['rule'] for item in saved['warnings']}
    assert len(logged(session, 'equal_extrinsics')) == 1, 'said once'


def test_sound_input_is_said_to_be_so(start, messages):
    session = start()
    session.play(messages)
    session.finish()
    assert checks(session) == (DiagnosticStatus.OK, 'nothing suspicious', {})


def renamed(item, topic, frame):
    def change(message):
        message.header.frame_id = frame
        return message

    return item.changed(change).__class__(item.logged, topic, change(item.message()))


def test_two_lidars_on_one_topic_are_told_apart(start, messages):
    """Both LiDARs are configured with the topic; each gets the clouds of its frame_id."""
    session = start(
        {'lidars': {'left': {'topic': 'points_left'}, 'right': {'topic': 'points_left'}}}
    )
    played = []
    for item in messages:
        if item.topic == LEFT:
            played.append(renamed(item, LEFT, 'velo_left'))
        elif item.topic == RIGHT:
            played.append(renamed(item, LEFT, 'velo_right'))
        else:
            played.append(item)
    session.play(played)
    stats = session.finish(lossless=False)
    assert stats['received']['left'] == sum(item.topic == LEFT for item in messages)
    assert stats['received']['right'] == sum(item.topic == RIGHT for item in messages)
    session.wait(lambda: 'several_frames /points_left' in checks(session)[2], 'the finding')


def test_clouds_of_a_second_lidar_that_nobody_asked_for_are_left_out(start, messages, tmp_path):
    session = start()
    played = [
        renamed(item, LEFT, 'velo_right') if item.topic == RIGHT else item for item in messages
    ]
    session.play(played)
    session.finish(lossless=False)
    count = sum(item.topic == RIGHT for item in messages)
    assert session.dropped('left') == {'foreign_frame': count}
    assert checks(session)[1].startswith('left: ')
    assert session.call('save_map')[1].startswith('saved to')
    saved = json.loads((tmp_path / 'saved' / 'stats.json').read_text())
    assert saved['dropped']['left']['foreign_frame'] == count


def test_an_imu_in_degrees_is_mended_while_the_node_runs(
    tmp_path, light_bag, messages, monkeypatch
):
    """The finding is that of the running mapper; what came before it is mapped again."""

    def change(message):
        rate = message.angular_velocity
        for axis in 'xyz':
            setattr(rate, axis, getattr(rate, axis) * 57.29578)
        force = message.linear_acceleration
        for axis in 'xyz':
            setattr(force, axis, getattr(force, axis) / 9.80665)
        return message

    session = NodeSession(tmp_path, bag_parameters(light_bag))
    try:
        session.play([item.changed(change) if item.topic == IMU else item for item in messages])
        stats = session.finish()
        level, _, values = checks(session)
        assert level == DiagnosticStatus.WARN and any('imu' in key for key in values), values
        assert stats['received']['imu'] == sum(item.topic == IMU for item in messages)
        assert 'before_mend' not in session.dropped('imu')
    finally:
        session.close()


def test_beams_without_a_return_at_one_range_are_left_out_live(start, messages):
    def change(message):
        data = np.frombuffer(bytes(message.data), dtype=np.uint8).reshape(-1, message.point_step)
        data = data.copy()
        points = data[:, :12].copy().view('<f4')
        points[::5] *= 40.0 / np.linalg.norm(points[::5], axis=1, keepdims=True)
        data[:, :12] = points.view(np.uint8)
        message.data = data.ravel().tobytes()
        return message

    session = start()
    session.play([item.changed(change) if item.topic == LEFT else item for item in messages[:150]])
    session.finish()
    session.wait(lambda: any('constant_range' in key for key in checks(session)[2]), 'the finding')
