"""The node on a clean drive: its topics, and that it maps as ``map`` does."""

import json

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (extra "ros")')

from nav_msgs.msg import Path
from ros_helpers import (
    NodeSession,
    assert_same_graph,
    bag_parameters,
    decode_cloud,
    map_offline,
    stamp_of,
)
from scipy.spatial import cKDTree
from sensor_msgs.msg import PointCloud2

from incremental_mapper.results.messages.result_messages import read_status
from incremental_mapper.trajectory import read_tum

MEASURED = {'wall_s', 'real_time_factor', 'peak_rss_mb', 'seconds_by_stage'}
"""Keys of numbers that differ from run to run."""


@pytest.fixture(scope='module')
def session(light_bag, messages, tmp_path_factory):
    """A node that has mapped the whole drive and still runs."""
    folder = tmp_path_factory.mktemp('node')
    saving = {'save': {'folder': str(folder / 'saved'), 'pictures': False}}
    made = NodeSession(folder, bag_parameters(light_bag, saving))
    made.play(messages)
    made.finish()
    made.folder = folder / 'saved'
    success, message = made.call('save_map')
    assert success and str(made.folder) in message
    yield made
    made.close()


@pytest.fixture(scope='module')
def offline(light_bag):
    return map_offline(light_bag, bag_parameters(light_bag))


def test_graph_is_that_of_the_map_command(session, offline):
    assert_same_graph(session.folder, offline)
    names = {path.name for path in session.folder.iterdir()}
    assert names >= {'trajectory.tum', 'map.ply', 'graph.g2o', 'windows.csv', 'stats.json'}
    saved = json.loads((session.folder / 'stats.json').read_text())
    stats = offline.statistics.to_tree()
    assert saved.keys() == stats.keys()
    assert saved['vertices'] == stats['vertices']
    assert saved['map_points'] == stats['map_points']


def test_every_window_has_odometry_and_poses(session, offline):
    windows = [row for row in offline.result.rows if row['clusters']]
    odometry, poses = session.received['odometry'], session.received['poses']
    assert len(odometry) == len(poses) == len(windows)
    assert [len(message.poses) for message in poses] == [row['clusters'] for row in windows]
    stamps = [stamp_of(message) for message in odometry]
    assert stamps == sorted(set(stamps))
    assert {(m.header.frame_id, m.child_frame_id) for m in odometry} == {('map', 'base_link')}
    for message in odometry:
        covariance = np.array(message.pose.covariance).reshape(6, 6)
        assert np.linalg.eigvalsh(covariance).min() > 0
    # The car drives at constant speed, forwards.
    newest = odometry[-1].twist.twist.linear
    truth = offline.result.trajectory
    moved = np.linalg.norm(truth.positions[-1] - truth.positions[0])
    seconds = (truth.stamps[-1] - truth.stamps[0]) / 1e9
    assert newest.x == pytest.approx(moved / seconds, abs=0.5)
    assert abs(newest.y) < 0.5 and abs(newest.z) < 0.5


def test_odom_does_not_jump_and_has_the_twist_of_the_map(session, offline):
    odometry, odom = session.received['odometry'], session.received['odom']
    assert [stamp_of(message) for message in odom] == [stamp_of(message) for message in odometry]
    assert {(m.header.frame_id, m.child_frame_id) for m in odom} == {('odom', 'base_link')}
    for ours, theirs in zip(odom, odometry, strict=True):
        assert ours.twist.twist.linear.x == pytest.approx(theirs.twist.twist.linear.x)
        assert list(ours.twist.covariance) == list(theirs.twist.covariance)
    steps = [
        np.linalg.norm(np.diff([[p.x, p.y, p.z] for p in points], axis=0), axis=1)
        for points in ([m.pose.pose.position for m in kind] for kind in (odom, odometry))
    ]
    seconds = np.diff([stamp_of(message) for message in odom]) / 1e9
    assert np.abs(steps[0] - steps[0].mean() * seconds / seconds.mean()).max() < 0.15
    variances = [message.pose.covariance[0] for message in odom]
    assert variances == sorted(variances) and variances[0] == 0.0 < variances[-1]


def test_datum_is_latched_once_the_map_is_enu(session, offline):
    assert offline.result.stats['georeferenced']
    newest = session.received['datum'][-1]
    assert newest.header.frame_id == 'map'
    place = [newest.latitude, newest.longitude, newest.altitude]
    assert place == pytest.approx(offline.result.stats['datum'])


