"""Servers forked from a seed: each a process of its own, and none left over."""

import os
import pickle
import signal
from collections import Counter
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from incremental_mapper import helper_seed
from incremental_mapper.config import Config
from incremental_mapper.frontend import scan_servers
from incremental_mapper.frontend.imu_preintegration import EMPTY_SERIES
from incremental_mapper.frontend.odometry_process import LocalStation, ProcessStation
from incremental_mapper.frontend.scan_servers import ahead, helper, hold, let_go, scan_server
from incremental_mapper.measurements import make_scan

pytestmark = pytest.mark.skipif(not helper_seed.possible(), reason='no handles on processes here')


@contextmanager
def held():
    hold()
    yield scan_servers._seed
    let_go()
    assert scan_servers._seed is None


@pytest.fixture
def seed():
    with held() as made:
        yield made


def a_scan():
    grid = np.stack(np.meshgrid(*[np.arange(-10.0, 10.0, 0.8)] * 2, [0.0]), axis=-1).reshape(-1, 3)
    return make_scan(1_000_000_000, 'left', grid)


def runs(pid):
    """Whether a process is there, and not only its number until somebody asks how it ended."""
    try:
        return Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0] != 'Z'
    except OSError:
        return False


def parent(pid):
    return int(Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[1])


def test_each_server_is_a_fork_of_the_seed(seed):
    servers = [scan_server(), scan_server()]
    assert len({server.pid for server in servers}) == 2
    assert [parent(server.pid) for server in servers] == [seed.pid] * 2
    for server in servers:
        assert server.poll() is None
        server.kill()
        server.wait()
        assert server.poll() is not None and not runs(server.pid)


def test_a_server_answers_and_ends_with_its_input(capfd):
    with held():
        server = scan_server()
        pickle.dump(('left', Config()), server.stdin)
        pickle.dump((a_scan(), EMPTY_SERIES), server.stdin)
        server.stdin.flush()
        result, notes = pickle.load(server.stdout)
        assert result.core.stamp == 1_000_000_000 and not notes
        assert server.communicate() == (b'', None)
    assert capfd.readouterr().err == ''


def test_the_seed_ends_with_the_last_that_held_it(seed):
    hold()
    pid = seed.pid
    server = scan_server()
    let_go()
    assert runs(pid)
    hold()
    assert scan_servers._seed is seed
    let_go()
    server.kill()
    server.wait()


def test_servers_outlive_the_seed(seed):
    server = scan_server()
    number = server.pid
    os.kill(seed.pid, signal.SIGKILL)
    seed._process.wait()
    pickle.dump(('left', Config()), server.stdin)
    pickle.dump((a_scan(), EMPTY_SERIES), server.stdin)
    server.stdin.flush()
    assert pickle.load(server.stdout)[0].core.stamp == 1_000_000_000
    assert runs(number)
    server.kill()
    server.wait()
    assert not runs(number)


def test_where_the_seed_was_killed_there_is_a_server_all_the_same(seed):
    os.kill(seed.pid, signal.SIGKILL)
    seed._process.wait()
    servers = [scan_server(), scan_server()]
    assert scan_servers._seed is not seed
    for server in servers:
        assert server.poll() is None
        server.kill()
        server.wait()


def test_a_server_that_a_killed_seed_was_to_fork_is_dead(seed):
    os.kill(seed.pid, signal.SIGSTOP)
    server = scan_server()
    os.kill(seed.pid, signal.SIGKILL)
    assert server.poll() is not None
    assert server.communicate() == (b'', None)


def test_a_helper_that_fails_says_why(capfd):
    with held():
        broken = helper('incremental_mapper.there_is_no_such_module')
        assert broken.communicate() == (b'', None)
    assert 'there_is_no_such_module' in capfd.readouterr().err


def test_without_a_seed_a_server_begins_by_itself():
    server = scan_server()
    assert server.poll() is None
    assert server.communicate() == (b'', None)


def test_it_prepares_scans_as_this_process_does():
    stations = (
        ProcessStation('left', Config(), Counter()),
        LocalStation('left', Config(), Counter()),
    )
    results = [pickle.dumps(station.submit(a_scan()).result().sparse) for station in stations]
    for station in stations:
        station.close()
    assert results[0] == results[1]
    assert scan_servers._seed is None


@pytest.mark.parametrize('cores', [1, 2])
def test_a_seed_gets_ready_ahead_where_there_is_a_core_for_it(monkeypatch, cores):
    monkeypatch.setattr(os, 'cpu_count', lambda: cores)
    with ahead():
        assert (scan_servers._seed is not None) == (cores > 1)
    assert scan_servers._seed is None
