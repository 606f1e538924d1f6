"""The node and the player as separate programs, and a client that listens: real DDS."""

import json
import signal
import subprocess
from contextlib import ExitStack
from itertools import pairwise

import pytest
import yaml
from drive_edits import FILES

pytest.importorskip('rclpy', reason='rclpy is not installed (extra "ros")')

from ros_helpers import (
    assert_same_graph,
    bag_parameters,
    map_offline,
    next_domain,
    read_inputs,
    stamp_of,
)

from incremental_mapper.ros.client import open_client
from incremental_mapper.ros.programs import (
    local_environment,
    node_command,
    player_command,
    running,
)
from incremental_mapper.trajectory import read_tum

CLOCK = {'use_sim_time': True}
ROOMY = {'queue': {'core': 3000, 'max_delay': 0.0}}
"""So that a busy machine does not search less than ``map`` does."""


class Programs:
    """A node, a player when it is wanted, and a client, in a ROS domain of their own."""

    def __init__(self, stack, folder, tree):
        self._stack, self._folder = stack, folder
        self._environment = local_environment(domain := next_domain())
        parameters = folder / 'parameters.yaml'
        parameters.write_text(yaml.safe_dump({'/**': {'ros__parameters': tree}}))
        self.node = self._start('node', node_command([parameters]))
        self.client = stack.enter_context(open_client(domain))

    def play(self, bag, *options):
        """Start the player; it waits until the node listens."""
        return self._start('player', player_command(bag, '--wait', 30, *options))

    def wait(self, condition, what, timeout=60.0):
        self.client.wait(condition, what, timeout, alive=lambda: self.node.poll() is None)

    def end_node(self, number=signal.SIGTERM):
        """Send a signal to the node; it must end well."""
        self.node.send_signal(number)
        self.node.wait(30.0)
        assert self.node.returncode == 0, self.text('node')
        assert 'Traceback' not in self.text('node')

    def text(self, name):
        """What a program has printed so far."""
        return (self._folder / f'{name}.log').read_text()

    def windows(self):
        """Numbers of the windows so far."""
        return [stats['window.window'] for stats in self.client.stats]

    def _start(self, name, command):
        log = self._stack.enter_context((self._folder / f'{name}.log').open('w'))
        return self._stack.enter_context(
            running(command, self._environment, stdout=log, stderr=subprocess.STDOUT)
        )


@pytest.fixture
def start(tmp_path, light_bag):
    """Start a node with settings laid over those of ``light_bag``; all ends with the test."""
    with ExitStack() as stack:
        yield lambda *trees: Programs(stack, tmp_path, bag_parameters(light_bag, *trees))


def assert_complete(folder):
    """All files are there, can be read, and tell the same story; nothing else is beside them."""
    assert {path.name for path in folder.iterdir()} >= FILES
    stats = json.loads((folder / 'stats.json').read_text())
    graph = json.loads((folder / 'graph.json').read_text())
    trajectory = read_tum(folder / 'trajectory.tum')
    assert len(graph['clusters']) == len(trajectory) == stats['clusters'] > 0
    assert [item['stamp_ns'] for item in graph['clusters']] == trajectory.stamps.tolist()
    assert len(graph['factors']) == stats['factors']
    assert len((folder / 'windows.csv').read_text().splitlines()) == stats['windows'] + 1
    assert stats['components'] == 1 and stats['unused_measurements'] == 0
    head, body = (folder / 'map.ply').read_bytes().split(b'end_header\n', 1)
    numbers = 3 + (b'property float intensity' in head)
    assert len(body) == 4 * numbers * stats['map_points']
    assert f'element vertex {stats["map_points"]}\n'.encode() in head
    assert (folder / 'graph.g2o').read_text().count('VERTEX_SE3') == stats['clusters']


