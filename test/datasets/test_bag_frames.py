"""Frames of a bag: extrinsics by static transforms, several LiDARs on a topic, parts of sweeps."""

import numpy as np
import pytest
from bag_files import CLOUD, FIX, IMU, MS, START, STORES, TEXT, message
from rosbags.rosbag2 import StoragePlugin, Writer
from scipy.spatial.transform import Rotation

from incremental_mapper.datasets.open import open_source
from incremental_mapper.datasets.static_transforms import FrameTree, add_transform
from incremental_mapper.errors import InputError
from incremental_mapper.geometry import pose_matrix
from incremental_mapper.measurements import LidarScan
from incremental_mapper.settings import make_config, merge

STORE = STORES[2]
TF = 'tf2_msgs/msg/TFMessage'
TURN = Rotation.from_euler('xyz', [10.0, -5.0, 120.0], degrees=True)
DIGEST = 'RIHS01_38df685c5e960add4b790ac30692dd913a3eb08bad8229ca1555ef92477dff0f'
"""Of a message with one string."""
ROOM = np.random.default_rng(5).uniform([-30, -30, -2], [30, 30, 5], (600, 3)).astype(np.float32)


def framed(kind, stamp, frame, points=None):
    made = message(kind, stamp)
    made.header.__dict__.update(frame_id=frame)
    if points is not None:
        data = np.ascontiguousarray(points, dtype=np.float32).reshape(-1).view(np.uint8)
        made.__dict__.update(width=len(points), row_step=12 * len(points), data=data)
    return made


