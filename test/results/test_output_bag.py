"""The outputs of a run as a bag: other people's readers find what the run's own files say."""

import shutil
from contextlib import contextmanager
from functools import partial

import numpy as np
import pytest
from full_disk import largest_file
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from incremental_mapper.datasets.point_clouds import cloud_table
from incremental_mapper.errors import OutputError
from incremental_mapper.map.ply import MapFile
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.results.messages.output_bag import FOLDER, output_bag
from incremental_mapper.results.messages.result_messages import read_status
from incremental_mapper.results.offline_run import map_into
from incremental_mapper.results.opened_drive import open_drive
from incremental_mapper.results.run_folder import prepared_folder
from incremental_mapper.trajectory import read_tum

NODE = '/incremental_mapper'
SETTINGS = {'mom': {'max_points': 100}}


@pytest.fixture(scope='module')
def run(light_drive, tmp_path_factory):
    folder = tmp_path_factory.mktemp('run')
    map_into(folder, open_drive(light_drive, SETTINGS, 'test'), watch=[partial(output_bag, folder)])
    return folder


@pytest.fixture(scope='module')
def raw(run):
    """Serialized messages by topic, each with its type and the time that it is logged at."""
    found = {}
    with Reader(run / FOLDER) as reader:
        for connection, stamp, data in reader.messages():
            found.setdefault(connection.topic, []).append((connection.msgtype, stamp, data))
    return found


@pytest.fixture(scope='module')
def messages(raw):
    store = get_typestore(Stores.ROS2_JAZZY)
    return {
        topic: [store.deserialize_cdr(data, kind) for kind, _, data in rows]
        for topic, rows in raw.items()
    }


def stamp_of(header):
    return header.stamp.sec * 1_000_000_000 + header.stamp.nanosec


def test_last_path_is_the_trajectory(run, messages):
    trajectory = read_tum(run / 'trajectory.tum')
    path = messages[f'{NODE}/path'][-1]
    assert path.header.frame_id == 'map'
    assert [stamp_of(pose.header) for pose in path.poses] == trajectory.stamps.tolist()
    positions = [
        [pose.pose.position.x, pose.pose.position.y, pose.pose.position.z] for pose in path.poses
    ]
    assert np.abs(np.array(positions) - trajectory.positions).max() < 1e-8
    turns = [[getattr(pose.pose.orientation, axis) for axis in 'xyzw'] for pose in path.poses]
    same = np.abs(np.einsum('ij,ij->i', np.array(turns), trajectory.quaternions))
    assert same.min() > 1 - 1e-12


def test_every_window_that_grew_has_its_messages(run, messages):
    windows = FinishedRun(run).windows
    assert len(messages[f'{NODE}/graph_stats']) == len(windows)
    grown = sum(int(row['clusters']) > 0 for row in windows)
    assert len(messages[f'{NODE}/poses']) >= grown > 0
    for topic in ('odometry', 'odom', 'map_increment'):
        assert len(messages[f'{NODE}/{topic}']) == len(messages[f'{NODE}/poses'])
    count = sum(len(message.poses) for message in messages[f'{NODE}/poses'])
    assert count == FinishedRun(run).stats['clusters']


def test_statistics_are_those_of_the_files(run, messages):
    last = read_status(messages[f'{NODE}/graph_stats'][-1].status[0])
    stats = FinishedRun(run).stats
    for key in ('vertices', 'factors', 'factors_by_kind', 'compression_vertices_percent'):
        assert last[key] == stats[key]
    assert last['window.window'] == len(FinishedRun(run).windows) - 1


def test_last_map_is_the_saved_one(run, messages):
    table = cloud_table(messages[f'{NODE}/map'][-1])
    saved = MapFile(run / 'map.ply').columns(('x', 'y', 'z'), np.float32)
    assert np.array_equal(table.xyz(), saved)


def test_graph_is_shown_with_factors_of_each_kind(messages):
    names = {marker.ns for array in messages[f'{NODE}/graph'] for marker in array.markers}
    assert {'poses', 'odometry', 'imu', 'gnss'} <= names


def test_transforms_make_the_pose_of_the_odometry(messages):
    transforms = {
        stamp_of(message.transforms[0].header): message.transforms for message in messages['/tf']
    }
    for message in messages[f'{NODE}/odometry']:
        to_odom, to_base = transforms[stamp_of(message.header)]
        chain = [(item.header.frame_id, item.child_frame_id) for item in (to_odom, to_base)]
        assert chain == [('map', 'odom'), ('odom', 'base_link')]
        product = _matrix(to_odom.transform) @ _matrix(to_base.transform)
        at = message.pose.pose.position
        assert np.abs(product[:3, 3] - [at.x, at.y, at.z]).max() < 1e-8


def test_messages_are_logged_at_their_stamps(raw, messages):
    for (_, logged, _), message in zip(
        raw[f'{NODE}/odometry'], messages[f'{NODE}/odometry'], strict=True
    ):
        assert logged == stamp_of(message.header)


def test_rclpy_reads_every_message(raw):
    serialization = pytest.importorskip('rclpy.serialization', reason='rclpy is not installed')
    from incremental_mapper.ros.rclpy_types import message_class

    for topic, rows in raw.items():
        kind, _, data = rows[-1]
        if topic == '/tf':
            continue  # tf2_msgs is not among the wheels
        message = serialization.deserialize_message(bytes(data), message_class(kind))
        assert serialization.serialize_message(message)


def test_late_joiners_get_path_map_and_graph_of_a_played_bag(run):
    with Reader(run / FOLDER) as reader:
        latched = {
            connection.topic.rpartition('/')[2]
            for connection in reader.connections
            if connection.ext.offered_qos_profiles[0].durability.name == 'TRANSIENT_LOCAL'
        }
    assert latched == {'path', 'map', 'graph', 'datum'}


def test_bag_of_before_goes_with_force_and_one_of_others_stays(run, tmp_path):
    folder = shutil.copytree(run, tmp_path / 'run')
    with prepared_folder(folder, force=True):
        pass
    assert not (folder / FOLDER).exists()
    (folder / FOLDER).mkdir()
    (folder / FOLDER / 'metadata.yaml').write_text('rosbag2_bagfile_information: {}')
    with prepared_folder(folder, force=True):
        pass
    assert (folder / FOLDER).is_dir()
    with pytest.raises(OutputError, match='no bag of this program'), output_bag(folder, None):
        pass


def test_full_disk_costs_the_bag_and_no_map(light_drive, tmp_path):
    @contextmanager
    def watch(config):
        with output_bag(tmp_path, config) as bag, largest_file(300_000):
            yield bag

    drive = open_drive(light_drive, SETTINGS, 'test')
    with pytest.raises(OutputError, match=r'no run_bag: cannot be written \(File too large'):
        map_into(tmp_path, drive, watch=[watch])
    assert FinishedRun(tmp_path).stats['clusters'] > 0
    assert not [path for path in tmp_path.iterdir() if FOLDER in path.name]


def _matrix(transform):
    matrix = np.eye(4)
    turn, shift = transform.rotation, transform.translation
    matrix[:3, :3] = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
    matrix[:3, 3] = [shift.x, shift.y, shift.z]
    return matrix
