"""Bags that are played into real DDS topics and heard by a subscriber in this process."""

import sqlite3
import subprocess
import sys
import textwrap
import time
from functools import partial
from pathlib import Path

import pytest
from bag_files import (
    CLOUD,
    FIX,
    IMU,
    MS,
    START,
    STORES,
    TEXT,
    USUAL,
    message,
    write_bag,
    write_ros1,
)
from rosbags.convert.converter import default_message
from rosbags.highlevel import AnyReader
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from incremental_mapper.errors import InputError

pytest.importorskip('rclpy', reason='rclpy is not installed (extra "ros")')

from player_listener import Listener, own_domain
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import BatteryState, Imu, NavSatFix, PointCloud2
from std_msgs.msg import String

from incremental_mapper.ros.player import playback as player_module
from incremental_mapper.ros.player.pace import Pace
from incremental_mapper.ros.player.playback import PlayOptions, open_player

CLASSES = {CLOUD: PointCloud2, IMU: Imu, FIX: NavSatFix, TEXT: String}
ALL = {name: CLASSES[kind] for name, kind, *_ in USUAL}
FAST = PlayOptions(rate=50.0, wait=10.0)


@pytest.fixture(autouse=True)
def domain(monkeypatch):
    own_domain(monkeypatch)


class Patience:
    """Controls that only wait."""

    def wait(self, seconds):
        time.sleep(seconds)
        return False

    def show(self, done, total, paused):
        pass


def play(path, options=FAST, controls=None):
    """Play to the end; returns the player."""
    with open_player(path, options, controls or Patience()) as player:
        player.wait_for_subscriptions()
        player.play()
        assert player.wait_for_acknowledgement()
    return player


def hear(path, topics=ALL, options=FAST, counts=None):
    """Play into a listener; returns the player and the listener's messages by topic."""
    with Listener(topics) as listener:
        player = play(path, options)
        listener.wait_for(counts or logged_counts(path, topics))
        time.sleep(0.1)  # what should not come would come now
    return player, listener.got


def logged(path):
    """Serialised messages of a bag by topic."""
    found = {}
    with AnyReader([path]) as reader:
        for connection, _, data in reader.messages():
            found.setdefault(connection.topic, []).append(bytes(data))
    return found


def logged_counts(path, topics):
    return {name: len(data) for name, data in logged(path).items() if name in topics}


