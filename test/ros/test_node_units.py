"""Parts of the node that need no other process: covariances, queue, jumps, live map, TF."""

import sys
import types

import gtsam
import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (extra "ros")')

from scipy.spatial.transform import Rotation

from incremental_mapper.config import (
    Config,
    FrameSettings,
    QueueSettings,
    TimeJumpPolicy,
    TimeJumpSettings,
)
from incremental_mapper.datasets.open import open_source
from incremental_mapper.map.cloud import accumulate
from incremental_mapper.mapping.load_shedding import NO_SHEDDING, LoadShedding
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.mapping.result import NewestState
from incremental_mapper.measurements import ImuSample, LidarScan
from incremental_mapper.results.offline_run import effective_config
from incremental_mapper.ros.inbox import Command, Inbox, Order, View, effort_at
from incremental_mapper.ros.live_map import LiveMap
from incremental_mapper.ros.result_messages import odometry_message, ros_covariance
from incremental_mapper.ros.time_jumps import JumpFilter
from incremental_mapper.ros.transforms import TfTransforms, make_transforms

SECOND = 1_000_000_000


def scan(stamp, sensor='left'):
    return LidarScan(stamp, sensor, np.ones((3, 3), dtype=np.float32))


def imu(stamp):
    return ImuSample(stamp, 'imu', np.zeros(3), np.zeros(3))


def test_covariance_is_what_samples_of_the_pose_have():
    rng = np.random.default_rng(4)
    pose = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.3, -0.4, 1.2), np.array([5.0, -2.0, 1.0]))
    root = rng.normal(size=(6, 6)) * 1e-3
    covariance = root @ root.T
    translations, rotations = [], []
    for tangent in rng.multivariate_normal(np.zeros(6), covariance, 40_000):
        sample = pose.retract(tangent)
        translations.append(sample.translation() - pose.translation())
        # A small turn about the fixed axes of the parent.
        rotations.append(sample.rotation().matrix() @ pose.rotation().matrix().T)
    turns = Rotation.from_matrix(np.array(rotations)).as_rotvec()
    measured = np.cov(np.hstack([np.array(translations), turns]).T)
    expected = ros_covariance(covariance, pose.rotation().matrix())
    assert np.abs(measured - expected).max() < 0.03 * np.abs(expected).max()


def test_twist_is_along_the_axes_of_the_car():
    pose = gtsam.Pose3(gtsam.Rot3.Yaw(np.pi / 2), np.zeros(3))
    newest = NewestState(7 * SECOND + 5, pose, None, np.array([0.0, 3.0, 0.0]))
    message = odometry_message(newest, 'map', 'base_link')
    linear = message.twist.twist.linear
    assert [linear.x, linear.y, linear.z] == pytest.approx([3.0, 0.0, 0.0])
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (7, 5)
    assert message.pose.covariance[0] >= 1e6


def test_effort_shrinks_the_search_before_it_merges_windows():
    efforts = [effort_at(filling) for filling in np.linspace(0.0, 1.0, 101)]
    assert efforts[0] is NO_SHEDDING and efforts[19] is NO_SHEDDING
    assert efforts[30].windows == 1 and efforts[30].candidates < efforts[21].candidates
    assert efforts[60].windows == 2 and efforts[90].windows == 3
    limits = [shedding.candidates for shedding in efforts if shedding.candidates is not None]
    assert limits == sorted(limits, reverse=True) and limits[-1] > 0


def test_full_inbox_drops_the_oldest_of_the_kind_and_counts_it():
    inbox = Inbox(QueueSettings(core=10, imu=100))
    inbox.put(imu(0))
    inbox.put(Command(Order.FLUSH, 1))
    for stamp in range(1, 13):
        inbox.put(scan(stamp))
    assert inbox.waiting() == (10, 1)
    assert inbox.nbytes() == 10 * scan(0).points.nbytes
    assert inbox.drops() == {('left', 'queue_full'): 2}
    inbox.request(View.MAP)
    taken = []
    while inbox.waiting() != (0, 0):
        item, views = inbox.take()
        taken.append(item)
        assert views == ({View.MAP} if len(taken) == 1 else set())
    assert isinstance(taken[0], ImuSample) and isinstance(taken[1], Command)
    assert [item.stamp for item in taken[2:]] == list(range(3, 13))


