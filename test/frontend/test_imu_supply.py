"""Which samples of the IMU a scan gets, and how long it waits for them: by stamps alone."""

import numpy as np

from incremental_mapper.frontend.imu_supply import ImuSupply, sweep_end
from incremental_mapper.measurements import LidarScan, make_imu

MS = 1_000_000
START = 1_700_000_000_000_000_000


def sample(ms):
    return make_imu(START + ms * MS, 'imu', np.zeros(3), np.array([0.0, 0.0, 9.81]))


def filled(stamps, expected=True):
    supply = ImuSupply(expected, patience=0.5)
    for ms in stamps:
        supply.add(sample(ms))
        supply.passed(START + ms * MS)
    return supply


def given(series):
    return ((series.stamps - START) // MS).tolist()


def test_each_lidar_gets_every_sample_once_up_to_the_first_behind_the_sweep():
    supply = filled(range(0, 300, 10))
    assert given(supply.take('left', START + 45 * MS)) == [0, 10, 20, 30, 40, 50]
    assert given(supply.take('right', START + 20 * MS)) == [0, 10, 20]
    assert given(supply.take('left', START + 70 * MS)) == [60, 70]
    assert given(supply.take('left', START + 70 * MS)) == []


def test_samples_that_came_in_another_order_are_given_by_their_stamps():
    shuffled = np.random.default_rng(0).permutation(range(0, 300, 10)).tolist()
    found = filled(shuffled).take('left', START + 100 * MS)
    assert given(found) == given(filled(range(0, 300, 10)).take('left', START + 100 * MS))


def test_scan_waits_until_a_sample_has_passed_the_end_of_its_sweep():
    supply = filled([0, 10, 20])
    assert supply.complete(START + 20 * MS)
    assert not supply.complete(START + 21 * MS)
    supply.add(sample(30))
    assert supply.complete(START + 21 * MS)


def test_imu_that_fell_silent_or_never_came_is_not_waited_for():
    supply = filled([0, 10, 20])
    supply.passed(START + 500 * MS)
    assert not supply.complete(START + 400 * MS)
    supply.passed(START + 600 * MS)
    assert supply.complete(START + 400 * MS)
    silent = ImuSupply(True, patience=0.5)
    silent.passed(START)
    assert not silent.complete(START)
    silent.passed(START + 501 * MS)
    assert silent.complete(START)


def test_without_an_imu_nothing_waits():
    supply = ImuSupply(False, patience=0.5)
    supply.passed(START)
    assert supply.complete(START + 100 * MS)


def test_old_samples_are_forgotten():
    supply = filled(range(0, 20_000, 10))
    assert given(supply.take('left', START + 19_990 * MS))[0] >= 14_000


def test_sweep_ends_with_its_last_point_or_its_stamp():
    points = np.ones((3, 3), dtype=np.float32)
    for times, ms in (((0.0, 0.05, 0.1), 100), ((-0.1, -0.05, -0.01), 0), (None, 0)):
        times = None if times is None else np.array(times, dtype=np.float32)
        assert abs(sweep_end(LidarScan(START, 'left', points, times)) - START - ms * MS) < 100
