"""What is seen of messages by topic: whose clouds they are, what was wrong, what nobody sends."""

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (extra "ros")')

from incremental_mapper.config import LidarSensor
from incremental_mapper.datasets.one_frame import MOST
from incremental_mapper.measurements import make_imu, make_scan
from incremental_mapper.ros.input_watch import LOOKS, InputWatch

CLOUD, IMU = 'sensor_msgs/msg/PointCloud2', 'sensor_msgs/msg/Imu'
TOPICS = {'left': '/points_left', 'right': '/points_right', 'imu': '/imu'}
KEYS = {'left': 'lidars.left.topic', 'right': 'lidars.right.topic', 'imu': 'imu.topic'}
TYPES = {'left': CLOUD, 'right': CLOUD, 'imu': IMU}
LIDARS = {'left': LidarSensor(), 'right': LidarSensor()}
SECOND = 1_000_000_000


def scan(number, sensor='left', points=None):
    return make_scan(
        number * SECOND // 10 + 1, sensor, np.ones((5, 3)) if points is None else points
    )


def rules(watch):
    return {finding.rule: finding for finding in watch.findings(KEYS)}


@pytest.fixture
def watch():
    return InputWatch(TOPICS, LIDARS)


def test_nothing_is_wrong_with_clouds_of_one_frame(watch):
    assert all(watch.take(scan(number), 'velodyne') for number in range(30))
    assert rules(watch) == {} and not watch.drops


def test_clouds_of_another_frame_between_are_left_out_and_said(watch):
    taken = [watch.take(scan(i), 'front' if i % 2 else 'roof') for i in range(20)]
    assert taken == [True, False] * 10
    assert watch.drops == {('left', 'foreign_frame'): 10}
    found = rules(watch)['foreign_frame']
    assert (
        found.sensor == 'left'
        and "10 clouds on /points_left have the frame_id 'front'" in found.text
    )


def test_a_frame_that_is_renamed_is_used_after_a_while(watch):
    assert all(watch.take(scan(i), 'old') for i in range(10))
    taken = [watch.take(scan(i), 'new') for i in range(10, 60)]
    assert not taken[0] and all(taken[30:])


@pytest.mark.parametrize('sensor', ['left', 'imu'])
def test_a_driver_that_counts_in_its_frame_id_is_heard_and_costs_no_more_with_every_message(
    watch, sensor
):
    def message(number):
        if sensor == 'imu':
            return make_imu(number * SECOND // 10 + 1, sensor, np.zeros(3), np.ones(3))
        return scan(number)

    taken = [watch.take(message(number), f'frame_{number}') for number in range(400)]
    assert all(taken[150:])
    assert len(watch.findings(KEYS)) <= MOST


@pytest.mark.parametrize('frames', [('velo_right', 'velo_left'), ('a', 'b')])
def test_two_lidars_on_one_topic_are_told_apart_by_their_frames(frames):
    watch = InputWatch({**TOPICS, 'left': '/points', 'right': '/points'}, LIDARS)
    taken = {'left': [], 'right': []}
    for number in range(10):
        for sensor, seen in taken.items():
            if watch.take(scan(number, sensor), frames[number % 2]):
                seen.append(frames[number % 2])
    first, second = ('right', 'left') if 'right' in frames[0] else ('left', 'right')
    assert taken == {first: [frames[0]] * 5, second: [frames[1]] * 5}
    assert rules(watch).keys() == {'several_frames'} and not watch.drops


def test_clouds_of_a_map_are_said_to_be_one(watch):
    watch.take(scan(1), '/map')
    assert "frame '/map'" in rules(watch)['map_frame'].text


def test_two_lidars_under_one_frame_are_noticed(watch):
    rng = np.random.default_rng(1)
    clouds = [rng.uniform(-5, 5, (200, 3)), rng.uniform(0, 20, (200, 3))]
    for number in range(24):
        watch.take(scan(number, points=clouds[number % 2]), 'velodyne')
    assert 'two_lidars_one_frame' in rules(watch)


def test_small_clouds_with_the_stamps_of_whole_ones_are_no_second_lidar(watch):
    rng = np.random.default_rng(1)
    whole, small = rng.uniform(-20, 20, (500, 3)), rng.uniform(5, 6, (100, 3))
    for number in range(40):
        watch.take(scan(number, points=whole), 'left_lidar')
        watch.take(scan(number, points=small), 'left_lidar')
    assert 'two_lidars_one_frame' not in rules(watch)


def look(watch, published, times=LOOKS):
    for _ in range(times):
        watch.look_at_topics(TYPES, KEYS, published)
    return {(item.rule, item.sensor): item for item in watch.findings(KEYS)}


def test_nobody_is_named_while_nothing_is_published(watch):
    assert look(watch, {}) == {}
    assert look(watch, {'/chatter': ['std_msgs/msg/String']}) == {}


def test_topics_that_a_silent_sensor_could_have_are_named(watch):
    published = {'/ouster/points': [CLOUD], '/points_right': [CLOUD], '/imu': [IMU]}
    assert look(watch, published, LOOKS - 1) == {}
    found = look(watch, published)
    assert found.keys() == {('missing_topic', 'left')}
    assert '-p lidars.left.topic:=/ouster/points' in found['missing_topic', 'left'].remedy
    watch.take(scan(1), 'velodyne')
    assert look(watch, published, 1) == {}


def test_vendor_messages_name_the_driver_that_converts_them(watch):
    found = look(watch, {'/velodyne_packets': ['velodyne_msgs/msg/VelodyneScan']})
    assert found.keys() == {('vendor_message', 'left'), ('vendor_message', 'right')}
    assert 'velodyne_pointcloud' in found['vendor_message', 'left'].remedy


def test_a_topic_of_another_type_is_said(watch):
    found = look(watch, {'/points_left': ['sensor_msgs/msg/LaserScan']})
    assert found.keys() == {('other_type', 'left')}


def test_parts_of_sweeps_are_to_be_gathered(watch):
    rng = np.random.default_rng(2)

    def sector(number):
        angle = (number % 10 + rng.random(500)) * 0.2 * np.pi
        return np.stack([10 * np.cos(angle), 10 * np.sin(angle), rng.random(500)], axis=1)

    for number in range(24):
        assert watch.take(scan(number, points=sector(number)), 'velodyne')
    (finding,) = watch.mended()
    assert finding.rule == 'sector_clouds'
    assert finding.settings == {'lidars': {'left': {'sectors': True}}}
    assert watch.mended() == ()
