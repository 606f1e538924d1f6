"""``incremental_mapper play`` as a program: exit status, what it prints, Ctrl-C and the keyboard."""

import os
import pty
import signal
import subprocess
import sys
import time
from importlib.util import find_spec

import pytest
from test_bags import IMU, write_bag

from incremental_mapper.cli.main import main

COMMAND = [sys.executable, '-m', 'incremental_mapper.cli.main', 'play']
needs_ros = pytest.mark.skipif(
    find_spec('rclpy') is None, reason='rclpy is not installed (extra "ros")'
)


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


def start(*words, **streams):
    pipes = {'stdout': subprocess.PIPE, 'stderr': subprocess.PIPE, 'text': True} | streams
    return subprocess.Popen([*COMMAND, *map(str, words)], **pipes)


@needs_ros
def test_plays_and_ends(bag, listener):
    process = start(bag, '--wait', 20)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert err == ''
    assert out.startswith(f'{bag}: 11 messages; on average ')
    listener.wait_for({'/imu': 11})


@needs_ros
def test_says_that_nobody_listens(bag, domain):
    process = start(bag, '--wait', 0.1)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 0
    assert err == 'note: nothing has subscribed yet\n'


@needs_ros
@pytest.mark.parametrize(
    ('number', 'status', 'said'),
    [(signal.SIGINT, 130, 'incremental_mapper: interrupted\n'), (signal.SIGTERM, 143, '')],
)
def test_loop_until_it_is_stopped(bag, listener, number, status, said):
    process = start(bag, '--loop', '--rate', 10, '--wait', 20)
    listener.wait_for({'/imu': 40})
    process.send_signal(number)
    out, err = process.communicate(timeout=20)
    assert process.returncode == status
    assert err == said
    assert 'rounds' in out


@needs_ros
def test_ctrl_c_while_waiting(bag, domain):
    process = start(bag, '--wait', 60)
    time.sleep(3.0)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=20)
    assert process.returncode == 130
    assert 'Traceback' not in err


@needs_ros
def test_space_pauses_on_a_terminal(bag, listener):
    ours, theirs = pty.openpty()
    # A session of its own makes the terminal the program's.
    process = start(
        *(bag, '--loop', '--wait', 20),
        **dict.fromkeys(('stdin', 'stdout', 'stderr'), theirs),
        preexec_fn=lambda: (os.setsid(), os.close(os.open(os.ttyname(theirs), os.O_RDWR))),
    )
    os.close(theirs)
    seen = ''

    def read_until(word):
        nonlocal seen
        end = time.monotonic() + 30
        while word not in seen:
            assert time.monotonic() < end, seen
            seen += os.read(ours, 4096).decode()
        seen = seen.split(word, 1)[1]

    read_until('play:')
    os.write(ours, b'x ')
    read_until('paused:')
    time.sleep(0.5)
    resting = listener.counts
    time.sleep(0.5)
    assert listener.counts == resting
    os.write(ours, b' ')
    listener.wait_for({'/imu': resting['/imu'] + 20})
    os.write(ours, b'\x03')
    read_until('incremental_mapper: interrupted')
    os.close(ours)
    assert process.wait(timeout=20) == 130


@needs_ros
def test_a_background_job_does_not_touch_the_terminal(bag, domain):
    """Else the shell would stop it."""
    ours, theirs = pty.openpty()
    script = f'set -m; {" ".join(COMMAND)} {bag} --wait 0.1 & wait $!; echo status $?'
    process = subprocess.Popen(
        ['bash', '-c', script],
        **dict.fromkeys(('stdin', 'stdout', 'stderr'), theirs),
        preexec_fn=lambda: (os.setsid(), os.close(os.open(os.ttyname(theirs), os.O_RDWR))),
    )
    os.close(theirs)
    seen, end = '', time.monotonic() + 30
    while 'status' not in seen and time.monotonic() < end:
        seen += os.read(ours, 4096).decode()
    os.close(ours)
    assert process.wait(timeout=20) == 0
    assert 'status 0' in seen


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
    monkeypatch.delitem(sys.modules, 'incremental_mapper.ros.player', raising=False)
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