def transforms(*edges):
    """A TFMessage of (parent, child, x y z, quaternion)."""
    types = STORE.types
    made = []
    for parent, child, place, turn in edges:
        time = types['builtin_interfaces/msg/Time'](sec=START // 10**9, nanosec=0)
        header = types['std_msgs/msg/Header'](stamp=time, frame_id=parent)
        vector = types['geometry_msgs/msg/Vector3'](*map(float, place))
        quaternion = types['geometry_msgs/msg/Quaternion'](*map(float, turn))
        moved = types['geometry_msgs/msg/Transform'](vector, quaternion)
        made.append(types['geometry_msgs/msg/TransformStamped'](header, child, moved))
    return types[TF](made)


def write(path, events):
    """A bag of (topic, message); one every 10 ms."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {}
        for i, (topic, made) in enumerate(events):
            kind = made.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            data = STORE.serialize_cdr(made, kind)
            writer.write(connections[topic], START + i * 10 * MS, data)
    return path


def sensors(count=3, lidar='lidar'):
    events = []
    for i in range(count):
        stamp = START + i * 100 * MS
        events += [('/points', framed(CLOUD, stamp, lidar)), ('/imu', framed(IMU, stamp, 'imu'))]
        events.append(('/fix', framed(FIX, stamp, 'gnss')))
    return events


def said(source, word):
    found = [finding.line() for finding in source.info.findings]
    return [text for text in (*source.info.notes, *found) if word in text]


def test_static_transforms_are_the_extrinsics_that_nobody_names(tmp_path):
    tf = transforms(
        ('base_link', 'roof', (1, 0, 2), TURN.as_quat()),
        ('/roof', '/lidar', (0.5, 0, 0), (0, 0, 0, 1)),
        ('imu', 'base_link', (0, 0, -1), (0, 0, 0, 1)),
    )
    source = open_source(write(tmp_path / 'bag', [('/tf_static', tf), *sensors()]), {})
    config = make_config(source.info.settings)
    expected = np.eye(4)
    expected[:3, :3] = TURN.as_matrix()
    expected[:3, 3] = np.array([1, 0, 2]) + TURN.apply([0.5, 0, 0])
    np.testing.assert_allclose(config.lidars['points'].matrix(), expected, atol=1e-9)
    np.testing.assert_allclose(config.imu.matrix()[:3, 3], [0, 0, 1], atol=1e-9)
    assert len(said(source, 'from /tf_static')) == 2
    (note,) = said(source, 'identity_extrinsics')
    assert 'gnss.T_base_sensor' in note and "'gnss'" in note


def test_the_one_root_of_the_transforms_stands_for_the_car_where_no_base_link_is(tmp_path):
    links = [
        ('vehicle', 'roof', (1, 0, 2), (0, 0, 0, 1)),
        ('roof', 'lidar', (0.5, 0, 0), (0, 0, 0, 1)),
        ('vehicle', 'imu', (0, 0, 1), (0, 0, 0, 1)),
    ]
    events = [('/tf_static', transforms(*links)), *sensors()]
    source = open_source(write(tmp_path / 'bag', events), {})
    config = make_config(source.info.settings)
    assert config.lidars['points'].T_base_sensor[:3] == (1.5, 0, 2)
    assert config.imu.T_base_sensor[:3] == (0, 0, 1)
    (note,) = said(source, 'other_base_frame')
    assert "'vehicle'" in note and 'points' in note and 'imu' in note


@pytest.mark.parametrize(
    'links',
    [
        [('map', 'lidar', (1, 0, 2), (0, 0, 0, 1)), ('map', 'imu', (0, 0, 1), (0, 0, 0, 1))],
        [('one', 'lidar', (1, 0, 2), (0, 0, 0, 1)), ('two', 'imu', (0, 0, 1), (0, 0, 0, 1))],
    ],
)
def test_a_map_or_one_of_several_roots_is_no_car(tmp_path, links):
    events = [('/tf_static', transforms(*links)), *sensors()]
    source = open_source(write(tmp_path / 'bag', events), {})
    assert make_config(source.info.settings).lidars['points'].T_base_sensor[:3] == (0, 0, 0)
    assert not said(source, 'other_base_frame') and said(source, 'identity_extrinsics')


def test_static_transforms_that_contradict_each_other_are_told(tmp_path):
    first = ('base_link', 'lidar', (1, 0, 2), (0, 0, 0, 1))
    again = ('base_link', 'lidar', (1.05, 0, 2), (0, 0, 0, 1))
    other = ('base_link', 'lidar', (1, 0, 1), (0, 0, 0, 1))
    for last, count in ((first, 0), (again, 0), (other, 1)):
        tf = [('/tf_static', transforms(first)), ('/tf_static', transforms(last))]
        bag = write(tmp_path / str(last[2]), [*tf, *sensors()])
        source = open_source(bag, {})
        assert len(said(source, 'transform_changes')) == count
        place = make_config(source.info.settings).lidars['points'].T_base_sensor[:3]
        assert place == pytest.approx(last[2])


def test_a_publisher_that_contradicts_itself_for_hours_is_told_once():
    tree = FrameTree()
    for number in range(100):
        place = np.array([number % 2, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
        add_transform(tree, '/tf_static', ('base_link', 'lidar'), place)
        add_transform(tree, '/tf_static', ('base_link', 'imu'), np.zeros(7))
    rules = [(one.rule, one.sensor) for one in tree.findings]
    assert sorted(rules) == [('bad_transform', 'imu'), ('transform_changes', 'lidar')]


def test_what_the_settings_say_comes_first(tmp_path):
    tf = transforms(('base_link', 'lidar', (1, 0, 2), (0, 0, 0, 1)))
    bag = write(tmp_path / 'bag', [('/tf_static', tf), *sensors()])
    pose = [1.0, 0.0, 2.5, 0.0, 0.0, 0.0, 1.0]
    tree = {'lidars': {'names': ['roof'], 'roof': {'T_base_sensor': pose}}}
    source = open_source(bag, tree)
    config = make_config(merge(source.info.settings, tree))
    np.testing.assert_array_equal(config.lidars['roof'].matrix(), pose_matrix(pose))
    (note,) = said(source, 'extrinsics_differ')
    assert '0.50 m and 0.0 degrees' in note
    near = {'lidars': {'names': ['roof'], 'roof': {'T_base_sensor': [1, 0, 2.05, 0, 0, 0, 1]}}}
    assert not said(open_source(bag, near), 'extrinsics_differ')


def test_transforms_that_are_none_are_left_out(tmp_path):
    tf = transforms(('base_link', 'lidar', (1, 0, 2), (0, 0, 0, 0.5)))
    source = open_source(write(tmp_path / 'bag', [('/tf_static', tf), *sensors()]), {})
    assert len(said(source, 'bad_transform')) == 1
    assert make_config(source.info.settings).lidars['points'].T_base_sensor[:3] == (0, 0, 0)


def test_of_tf_only_what_stands_still_counts(tmp_path):
    moving = [
        transforms(
            ('base_link', 'lidar', (1, 0, 2), (0, 0, 0, 1)),
            ('odom', 'base_link', (i, 0, 0), (0, 0, 0, 1)),
            ('odom', 'imu', (i, 0, 1), (0, 0, 0, 1)),
        )
        for i in range(3)
    ]
    events = [*(('/tf', made) for made in moving), *sensors()]
    source = open_source(write(tmp_path / 'bag', events), {})
    config = make_config(source.info.settings)
    assert config.lidars['points'].T_base_sensor[:3] == (1, 0, 2)
    assert config.imu.T_base_sensor[:3] == (0, 0, 0)
    assert len(said(source, 'from /tf,')) == 1


def test_one_sensor_alone_needs_no_extrinsics(tmp_path):
    events = [('/points', framed(CLOUD, START + i * 100 * MS, 'lidar')) for i in range(3)]
    assert not said(open_source(write(tmp_path / 'bag', events), {}), 'extrinsics')


@pytest.mark.parametrize('frame', ['', 'x' * 20_000])
def test_stray_messages_of_another_frame_are_no_lidar(tmp_path, frame):
    events = [
        ('/points', framed(CLOUD, START + i * 100 * MS, frame if i in (2, 30) else 'lidar'))
        for i in range(60)
    ]
    source = open_source(write(tmp_path / 'bag', events), {})
    assert source.info.counts == {'points': 60}
    assert not said(source, 'several_frames')
    assert sum(1 for _ in source.measurements()) == 60
    (found,) = (item for item in source.info.findings if item.rule == 'other_frame')
    assert '2 clouds' in found.text and len(found.text) < 300


def turns(count, frames, shift=4.0):
    """Clouds of two LiDARs by turns, and an IMU."""
    events = [('/imu', framed(IMU, START, 'imu'))]
    for i in range(count):
        points = ROOM + (shift if i % 2 else 0.0) + 0.1 * i
        frame = frames[i % len(frames)]
        events.append(('/lidar', framed(CLOUD, START + i * 50 * MS, frame, points)))
    return events


def placed(*names, **more):
    """Settings that give LiDARs a place each."""
    lidars = {
        name: {'T_base_sensor': [i, 0, 0, 0, 0, 0, 1], **more} for i, name in enumerate(names)
    }
    return {'lidars': {'names': list(names), **lidars}}


def test_two_lidars_on_one_topic_are_told_apart_by_their_frames(tmp_path):
    bag = write(tmp_path / 'bag', turns(20, ['front_lidar', '/rear/lidar']))
    source = open_source(bag, placed('front', 'rear'))
    assert source.info.counts == {'front': 10, 'rear': 10, 'imu': 1}
    scans = [m for m in source.measurements() if isinstance(m, LidarScan)]
    assert [scan.sensor for scan in scans[:4]] == ['front', 'rear'] * 2
    assert scans[1].points.mean() - scans[0].points.mean() == pytest.approx(4.1, abs=1e-3)
    assert source.drops == {} and len(said(source, 'several_frames')) == 1
    assert not said(source, 'two_lidars_one_frame') and not said(source, 'extrinsics')
    for topic in ({}, {'topic': '/lidar'}):
        tree = placed('rear', 'front', **topic)
        named = open_source(bag, tree)
        scans = [m for m in named.measurements() if isinstance(m, LidarScan)]
        assert [scan.sensor for scan in scans[:2]] == ['front', 'rear']
        make_config(merge(named.info.settings, tree))


def test_a_lidar_that_nobody_places_beside_another_is_left_out(tmp_path):
    events = turns(21, ['front', 'rear'])
    bag = write(tmp_path / 'bag', events)
    source = open_source(bag, {})
    assert source.info.counts == {'front': 11, 'imu': 1}
    assert source.info.settings['lidars']['names'] == ['front']
    (line,) = said(source, 'lidar_left_out')
    assert line.startswith('rear: ') and 'lidars.rear.T_base_sensor' in line
    tf = transforms(('base_link', 'rear', (1, 0, 2), (0, 0, 0, 1)))
    source = open_source(write(tmp_path / 'tf', [('/tf_static', tf), *events]), {})
    assert source.info.counts == {'rear': 10, 'imu': 1}
    one = [(topic, framed(m.__msgtype__, START, 'body')) for topic, m in events]
    source = open_source(write(tmp_path / 'body', [*one, ('/other', one[1][1])]), {})
    assert source.info.counts == {'lidar': 21, 'other': 1, 'imu': 1}


@pytest.mark.parametrize(('shift', 'told'), [(4.0, 1), (0.0, 0)])
def test_two_lidars_under_one_frame_are_told(tmp_path, shift, told):
    source = open_source(write(tmp_path / 'bag', turns(20, ['livox'], shift)), {})
    assert len(said(source, 'two_lidars_one_frame')) == told


@pytest.mark.parametrize('frame', ['map', '/odom', 'world'])
def test_clouds_of_a_map_are_no_lidar(tmp_path, frame):
    events = [*sensors(), *(('/map_cloud', framed(CLOUD, START + i, frame)) for i in range(5))]
    bag = write(tmp_path / 'bag', events)
    source = open_source(bag, {})
    assert source.info.counts == {'points': 3, 'imu': 3, 'gnss': 3}
    assert len(said(source, 'map_frame')) == 1
    tree = {'lidars': {'names': ['all'], 'all': {'topic': '/map_cloud'}}}
    named = open_source(bag, tree)
    assert named.info.counts['all'] == 5 and len(said(named, 'map_frame')) == 1


def test_a_topic_that_is_not_there_is_a_note_where_the_rest_suffices(tmp_path):
    bag = write(tmp_path / 'bag', sensors())
    tree = {
        'lidars': {'names': ['a', 'b'], 'a': {'topic': '/points'}, 'b': {'topic': '/other'}},
        'imu': {'topic': '/nothing'},
    }
    source = open_source(bag, tree)
    assert source.info.counts == {'a': 3, 'gnss': 3}
    assert len(said(source, 'missing_topic')) == 2
    (note,) = said(source, 'imu.topic')
    assert "'/nothing'" in note and note.endswith('/imu')
    del tree['lidars']['a']['topic']
    tree['lidars']['a'] = {'topic': '/neither'}
    with pytest.raises(InputError, match='no cloud for the LiDARs a, b'):
        open_source(bag, tree)


def vendor_bag(path, with_clouds):
    store_message = message(TEXT, START)
    kind = 'velodyne_msgs/msg/VelodyneScan'
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        packets = writer.add_connection(
            '/velodyne_packets', kind, msgdef='string data\n', rihs01=DIGEST
        )
        writer.write(packets, START, STORE.serialize_cdr(store_message, TEXT))
        if with_clouds:
            clouds = writer.add_connection('/points', CLOUD, typestore=STORE)
            data = STORE.serialize_cdr(message(CLOUD, START), CLOUD)
            writer.write(clouds, START, data)
    return path


def sectors(path, parts, sweeps=3, frames=('lidar',)):
    """A turning LiDAR that sends every sweep in so many clouds, one for each frame."""
    azimuth = np.linspace(-np.pi, np.pi, 1440, endpoint=False)
    events = []
    for sweep in range(sweeps * 10 // parts + 3):
        radius = 10.0 + 3.0 * np.sin(4.0 * azimuth) + 0.05 * sweep
        ring = np.column_stack([radius * np.cos(azimuth), radius * np.sin(azimuth), 0 * radius])
        for i, part in enumerate(np.array_split(ring, parts)):
            stamp = START + sweep * 100 * MS + i * 100 * MS // parts
            events += [('/scan', framed(CLOUD, stamp, frame, part)) for frame in frames]
    return write(path, events)


@pytest.mark.parametrize('parts', [2, 3, 10, 36])
def test_parts_of_sweeps_are_gathered(tmp_path, parts):
    source = open_source(sectors(tmp_path / 'bag', parts, 6), {})
    (line,) = said(source, 'sector_clouds')
    assert '/scan' in line and source.info.settings['lidars']['scan']['sectors'] is True
    assert not said(source, 'two_lidars_one_frame')
    sweeps = list(source.measurements())
    assert source.drops == {} and len(sweeps) >= 3
    for sweep in sweeps[:-1]:
        assert len(sweep.points) == 1440
        spent = sweep.point_times.max() - sweep.point_times.min()
        assert spent == pytest.approx(0.1, abs=0.1 / parts + 1e-3)
    assert np.diff([sweep.stamp for sweep in sweeps[:-1]]) == pytest.approx(100 * MS, rel=1e-3)


def test_parts_of_sweeps_of_two_lidars_on_one_topic_are_gathered(tmp_path):
    bag = sectors(tmp_path / 'bag', 8, 6, ('front', 'rear'))
    source = open_source(bag, placed('front', 'rear'))
    assert len(said(source, 'sector_clouds')) == 2 and len(said(source, 'several_frames')) == 1
    sweeps = list(source.measurements())
    assert source.drops == {} and {sweep.sensor for sweep in sweeps} == {'front', 'rear'}
    assert {len(sweep.points) for sweep in sweeps[:-2]} == {1440}


def test_whole_sweeps_and_narrow_views_are_not_parts(tmp_path):
    assert open_source(sectors(tmp_path / 'whole', 1), {}).info.counts['scan'] > 12
    azimuth = np.linspace(-0.6, 0.6, 600)
    view = np.column_stack([20 * np.cos(azimuth), 20 * np.sin(azimuth), 0 * azimuth])
    events = [
        ('/scan', framed(CLOUD, START + i * 10 * MS, 'lidar', view + 0.1 * i)) for i in range(30)
    ]
    assert open_source(write(tmp_path / 'narrow', events), {}).info.counts == {'scan': 30}


def test_a_lidar_that_comes_later_on_the_topic_is_noted(tmp_path):
    events = [*turns(40, ['front'], 0.0), *turns(6, ['rear'], 0.0)]
    source = open_source(write(tmp_path / 'bag', events), {})
    assert not said(source, 'other_frame')
    assert len([m for m in source.measurements() if isinstance(m, LidarScan)]) == 46
    (note,) = said(source, 'other_frame')
    assert "6 clouds have the frame_id 'rear'" in note


def test_lidars_that_exchange_their_topics_are_told_by_their_frames(tmp_path):
    names = ['front', 'rear']
    events = [
        (f'/{names[(lidar + (step >= 30)) % 2]}', framed(CLOUD, START + step * 100 * MS, frame))
        for step in range(40)
        for lidar, frame in enumerate(names)
    ]
    source = open_source(
        write(tmp_path / 'bag', events),
        {
            'lidars': {
                'names': names,
                **{
                    name: {'topic': f'/{name}', 'T_base_sensor': [x, 0, 0, 0, 0, 0, 1]}
                    for name, x in (('front', 2.0), ('rear', -1.0))
                },
            }
        },
    )
    counts = [m.sensor for m in source.measurements() if isinstance(m, LidarScan)]
    assert counts == names * 40
    notes = said(source, 'other_frame')
    assert len(notes) == 2 and any('taken for those of rear' in note for note in notes)


def test_packets_are_named_with_what_converts_them(tmp_path):
    with pytest.raises(InputError, match=r'/velodyne_packets: .*velodyne_pointcloud'):
        open_source(vendor_bag(tmp_path / 'packets', False), {})
    source = open_source(vendor_bag(tmp_path / 'both', True), {})
    assert len(said(source, 'vendor_message')) == 1


def test_copies_are_left_out_beside_a_map_that_was_made_of_the_same(tmp_path):
    tf = transforms(('base_link', 'lidar', (1, 0, 2), (0, 0, 0, 1)))
    events = [('/tf_static', tf)]
    for i in range(14):
        stamp, points = START + i * 100 * MS, ROOM[i:] + 0.1 * i
        events += [
            ('/points', framed(CLOUD, stamp, 'lidar', points)),
            ('/filtered', framed(CLOUD, stamp, 'lidar', points[points[:, 2] > 0])),
            ('/cloud_registered', framed(CLOUD, stamp, 'map', points + 40.0)),
        ]
    source = open_source(write(tmp_path / 'bag', events), {})
    assert source.info.counts == {'points': 14}
    assert len(said(source, 'copied_clouds')) == len(said(source, 'map_frame')) == 1
    assert source.info.findings == ()


def test_a_second_receiver_on_the_topic_is_left_out(tmp_path):
    rear = [
        ('/fix', framed(FIX, START + i * 100 * MS + 50 * MS, 'rear_gnss')) for i in range(3, 20, 4)
    ]
    events = sorted(
        [*sensors(count=20), *rear],
        key=lambda item: item[1].header.stamp.sec * 10**9 + item[1].header.stamp.nanosec,
    )
    source = open_source(write(tmp_path / 'bag', events), {})
    stamps = [item.stamp for item in source.measurements() if item.sensor == 'gnss']
    assert len(stamps) == 20 and all((stamp - START) % (100 * MS) == 0 for stamp in stamps)
    assert source.drops['gnss', 'foreign_frame'] == 5
    (note,) = said(source, 'foreign_frame')
    assert "'rear_gnss'" in note
