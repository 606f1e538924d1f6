"""Transforms over real DDS: the node's own, the robot's, and places of sensors that come late."""

import subprocess
import sys
from copy import deepcopy

import gtsam
import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (extra "ros")')

import tf2_package
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_helpers import NodeSession, assert_same_graph, bag_parameters, map_offline, stamp_of

from incremental_mapper.geometry import matrix_numbers, pose_matrix
from incremental_mapper.ros.transforms import transform_message

LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture(scope='module')
def tf_message(request):
    """The message of an installed tf2_msgs, or of one that is built for these tests."""
    before = list(sys.path)
    try:
        from tf2_msgs.msg import TFMessage
    except ImportError:
        lacks = tf2_package.missing()
        if lacks:
            pytest.skip(f'tf2_msgs cannot be built: {lacks}')
        folder = request.config.cache.mkdir('tf2_msgs') / f'python{sys.version_info.minor}'
        try:
            tf2_package.build(folder)
        except subprocess.CalledProcessError as error:
            pytest.fail(error.stderr)
        sys.path.insert(0, str(tf2_package.packages(folder)))
        from tf2_msgs.msg import TFMessage
    yield TFMessage
    sys.path[:] = before
    # Other tests are of a node without it.
    for name in [name for name in sys.modules if name.split('.')[0] == 'tf2_msgs']:
        del sys.modules[name]


def pose_of(place, turn):
    rotation = gtsam.Rot3(turn.w, turn.x, turn.y, turn.z)
    return gtsam.Pose3(rotation, np.array([place.x, place.y, place.z]))


def of_transform(message):
    return pose_of(message.transform.translation, message.transform.rotation)


def without_places(tree):
    """Settings that tell of no sensor where it is, and where each was."""
    tree, places = deepcopy(tree), {}
    names = tree['lidars']['names']
    for name, section in [*((n, tree['lidars'][n]) for n in names), *tree.items()]:
        if isinstance(section, dict) and 'T_base_sensor' in section:
            places[name] = section.pop('T_base_sensor')
    return tree, places


def by_frame(messages, places, topics):
    """Static transforms of the places, by the frame_id of the sensors' messages."""
    found = {}
    for name, numbers in places.items():
        first = next(item for item in messages if item.topic == topics[name])
        frame = first.message().header.frame_id
        x, y, z, qx, qy, qz, qw = matrix_numbers(pose_matrix(numbers))
        pose = gtsam.Pose3(gtsam.Rot3(qw, qx, qy, qz), np.array([x, y, z]))
        found[frame] = transform_message(0, 'base_link', frame, pose)
    return list(found.values())


TOPICS = {'left': '/points_left', 'right': '/points_right', 'imu': '/imu', 'gnss': '/fix'}


def test_the_node_broadcasts_its_frames_and_where_its_sensors_are(tf_message, start_node, messages):
    session = start_node()
    session.listen('/tf', tf_message, 'tf', latched=False)
    session.listen('/tf_static', tf_message, 'tf_static', latched=True)
    session.play(messages)
    session.finish()
    session.wait(lambda: session.received['tf_static'], 'the places')
    assert len(session.received['tf']) == len(session.received['odometry']) > 10
    for transforms, odometry in zip(
        session.received['tf'], session.received['odometry'], strict=True
    ):
        outer, inner = transforms.transforms
        assert (outer.header.frame_id, outer.child_frame_id) == ('map', 'odom')
        assert (inner.header.frame_id, inner.child_frame_id) == ('odom', 'base_link')
        assert stamp_of(outer) == stamp_of(inner) == stamp_of(odometry)
        told = pose_of(odometry.pose.pose.position, odometry.pose.pose.orientation)
        assert of_transform(outer).compose(of_transform(inner)).equals(told, 1e-6)
    placed = {item.child_frame_id for item in session.received['tf_static'][-1].transforms}
    frames = {item.message().header.frame_id for item in messages}
    assert placed == frames - {'base_link', ''}
    assert not any('shared_frame' in name for name in session.diagnostics()['checks'])


def test_places_that_come_after_the_clouds_make_the_map_of_places_that_were_given(
    tf_message, tmp_path, light_bag, messages
):
    saving = {'save': {'folder': str(tmp_path / 'saved'), 'pictures': False}}
    given = bag_parameters(light_bag, saving)
    tree, places = without_places(given)
    assert {'left', 'right'} <= places.keys()
    session = NodeSession(tmp_path, tree)
    try:
        half = len(messages) * 2 // 3
        session.play(messages[:half], rate=1.0)
        assert session.diagnostics()['map']['windows'] == 0
        static = session.client.create_publisher(tf_message, '/tf_static', LATCHED)
        static.publish(tf_message(transforms=by_frame(messages, places, TOPICS)))
        session.wait(lambda: session.diagnostics()['map']['windows'] > 0, 'the map')
        session.play(messages[half:], rate=1.0)
        session.finish()
        success, told = session.call('save_map')
        assert success, told
    finally:
        session.close()
    assert_same_graph(tmp_path / 'saved', map_offline(light_bag, given))


def test_a_robot_with_odometry_of_its_own_gets_map_to_odom_that_fits_it(
    tf_message, start_node, messages
):
    session = start_node({'tf': {'publish': 'map_to_odom', 'sensors': False}})
    session.listen('/tf', tf_message, 'tf', latched=False)
    robot = session.client.create_publisher(tf_message, '/tf', 100)
    # It drives straight on, whatever the car does: what is told in the map must not know of that.
    stamps = sorted({stamp_of(item.message()) for item in messages})
    for stamp in range(stamps[0] - 10**8, stamps[-1] + 10**8, 2 * 10**7):
        x = (stamp - stamps[0]) * 1e-9
        pose = gtsam.Pose3(gtsam.Rot3.Yaw(0.3), np.array([x, 5.0, 0.0]))
        robot.publish(tf_message(transforms=[transform_message(stamp, 'odom', 'base_link', pose)]))
    session.play(messages)
    session.finish()
    assert not any('shared_frame' in name for name in session.diagnostics()['checks'])
    own = {stamp_of(item): item for item in session.received['odometry']}
    sent = [
        item
        for message in session.received['tf']
        for item in message.transforms
        if item.child_frame_id == 'odom'
    ]
    assert len(sent) == len(own) > 10
    for item in sent:
        odometry = own[stamp_of(item)].pose.pose
        x = (stamp_of(item) - stamps[0]) * 1e-9
        robots = gtsam.Pose3(gtsam.Rot3.Yaw(0.3), np.array([x, 5.0, 0.0]))
        told = pose_of(odometry.position, odometry.orientation)
        assert of_transform(item).compose(robots).equals(told, 1e-6)


def test_a_robot_that_tells_of_the_same_frames_is_named(tf_message, start_node):
    session = start_node()
    robot = session.client.create_publisher(tf_message, '/tf', 100)
    stamps = iter(range(10_000))

    def said():
        pose = gtsam.Pose3()
        robot.publish(
            tf_message(transforms=[transform_message(next(stamps), 'odom', 'base_link', pose)])
        )
        return 'shared_frame base_link' in session.diagnostics()['checks']

    session.wait(said, 'the finding', 30.0)
