"""``incremental_mapper play`` as a program: exit status, what it prints, Ctrl-C, the keyboard."""

import os
import pty
import select
import signal
import sqlite3
import subprocess
import sys
import termios
import time
from importlib.util import find_spec

import pytest
from bag_files import IMU, write_bag, write_ros1
from rosbags.rosbag2 import StoragePlugin

from incremental_mapper.cli.main import main

COMMAND = [sys.executable, '-m', 'incremental_mapper.cli.main', 'play']
needs_ros = pytest.mark.skipif(
    find_spec('rclpy') is None, reason='rclpy is not installed (extra "ros")'
)


def without_waiting(err):
    """What a program says but for whom it waits, which depends on how busy the machine is."""
    return ''.join(line for line in err.splitlines(True) if not line.startswith('waits '))


@pytest.fixture
def domain(monkeypatch):
    from player_listener import own_domain

    own_domain(monkeypatch)


@pytest.fixture
def listener(domain):
    from player_listener import Listener
    from sensor_msgs.msg import Imu

    with Listener({'/imu': Imu}) as made:
        yield made


@pytest.fixture
def bag(tmp_path):
    """A tenth of a second of 100 Hz."""
    return write_bag(tmp_path / 'bag', topics=[('/imu', IMU, 0, 10, 11)])


@pytest.fixture
def start():
    """Start the program; what still runs after the test is killed."""
    started = []

    def run(*words):
        started.append(
            subprocess.Popen(
                [*COMMAND, *map(str, words)],
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
        )
        return started[-1]

    yield run
    for process in started:
        process.kill()
        process.communicate()


class Terminal:
    """A program that runs on a terminal of its own."""

    def __init__(self, *command):
        self.seen = ''
        self._pid, self._file = pty.fork()
        if self._pid == 0:
            os.execv(command[0], command)
        termios.tcsetwinsize(self._file, (24, 100))

    def read_until(self, word):
        """Read what the program prints until ``word`` has come; forgets all up to it."""
        end = time.monotonic() + 60
        while word not in self.seen:
            assert time.monotonic() < end, self.seen
            if select.select([self._file], [], [], 0.1)[0]:
                self.seen += os.read(self._file, 4096).decode()
        self.seen = self.seen.split(word, 1)[1]

    def press(self, keys):
        os.write(self._file, keys)

    def status(self):
        """Wait for the end; returns the exit status."""
        _, status = os.waitpid(self._pid, 0)
        self._pid = 0
        return os.waitstatus_to_exitcode(status)

    def __enter__(self):
        return self

    def __exit__(self, *error):
        if self._pid:
            os.kill(self._pid, signal.SIGKILL)
            self.status()
        os.close(self._file)


@needs_ros
def test_plays_and_ends(start, bag, listener):
    process = start(bag, '--wait', 20)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert without_waiting(err) == ''
    assert out.startswith(f'{bag}: 11 messages; on average ')
    listener.wait_for({'/imu': 11})


@needs_ros
def test_says_that_nobody_listens(start, bag, domain):
    process = start(bag, '--wait', 0.1)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 0
    assert err == 'note: nothing has subscribed yet\n'


@needs_ros
def test_lost_messages_are_a_failure(start, tmp_path):
    path = write_bag(tmp_path / 'lossy', plugin=StoragePlugin.SQLITE3)
    with sqlite3.connect(next(path.glob('*.db3'))) as database:
        database.execute('DELETE FROM messages WHERE id % 10 = 0')
    process = start(path, '--wait', 0.1)
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 1
    assert '5 more announced but missing' in out


@needs_ros
@pytest.mark.parametrize(
    ('number', 'status', 'said'),
    [(signal.SIGINT, 130, 'incremental_mapper: interrupted\n'), (signal.SIGTERM, 143, '')],
)
def test_loop_until_it_is_stopped(start, bag, listener, number, status, said):
    process = start(bag, '--loop', '--rate', 10, '--wait', 20)
    listener.wait_for({'/imu': 40})
    process.send_signal(number)
    out, err = process.communicate(timeout=20)
    assert process.returncode == status
    assert without_waiting(err) == said
    assert 'rounds' in out


@needs_ros
def test_ctrl_c_while_waiting(start, tmp_path, domain):
    path = write_ros1(tmp_path / 'old.bag', [('/1', IMU, 0, 10, 2), ('/imu', IMU, 0, 10, 2)])
    process = start(path, '--wait', 60)
    assert process.stderr.readline() == 'note: /1: is no valid name in ROS 2\n'
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=20)
    assert process.returncode == 130
    assert without_waiting(err) == 'incremental_mapper: interrupted\n'


@needs_ros
def test_space_pauses_on_a_terminal(bag, listener):
    with Terminal(*COMMAND, str(bag), '--loop', '--wait', '20') as terminal:
        terminal.read_until('play:')
        terminal.press(b'x ')
        terminal.read_until('paused:')
        resting = listener.wait_for_rest()
        terminal.press(b' ')
        listener.wait_for({'/imu': resting['/imu'] + 20})
        terminal.press(b'\x03')
        terminal.read_until('incremental_mapper: interrupted')
        assert terminal.status() == 130


@needs_ros
def test_a_background_job_leaves_the_terminal_alone(bag, domain):
    """Else the shell would stop it."""
    job = ' '.join([*COMMAND, str(bag), '--wait', '0.1'])
    with Terminal('/bin/bash', '-c', f'set -m; {job} & wait $!; echo status $?') as terminal:
        terminal.read_until('11 messages')
        terminal.read_until('status 0')
        assert terminal.status() == 0


@needs_ros
@pytest.mark.parametrize(
    ('words', 'said'),
    [
        (['none'], 'none: does not exist'),
        (['bag', '--topics', '/odd'], 'has no topic odd'),
        (['bag', '--start', '5'], 'has no message to play'),
    ],
)
def test_refused_in_one_line(bag, domain, capsys, monkeypatch, words, said):
    monkeypatch.chdir(bag.parent)
    assert main(['play', *words]) == 1
    err = capsys.readouterr().err
    assert err.startswith('incremental_mapper: ') and err.count('\n') == 1
    assert said in err


@needs_ros
def test_ros_that_does_not_start(bag, domain, capsys, monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', 'many')
    assert main(['play', str(bag)]) == 1
    err = capsys.readouterr().err
    assert 'ROS cannot be started' in err and err.count('\n') == 1


def test_without_rclpy(bag, capsys, monkeypatch):
    for name in [name for name in sys.modules if name.split('.')[0] == 'rclpy']:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.delitem(sys.modules, 'incremental_mapper.ros.player.playback', raising=False)
    monkeypatch.setitem(sys.modules, 'rclpy', None)
    assert main(['play', str(bag)]) == 1
    err = capsys.readouterr().err
    assert 'pip install "incremental_mapper[ros]"' in err and err.count('\n') == 1


@pytest.mark.parametrize(
    'words',
    [
        ['--rate', '0'],
        ['--rate', 'nan'],
        ['--rate', 'fast'],
        ['--start', '-1'],
        ['--duration', '0'],
        ['--wait', 'inf'],
        ['--topics'],
    ],
)
def test_wrong_usage(words, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(['play', 'bag', *words])
    assert stopped.value.code == 2
    assert 'usage: incremental_mapper play' in capsys.readouterr().err