def test_path_is_the_whole_trajectory(session, offline):
    path = session.received['path'][-1]
    saved = read_tum(session.folder / 'trajectory.tum')
    assert [stamp_of(pose) for pose in path.poses] == saved.stamps.tolist()
    at = [pose.pose.position for pose in path.poses]
    table = np.array([[point.x, point.y, point.z] for point in at])
    # The saved map was optimised as a whole once more.
    assert np.abs(table - saved.positions).max() < 0.1


def test_map_overlaps_that_of_the_map_command(session, offline):
    points = decode_cloud(session.received['map'][-1])
    assert np.isfinite(points).all()
    assert len(points) == pytest.approx(len(offline.points), rel=0.25)
    for ours, theirs in ((points, offline.points), (offline.points, points)):
        distance, _ = cKDTree(theirs).query(ours)
        assert np.mean(distance < 0.3) > 0.98


def test_increments_make_up_the_map(session):
    increments = np.vstack([decode_cloud(item) for item in session.received['map_increment']])
    distance, _ = cKDTree(increments).query(decode_cloud(session.received['map'][-1]))
    # The first ones came before the map was turned into ENU.
    assert np.median(distance) < 0.2


def test_graph_stats_are_the_numbers_of_the_core(session, offline):
    stats = session.stats()
    assert len(stats) == len(offline.result.rows)
    own = {key for key in stats[-1] if not key.startswith('window.')}
    assert own == (offline.result.stats.keys() - {'settings'}) | {
        'wall_s',
        'real_time_factor',
        'peak_rss_mb',
    }
    for key in own - MEASURED:
        assert stats[-1][key] == pytest.approx(offline.result.stats[key], abs=1e-6), key
    for message, row in zip(stats, offline.result.rows, strict=True):
        for key, value in row.items():
            if not key.endswith('_s') or key == 'time_shift_s':
                assert message[f'window.{key}'] == pytest.approx(value, abs=1e-6), key


def test_markers_show_every_kind_of_factor(session, offline):
    markers = session.received['graph'][-1].markers
    assert markers[0].action == markers[0].DELETEALL
    by_name = {marker.ns: marker for marker in markers[1:]}
    factors = offline.result.stats['factors_by_kind']
    assert len(by_name['poses'].points) == offline.result.stats['clusters']
    for kind in ('odometry', 'imu', 'gnss'):
        assert len(by_name[kind].points) == 2 * factors[kind]
    merged = sum(len(item.cluster.members) > 1 for item in offline.result.clusters)
    assert len(by_name['clusters'].points) == merged > 0
    assert len(by_name['priors'].points) == factors['prior_pose']


def test_late_joiner_gets_the_latched_map_and_path(session):
    session.listen('/incremental_mapper/map', PointCloud2, 'late map', latched=True)
    session.listen('/incremental_mapper/path', Path, 'late path', latched=True)
    late = session.received
    session.wait(lambda: late['late map'] and late['late path'], 'latched messages')
    assert late['late map'][0] == late['map'][-1]
    assert late['late path'][0] == late['path'][-1]


def test_diagnostics_tell_of_every_part(session):
    found = session.diagnostics()
    assert found.keys() == {'left', 'right', 'imu', 'gnss', 'worker', 'map', 'checks'}
    assert found['checks'] == {}
    assert found['map']['fixes_received'] == found['map']['fixes_used'] == 3
    assert found['imu']['received'] == 251 and found['imu']['dropped'] == {}
    assert found['worker']['queue_core'] == 0 and found['worker']['merged_windows'] == 0
    messages = session.received['diagnostics']
    assert any({item.level for item in message.status} == {b'\x00'} for message in messages)
    message = messages[-1]
    assert {item.hardware_id for item in message.status} == {
        '/points_left',
        '/points_right',
        '/imu',
        '/fix',
        'incremental_mapper',
    }
    assert read_status(message.status[0])['topic'] == '/points_left'


def test_map_that_nobody_listened_to_is_there_for_the_first_listener(tmp_path, light_bag, messages):
    quiet = NodeSession(tmp_path, bag_parameters(light_bag), listen=False)
    quiet.listen('/incremental_mapper/graph_stats', *quiet.of('graph_stats'))
    quiet.play(messages)
    quiet.finish()
    quiet.listen('/incremental_mapper/map', *quiet.of('map'))
    quiet.wait(lambda: quiet.received['map'], 'the map')
    assert len(decode_cloud(quiet.received['map'][0])) > 1000
    quiet.close()