def test_node_makes_of_a_played_bag_what_map_makes_of_it(start, bag, tmp_path):
    saved = tmp_path / 'saved'
    programs = start(ROOMY, {'save': {'folder': str(saved)}})
    # The player waits for the node alone: what is sent before the client is found is lost to it.
    programs.wait(lambda: programs.client.diagnostics, 'the node')
    player = programs.play(bag, '--rate', 0.5)
    messages = read_inputs(bag)
    programs.wait(lambda: player.poll() is not None, 'end of the playing')
    assert player.returncode == 0, programs.text('player')
    client = programs.client
    counts = {}
    for item in messages:
        counts[item.topic] = counts.get(item.topic, 0) + 1

    def arrived():
        parts = client.fresh_diagnostics().values()
        return {part['topic']: part['received'] for part in parts if 'topic' in part}

    programs.wait(lambda: arrived() == counts, f'{counts} messages')
    assert client.call('flush')[0]
    assert client.call('save_map') == (True, f'saved to {saved}; pictures follow')
    offline = map_offline(bag, bag_parameters(bag))
    programs.wait(lambda: len(client.stats) == len(offline.result.rows), 'all windows')
    appended = [row for row in offline.result.rows if row['clusters']]
    # Another topic: what is sent first need not be taken first.
    programs.wait(lambda: len(client.odometry) >= len(appended), 'all odometry')
    assert len(client.odometry) == len(appended)
    stamps = [stamp_of(heard.message) for heard in client.odometry]
    assert stamps == sorted(set(stamps))
    found = client.fresh_diagnostics()
    assert all(
        not part['dropped'] and not part['lost_in_transport']
        for part in found.values()
        if 'topic' in part
    )
    assert found['worker']['limited_windows'] == found['worker']['merged_windows'] == 0
    assert_same_graph(saved, offline)
    assert_complete(saved)
    programs.end_node()


def test_player_that_is_started_with_the_node_plays_all_of_it(start, light_bag):
    """Without any option; the node has only just been started, and does not listen yet."""
    programs = start(ROOMY)
    player = programs._start('player', player_command(light_bag))
    assert 'listening on' not in programs.text('node')
    assert player.wait(120.0) == 0, programs.text('player')
    client, count = programs.client, len(read_inputs(light_bag))

    def arrived():
        parts = client.fresh_diagnostics().values()
        return sum(part['received'] for part in parts if 'topic' in part)

    programs.wait(lambda: arrived() == count, 'all messages')
    assert 'listening on /points_left, /points_right, /imu, /fix' in programs.text('node')


@pytest.mark.parametrize('number', [signal.SIGTERM, signal.SIGINT])
def test_signal_while_messages_flow_saves_a_complete_map(start, light_bag, tmp_path, number):
    saved = tmp_path / 'maps' / 'last'
    programs = start({'save': {'on_shutdown': str(saved), 'pictures': False}})
    player = programs.play(light_bag, '--rate', 0.5)
    programs.wait(lambda: len(programs.client.odometry) >= 8, 'odometry')
    assert player.poll() is None, 'the bag ended before the signal'
    programs.end_node(number)
    assert_complete(saved)
    assert len(read_tum(saved / 'trajectory.tum')) >= 8
    assert [path.name for path in saved.parent.iterdir()] == ['last']
    heard = max(stamp_of(item.message) for item in programs.client.odometry)
    assert read_tum(saved / 'trajectory.tum').stamps[-1] >= heard


def test_looped_bag_with_clock_starts_a_new_map_after_saving_the_old(start, light_bag, tmp_path):
    last = tmp_path / 'last'
    programs = start(CLOCK, ROOMY, {'save': {'on_shutdown': str(last), 'pictures': False}})
    player = programs.play(light_bag, '--loop', '--clock')
    client = programs.client

    def begun_again():
        return any(after < before for before, after in pairwise(programs.windows()))

    programs.wait(begun_again, 'a second map')
    second = len(client.stats)
    programs.wait(lambda: len(client.stats) >= second + 3, 'windows of the second map')
    player.send_signal(signal.SIGINT)
    assert player.wait(30.0) == 130
    assert client.fresh_diagnostics()['worker']['time_jumps'] >= 1
    programs.wait(last.is_dir, 'the first map, which is written beside the second')
    assert_complete(last)
    assert_same_graph(last, map_offline(light_bag, bag_parameters(light_bag)))
    programs.end_node()
    assert_complete(tmp_path / 'last_2')


def test_looped_bag_with_clock_is_ignored_where_the_policy_says_so(start, light_bag, tmp_path):
    saved, last = tmp_path / 'saved', tmp_path / 'last'
    saving = {'save': {'folder': str(saved), 'on_shutdown': str(last), 'pictures': False}}
    programs = start(CLOCK, saving, {'time_jump': {'policy': 'ignore'}})
    player = programs.play(light_bag, '--loop', '--clock')
    client = programs.client
    programs.wait(
        lambda: client.fresh_diagnostics()['imu']['dropped'].get('time_jump', 0) > 50,
        'samples of the second round',
    )
    player.send_signal(signal.SIGINT)
    assert player.wait(30.0) == 130
    assert client.call('flush')[0] and client.call('save_map')[0]
    found = client.fresh_diagnostics()
    assert found['worker']['time_jumps'] == 0 and not last.exists()
    windows = programs.windows()
    assert windows == list(range(len(windows)))
    for sensor in ('left', 'right'):
        assert found[sensor]['dropped']['time_jump'] > 0
    assert_complete(saved)