def feed(jumps, measurements):
    return [jumps.check(item) for item in measurements]


def test_stray_stamps_are_no_jump():
    jumps = JumpFilter(TimeJumpSettings())
    good = [imu(100 * SECOND + i * 10_000_000) for i in range(30)]
    stray = [imu(3 * SECOND + i) for i in range(6)]
    mixed = [item for pair in zip(good, stray * 5, strict=True) for item in pair]
    passed = [item for step in feed(jumps, mixed) for item in step.measurements]
    assert passed == good and jumps.jumps == 0
    assert jumps.drops == {('imu', 'stray_stamp'): 29}


def test_sensor_that_is_late_as_a_whole_is_no_jump():
    jumps = JumpFilter(TimeJumpSettings())
    late = [scan(50 * SECOND + i * SECOND // 10) for i in range(20)]
    on_time = [imu(100 * SECOND + i * SECOND // 10) for i in range(20)]
    steps = feed(jumps, [item for pair in zip(on_time, late, strict=True) for item in pair])
    assert jumps.jumps == 0 and all(len(step.measurements) == 1 for step in steps)


def test_jump_passes_its_witnesses_on_and_leaves_the_rest_of_the_old_run_out():
    jumps = JumpFilter(TimeJumpSettings())
    feed(jumps, [imu(100 * SECOND + i) for i in range(5)])
    feed(jumps, [scan(100 * SECOND), scan(100 * SECOND, 'right')])
    again = [scan(SECOND), *(imu(SECOND + i) for i in range(4))]
    steps = feed(jumps, again)
    assert [step.jumped for step in steps] == [False] * 4 + [True]
    assert list(steps[-1].measurements) == again
    assert feed(jumps, [scan(100 * SECOND + 7, 'right')])[0].measurements == ()
    assert jumps.drops == {('right', 'before_jump'): 1}
    fresh = scan(SECOND + 9, 'right')
    assert feed(jumps, [fresh])[0].measurements == (fresh,)


def test_jump_of_the_clock_needs_one_witness_only():
    jumps = JumpFilter(TimeJumpSettings())
    feed(jumps, [imu(100 * SECOND)])
    jumps.clock_jumped()
    assert jumps.check(imu(SECOND)).jumped


def test_ignored_jump_is_counted():
    jumps = JumpFilter(TimeJumpSettings(policy=TimeJumpPolicy.IGNORE))
    feed(jumps, [imu(100 * SECOND)])
    steps = feed(jumps, [imu(SECOND + i) for i in range(9)])
    assert not any(step.measurements or step.jumped for step in steps)
    assert jumps.drops == {('imu', 'time_jump'): 9}


@pytest.fixture(scope='module')
def followed(light_drive):
    """A mapper, what followed it, and the newest graph view after every window."""
    tree = {'mom': {'max_points': 100}, 'path': {'max_poses': 12}, 'graph': {'lag': 0.3}}
    source = open_source(light_drive, tree)
    config = effective_config(source, tree, 'test')
    mapper = Mapper(config, list(source.info.counts))
    live = LiveMap(mapper)
    for measurement in source.measurements():
        for _ in mapper.advance(measurement):
            live.follow()
            assert len(live.path().poses) <= 12
    for _ in mapper.drain():
        live.follow()
    return mapper, live


def test_long_path_is_thinned_and_ends_with_the_newest_pose(followed):
    mapper, live = followed
    path = live.path()
    assert path.stamps == sorted(path.stamps)
    assert path.stamps[-1] == mapper.state.clusters[-1].cluster.stamp
    assert path.stamps[0] == mapper.state.clusters[0].cluster.stamp
    newest = mapper.newest()
    assert path.poses[-1][:3] == pytest.approx(list(newest.pose.translation()))


def test_live_map_is_what_would_be_saved_of_the_same_poses(followed):
    mapper, live = followed
    state, settings = mapper.state, mapper.config.map
    poses = [state.pose(scan.cluster).compose(scan.T_cluster_scan) for scan in state.scans]
    settled = [not state.in_lag(scan.cluster) for scan in state.scans]
    placed = [(scan.points, pose.matrix()) for scan, pose in zip(state.scans, poses, strict=True)]

    def cells(points):
        return [tuple(cell) for cell in np.floor(points / settings.voxel_size).astype(int)]

    def saved(chosen):
        return accumulate(chosen, settings.voxel_size, settings.max_range)

    points = live.points()
    before = saved([item for item, still in zip(placed, settled, strict=True) if still])
    # What is settled comes first and is the saved map; the lag fills voxels that it leaves free.
    assert 1000 < len(before) < len(points)
    assert points[: len(before)] == pytest.approx(before, abs=1e-4)
    taken, whole = cells(points), set(cells(saved(placed)))
    assert len(set(taken)) > 0.999 * len(taken)  # a mean at a border rounds to either side
    assert len(whole ^ set(taken)) < 0.001 * len(whole)


def test_graph_view_holds_the_asked_span_only(followed):
    mapper, live = followed
    newest = mapper.state.frontier.newest_stamp
    within = [c for c in mapper.state.clusters if newest - c.cluster.stamp <= SECOND]
    view = live.graph(1.0)
    assert len(view.poses) == len(within) < len(mapper.state.clusters)
    assert view.edges['odometry'].shape[1:] == (2, 3)
    assert len(live.graph(60.0).poses) == len(mapper.state.clusters)


def test_merged_windows_and_small_budgets_keep_the_graph_whole(light_drive):
    tree = {'mom': {'max_points': 100}}
    source = open_source(light_drive, tree)
    mapper = Mapper(effective_config(source, tree, 'test'), list(source.info.counts))
    shedding = LoadShedding(candidates=4, windows=3)
    for measurement in source.measurements():
        list(mapper.advance(measurement, shedding))
    list(mapper.drain(shedding))
    stats = mapper.stats()
    assert stats['merged_windows'] >= 12 and stats['windows'] <= 10
    assert stats['components'] == 1 and stats['bridges'] == 0
    assert stats['candidates_solved'] <= 4 * stats['windows']
    used = sum(len(item.cluster.members) for item in mapper.state.clusters)
    assert used == source.info.count - source.info.counts['imu']


class FakeBroadcaster:
    def __init__(self, node):
        self.sent = []

    def sendTransform(self, transforms):  # noqa: N802 (the name that tf2_ros has)
        self.sent += transforms


def test_transforms_chain_to_the_pose_in_the_map(monkeypatch):
    fake = types.SimpleNamespace(TransformBroadcaster=FakeBroadcaster)
    monkeypatch.setitem(sys.modules, 'tf2_ros', fake)
    transforms = make_transforms(None, FrameSettings())
    assert isinstance(transforms, TfTransforms)
    in_map = gtsam.Pose3(gtsam.Rot3.Yaw(1.0), np.array([1.0, 2.0, 3.0]))
    in_odom = gtsam.Pose3(gtsam.Rot3.Yaw(0.2), np.array([0.5, 0.0, 0.0]))
    transforms.send(5, in_map, in_odom)
    sent = transforms._broadcaster.sent
    assert [(t.header.frame_id, t.child_frame_id) for t in sent] == [
        ('map', 'odom'),
        ('odom', 'base_link'),
    ]

    def pose(message):
        shift, turn = message.transform.translation, message.transform.rotation
        rotation = gtsam.Rot3(turn.w, turn.x, turn.y, turn.z)
        return gtsam.Pose3(rotation, np.array([shift.x, shift.y, shift.z]))

    assert pose(sent[0]).compose(pose(sent[1])).equals(in_map, 1e-9)


def test_settings_of_the_node_are_in_the_shared_schema():
    config = Config()
    assert config.time_jump.policy is TimeJumpPolicy.RESET
    assert config.path.max_poses == 2000
