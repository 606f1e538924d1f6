"""Servers that are started ahead: handed out once each, never a dead one, and none left over."""

import pickle
from collections import Counter

import numpy as np
import pytest

from incremental_mapper.config import Config
from incremental_mapper.frontend import scan_servers
from incremental_mapper.frontend.odometry_process import LocalStation, ProcessStation
from incremental_mapper.frontend.scan_servers import let_go, scan_server, start_ahead
from incremental_mapper.measurements import make_scan


@pytest.fixture(autouse=True)
def none_left():
    yield
    let_go()


def test_those_started_ahead_are_handed_out_and_the_rest_ended():
    start_ahead(2)
    first, second = scan_servers._ahead
    taken = scan_server()
    assert taken is second
    let_go()
    assert first.poll() is not None and taken.poll() is None
    taken.kill()
    taken.communicate()


def test_a_dead_one_is_not_handed_out():
    start_ahead(1)
    (dead,) = scan_servers._ahead
    dead.kill()
    dead.wait()
    taken = scan_server()
    assert taken is not dead and taken.poll() is None
    taken.kill()
    taken.communicate()


def test_one_that_nobody_needs_ends_in_peace(capfd):
    start_ahead(1)
    (idle,) = scan_servers._ahead
    idle.communicate(timeout=60)  # closes what it reads from, as a caller that ends does
    assert idle.returncode == 0
    assert capfd.readouterr().err == ''


def test_it_prepares_scans_as_this_process_does():
    start_ahead(1)
    grid = np.stack(np.meshgrid(*[np.arange(-10.0, 10.0, 0.8)] * 2, [0.0]), axis=-1).reshape(-1, 3)
    scan = make_scan(1_000_000_000, 'left', grid)
    stations = (
        ProcessStation('left', Config(), Counter()),
        LocalStation('left', Config(), Counter()),
    )
    assert not scan_servers._ahead
    results = [pickle.dumps(station.submit(scan).result().sparse) for station in stations]
    for station in stations:
        station.close()
    assert results[0] == results[1]
