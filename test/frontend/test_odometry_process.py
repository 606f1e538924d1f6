"""Scans prepared in processes of their own come out as if they had been prepared here."""

import os
import pickle
import signal
import subprocess
import sys
from collections import Counter
from contextlib import closing

import numpy as np
import pytest
from scan_processes import scan_processes

from incremental_mapper.datasets.open import open_source
from incremental_mapper.errors import MeasurementError
from incremental_mapper.frontend.imu_preintegration import EMPTY_SERIES
from incremental_mapper.frontend.odometry_process import LocalStation, ProcessStation
from incremental_mapper.helper_seed import possible
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.measurements import LidarScan
from incremental_mapper.results.offline_run import map_source
from incremental_mapper.results.opened_drive import effective_config
from incremental_mapper.settings import merge

BASE = {'selection': {'strategy': 'min_time_shift'}, 'odometry': {'method': 'gicp'}}


@pytest.fixture
def opened(light_drive):
    """The drive's source and settings; ``processes`` as asked for."""

    def make(processes):
        tree = merge(BASE, {'odometry': {'processes': processes}})
        source = open_source(light_drive, tree)
        return source, effective_config(source, tree, 'test')

    return make


@pytest.fixture
def station(opened):
    _, config = opened(True)
    notes = Counter()
    with closing(ProcessStation('left', config, notes)) as made:
        yield made, config, notes


def left_scans(source, count):
    scans = (item for item in source.measurements() if isinstance(item, LidarScan))
    return [next(scan for scan in scans if scan.sensor == 'left') for _ in range(count)]


def assert_same(first, second):
    assert first.core == second.core and first.previous == second.previous
    assert np.array_equal(first.thinned, second.thinned)
    assert np.array_equal(first.sparse, second.sparse)
    if first.T_previous_current is None:
        assert second.T_previous_current is None
    else:
        assert first.T_previous_current.equals(second.T_previous_current, 1e-12)


def test_map_is_the_same_with_and_without_processes(opened):
    runs = [map_source(*opened(processes)) for processes in (False, True)]
    here, beside = (run.result for run in runs)
    assert np.array_equal(here.trajectory.stamps, beside.trajectory.stamps)
    assert np.abs(here.trajectory.positions - beside.trajectory.positions).max() < 1e-9
    assert [row['members'] for row in here.rows] == [row['members'] for row in beside.rows]
    assert here.stats['notes'] == beside.stats['notes']
    assert here.stats['dropped'] == beside.stats['dropped']


def test_scans_come_back_in_their_order_with_their_odometry(station, opened):
    made, config, _ = station
    scans = left_scans(opened(True)[0], 4)
    local = LocalStation('left', config, Counter())
    futures = [made.submit(scan) for scan in scans]
    for scan, future in zip(scans, futures, strict=True):
        assert_same(future.result(timeout=60), local.submit(scan).result())


def test_scan_that_cannot_be_used_says_why_and_the_next_one_is(station, opened):
    made, _, _ = station
    good = left_scans(opened(True)[0], 1)[0]
    far = LidarScan(good.stamp - 1, 'left', np.full((50, 3), 1e6, dtype=np.float32))
    with pytest.raises(MeasurementError, match='no point within range') as caught:
        made.submit(far).result(timeout=60)
    assert caught.value.reason == 'no_points_in_range'
    assert made.submit(good).result(timeout=60).core.stamp == good.stamp


def test_process_that_dies_is_replaced_by_this_one(station, opened):
    made, _, notes = station
    scans = left_scans(opened(True)[0], 3)
    first = made.submit(scans[0]).result(timeout=60)
    os.kill(made.pid, signal.SIGKILL)
    others = [made.submit(scan).result(timeout=60) for scan in scans[1:]]
    assert first.usable and others[1].previous == others[0].core.stamp
    assert others[0].previous is None  # the chain starts anew
    assert notes == {'left: its process ended, scans are prepared here': 1}


def test_scans_that_a_process_had_when_it_died_are_prepared_here(station, opened):
    made, _, notes = station
    scans = left_scans(opened(True)[0], 8)
    futures = [made.submit(scan) for scan in scans]
    os.kill(made.pid, signal.SIGKILL)
    found = [future.result(timeout=60) for future in futures]
    assert [item.core.stamp for item in found] == [scan.stamp for scan in scans]
    assert [item.previous for item in found].count(None) <= 2  # the first, and the first one here
    assert notes == {'left: its process ended, scans are prepared here': 1}


def test_processes_end_with_the_mapper(opened):
    source, config = opened(True)
    mapper = Mapper(config, list(source.info.counts))
    for measurement in source.measurements():
        mapper.push(measurement)
    assert len(scan_processes()) == (3 if possible() else 2)
    mapper.close()
    assert scan_processes() == []


@pytest.mark.parametrize('share', [0.0, 0.01, 0.5, 0.99])
def test_a_process_whose_mapper_was_killed_ends_quietly(opened, share):
    """Killed while it wrote: the pipe ends anywhere in a message."""
    _, config = opened(True)
    scan = LidarScan(0, 'left', np.ones((5000, 3), dtype=np.float32))
    first, second = pickle.dumps(('left', config)), pickle.dumps((scan, EMPTY_SERIES))
    done = subprocess.run(
        [sys.executable, '-m', 'incremental_mapper.frontend.odometry_process'],
        input=first + second[: round(share * len(second))],
        capture_output=True,
        timeout=60,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, b'')