@pytest.mark.parametrize('plugin', [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_every_message_arrives_in_order_and_unchanged(tmp_path, plugin):
    path = write_bag(tmp_path / 'bag', plugin=plugin)
    player, got = hear(path)
    assert got == logged(path)
    assert player.notes == []
    assert player.report.messages == sum(count for *_, count in USUAL)
    assert player.report.late_most >= 0.0
    assert '58 messages; on average' in str(player.report)


def test_ros1_bag(tmp_path):
    path = write_ros1(tmp_path / 'old.bag')
    player, got = hear(path)
    assert player.report.unreadable == 0
    for name, kind, phase, period, count in USUAL:
        stamps = [START + (phase + index * period) * MS for index in range(count)]
        expected = [bytes(STORES[2].serialize_cdr(message(kind, s), kind)) for s in stamps]
        assert got[name] == expected, name
    assert deserialize_message(got['/fix'][0], NavSatFix).latitude == 36.5


def test_ros1_type_with_other_fields_in_ros2(tmp_path):
    """The battery got a temperature; the bytes alone would not do."""
    kind = 'sensor_msgs/msg/BatteryState'
    store = STORES[1]
    path = tmp_path / 'old.bag'
    with Writer1(path) as writer:
        connection = writer.add_connection('/battery', kind, typestore=store)
        state = default_message(store, kind)
        state.voltage, state.location = 12.5, 'front'
        writer.write(connection, START, store.serialize_ros1(state, kind))
    _, got = hear(path, {'/battery': BatteryState})
    (heard,) = got['/battery']
    state = deserialize_message(heard, BatteryState)
    assert (state.voltage, state.location, state.temperature) == (12.5, 'front', 0.0)


def test_burst(tmp_path):
    """The player waits rather than overwrite what was not acknowledged."""
    path = write_bag(tmp_path / 'bag', topics=[('/imu', IMU, 0, 0, 6000)])
    _, got = hear(path, {'/imu': Imu})
    assert got['/imu'] == logged(path)['/imu']


@pytest.mark.parametrize(
    ('choice', 'imu', 'fix'),
    [
        ({'start': 0.2}, 20, 4),  # stamps of imu 3 + 10i, of fix 5 + 50i ms
        ({'duration': 0.1}, 10, 2),
        ({'start': 0.1, 'duration': 0.1}, 10, 2),
        ({'start': 0.39}, 1, 0),
        ({'start': 0.1, 'duration': 100.0}, 30, 6),
    ],
)
def test_start_and_duration(tmp_path, choice, imu, fix):
    path = write_bag(tmp_path / 'bag')
    options = PlayOptions(rate=50.0, wait=10.0, **choice)
    _, got = hear(path, options=options, counts={'/imu': imu, '/fix': fix})
    assert (len(got['/imu']), len(got['/fix'])) == (imu, fix)
    every = logged(path)['/imu']
    first = every.index(got['/imu'][0])
    assert got['/imu'] == every[first : first + imu]


@pytest.mark.parametrize('names', [('/imu', '/fix'), ('imu', 'fix')])
def test_topics(tmp_path, names):
    path = write_bag(tmp_path / 'bag')
    options = PlayOptions(rate=50.0, topics=names, wait=1.0)
    player, got = hear(path, options=options, counts={'/imu': 40, '/fix': 8})
    assert {name: len(data) for name, data in got.items() if data} == {'/imu': 40, '/fix': 8}
    assert player.report.messages == 48 and player.report.missing == 0


class FakeTime(Patience):
    """Controls and clock in one: waiting takes no time, and keys are pressed by plan."""

    def __init__(self, pressed=()):
        self.now = 0.0
        self.pressed = list(pressed)
        self.shown = []

    def clock(self):
        return round(self.now * 1e9)

    def wait(self, seconds):
        self.now += seconds
        if self.pressed and self.now >= self.pressed[0]:
            self.pressed.pop(0)
            return True
        return False

    def show(self, done, total, paused):
        self.shown.append((self.now, done, total, paused))


@pytest.mark.parametrize('rate', [0.25, 1.0, 4.0])
def test_rate(tmp_path, monkeypatch, rate):
    path = write_bag(tmp_path / 'bag')
    controls = FakeTime()
    monkeypatch.setattr(player_module, 'Pace', partial(Pace, clock=controls.clock))
    player = play(path, PlayOptions(rate=rate, wait=0.0), controls)
    assert controls.now == pytest.approx(0.393 / rate, abs=1e-6)
    for now, done, total, paused in controls.shown:
        assert done == pytest.approx(now * rate, abs=1e-6)
        assert total == pytest.approx(0.393, abs=1e-6) and not paused
    assert player.report.late_most == pytest.approx(0.0, abs=1e-6)


def test_pause(tmp_path, monkeypatch):
    path = write_bag(tmp_path / 'bag')
    controls = FakeTime(pressed=[0.1, 60.0])
    monkeypatch.setattr(player_module, 'Pace', partial(Pace, clock=controls.clock))
    player = play(path, PlayOptions(wait=0.0), controls)
    resting = [(now, done) for now, done, _, paused in controls.shown if paused]
    assert len({done for _, done in resting}) == 1
    assert resting[-1][0] - resting[0][0] > 59.0
    assert controls.now == pytest.approx(0.393 + 59.9, abs=0.2)
    assert player.report.messages == 58
    assert player.report.late_most < 0.1


def test_loop_begins_again(tmp_path):
    path = write_bag(tmp_path / 'bag', topics=[('/imu', IMU, 0, 10, 5)])

    class ThreeRounds(Patience):
        def show(self, done, total, paused):
            if player.report.rounds == 4:
                raise KeyboardInterrupt

    options = PlayOptions(rate=50.0, loop=True, wait=10.0)
    with (
        Listener({'/imu': Imu}) as listener,
        open_player(path, options, ThreeRounds()) as player,
    ):
        player.wait_for_subscriptions()
        with pytest.raises(KeyboardInterrupt):
            player.play()
        listener.wait_for({'/imu': 15})
    assert listener.got['/imu'] == 3 * logged(path)['/imu']
    assert '15 messages in 4 rounds' in str(player.report)


def test_clock(tmp_path):
    path = write_bag(tmp_path / 'bag')
    options = PlayOptions(rate=1.0, clock=True, wait=10.0)
    _, got = hear(path, {**ALL, '/clock': Clock}, options=options)
    times = [deserialize_message(data, Clock).clock for data in got['/clock']]
    stamps = [time.sec * 10**9 + time.nanosec for time in times]
    assert len(stamps) > 2
    assert stamps == sorted(stamps)
    assert stamps[0] >= START and stamps[-1] >= START + 300 * MS
    assert {name: len(data) for name, data in got.items() if name != '/clock'} == {
        name: count for name, *_, count in USUAL
    }


def test_recorded_clock_gives_way_to_clock(tmp_path):
    path = tmp_path / 'bag'
    types = STORES[2].types
    with Writer2(path, version=9) as writer:
        for name, kind in (('/clock', 'rosgraph_msgs/msg/Clock'), ('/text', TEXT)):
            connection = writer.add_connection(name, kind, typestore=STORES[2])
            content = (
                types[kind](data='hello')
                if kind == TEXT
                else types[kind](types['builtin_interfaces/msg/Time'](sec=7, nanosec=0))
            )
            writer.write(connection, START, STORES[2].serialize_cdr(content, kind))
    player, got = hear(path, {'/clock': Clock, '/text': String}, counts={'/clock': 1, '/text': 1})
    assert deserialize_message(got['/clock'][0], Clock).clock.sec == 7
    options = PlayOptions(clock=True, wait=10.0)
    player, got = hear(path, {'/clock': Clock}, options, counts={'/clock': 1})
    assert player.notes == ['/clock: not from the bag, --clock publishes it']
    assert deserialize_message(got['/clock'][0], Clock).clock.sec == START // 10**9


def custom_bag(path, others=USUAL) -> Path:
    """A bag with a type that no package here has."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg('int32 number', 'nobody_msgs/msg/Thing'))
    with Writer2(path, version=9) as writer:
        thing = writer.add_connection('/thing', 'nobody_msgs/msg/Thing', typestore=store)
        data = store.serialize_cdr(store.types['nobody_msgs/msg/Thing'](3), thing.msgtype)
        writer.write(thing, START, data)
        for name, kind, *_ in others:
            connection = writer.add_connection(name, kind, typestore=STORES[2])
            data = bytes(STORES[2].serialize_cdr(message(kind, START), kind))
            writer.write(connection, START, data)
    return path


def test_unknown_type_is_skipped_with_a_note(tmp_path):
    player, got = hear(custom_bag(tmp_path / 'bag'))
    assert player.notes == ['/thing: nobody_msgs/msg/Thing is not installed']
    assert all(len(data) == 1 for data in got.values())
    assert player.report.missing == 0


def test_nothing_to_play(tmp_path):
    with pytest.raises(InputError, match=r'nothing to play\..*Thing is not installed'):
        play(custom_bag(tmp_path / 'bag', others=[]))


def test_name_that_ros2_does_not_allow(tmp_path):
    topics = [('/camera/1/text', TEXT, 0, 10, 2), ('imu', IMU, 0, 10, 2)]
    player, got = hear(write_ros1(tmp_path / 'old.bag', topics), {'/imu': Imu}, counts={'/imu': 2})
    assert player.notes == ['/camera/1/text: is no valid name in ROS 2']
    assert len(got['/imu']) == 2


@pytest.mark.parametrize(
    ('choice', 'words'),
    [
        ({'topics': ('/imu', '/odd')}, 'has no topic odd. The bag has .*/imu'),
        ({'start': 0.5}, 'no message to play between 0.5 s'),
        ({'start': 0.02, 'duration': 0.001}, 'no message to play between 0.02 s and 0.021 s'),
    ],
)
def test_wrong_choice(tmp_path, choice, words):
    path = write_bag(tmp_path / 'bag')
    with pytest.raises(InputError, match=words):
        play(path, PlayOptions(**choice))


def test_late_joiner_gets_what_was_latched(tmp_path):
    path = tmp_path / 'bag'
    never = QosTime(0, 0)
    latched = Qos(
        QosHistory.KEEP_LAST,
        2,
        QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL,
        never,
        never,
        QosLiveliness.AUTOMATIC,
        never,
        False,
    )
    texts = [
        bytes(STORES[2].serialize_cdr(STORES[2].types[TEXT](data=word), TEXT))
        for word in ('one', 'two', 'three')
    ]
    with Writer2(path, version=9) as writer:
        for name, profiles in (('/kept', [latched]), ('/lost', [])):
            connection = writer.add_connection(
                name, TEXT, typestore=STORES[2], offered_qos_profiles=profiles
            )
            for index, data in enumerate(texts):
                writer.write(connection, START + index, data)
    with open_player(path, PlayOptions(wait=0.0), Patience()) as player:
        player.play()
        with Listener({'/kept': String}, latched=True) as late, Listener({'/lost': String}) as none:
            late.wait_for({'/kept': 2})
    assert late.got['/kept'] == texts[1:]
    assert none.got['/lost'] == []


def test_damaged_bag_is_played_up_to_the_damage(tmp_path):
    path = write_bag(tmp_path / 'bag', topics=[('/points', CLOUD, 0, 1, 20_000)])
    file = next(path.glob('*.mcap'))
    data = bytearray(file.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 50_000] = bytes(50_000)
    file.write_bytes(data)
    options = PlayOptions(rate=1000.0, wait=0.0)
    with open_player(path, options, Patience()) as player:
        with pytest.raises(InputError, match=r'bag: damaged after \d+ messages'):
            player.play()
        assert 0 < player.report.messages < 20_000


def test_messages_that_the_bag_lost_are_counted(tmp_path):
    path = write_bag(tmp_path / 'bag', plugin=StoragePlugin.SQLITE3)
    with sqlite3.connect(next(path.glob('*.db3'))) as database:
        database.execute('DELETE FROM messages WHERE id % 10 = 0')
    player = play(path, PlayOptions(rate=50.0, wait=0.0))
    assert (player.report.messages, player.report.missing) == (53, 5)
    assert str(player.report).endswith('5 more announced but missing')


def test_ros1_message_that_is_cut_short_is_counted(tmp_path):
    path = tmp_path / 'old.bag'
    with Writer1(path) as writer:
        connection = writer.add_connection('/imu', IMU, typestore=STORES[1])
        data = bytes(STORES[1].serialize_ros1(message(IMU, START, ros=1), IMU))
        for index, part in enumerate([data, data[:-9], data]):
            writer.write(connection, START + index, part)
    player = play(path, PlayOptions(wait=0.0))
    assert (player.report.messages, player.report.unreadable) == (2, 1)
    assert player.report.missing == 0
    assert '1 unreadable' in str(player.report)


def test_a_subscriber_that_hangs_ends_the_playing(tmp_path, monkeypatch):
    class Full:
        def publish(self, data):
            raise RuntimeError('cannot publish data')

    monkeypatch.setattr(player_module, '_STUCK', 0.2)
    with open_player(write_bag(tmp_path / 'bag'), PlayOptions(), Patience()) as player:
        player._publishers = dict.fromkeys(player._publishers, Full())
        with pytest.raises(InputError, match=r'no message could be published.*cannot publish'):
            player.play()


def test_nobody_listens(tmp_path):
    path = write_bag(tmp_path / 'bag')
    with open_player(path, PlayOptions(wait=0.2), Patience()) as player:
        assert not player.wait_for_subscriptions()


def test_waiting_ends_when_no_more_subscriptions_come(tmp_path):
    path = write_bag(tmp_path / 'bag')
    with Listener({'/imu': Imu}), open_player(path, PlayOptions(wait=60.0), Patience()) as player:
        assert player.wait_for_subscriptions()


def test_player_loads_nothing_of_the_mapper():
    program = """
        import sys
        import incremental_mapper.ros.player.playback
        print(sorted({'gtsam', 'scipy', 'pydantic', 'numba'} & sys.modules.keys()))
    """
    done = subprocess.run(
        [sys.executable, '-c', textwrap.dedent(program)], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == '[]'
