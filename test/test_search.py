"""The search in order of time shift yields what the enumeration yields, in order."""

from itertools import islice

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from incremental_mapper.candidates.enumeration import candidates, upper_bound
from incremental_mapper.candidates.model import CoreKind, CoreMeasurement
from incremental_mapper.candidates.partitions import elements
from incremental_mapper.candidates.spans import ImuStamps
from incremental_mapper.candidates.time_shift_search import by_time_shift

SENSORS = {'left': CoreKind.LIDAR, 'right': CoreKind.LIDAR, 'gps': CoreKind.GNSS}


def imu_at(stamps, max_gap=10**12):
    return ImuStamps(np.array(sorted(stamps), dtype=np.int64), max_gap)


@st.composite
def windows(draw):
    """Up to six core measurements, a head or none, and few to many IMU samples."""
    keys = draw(
        st.sets(
            st.tuples(st.integers(0, 60), st.sampled_from(sorted(SENSORS))), min_size=1, max_size=6
        )
    )
    core = [CoreMeasurement(stamp, sensor, SENSORS[sensor]) for stamp, sensor in sorted(keys)]
    head = draw(st.none() | st.integers(-20, -1))
    imu = draw(st.sets(st.integers(-25, 65), max_size=40))
    return elements(core), head, imu_at(imu, draw(st.sampled_from([8, 10**12])))


@settings(deadline=None, max_examples=120)
@given(windows())
def test_search_yields_the_enumeration_once_each_in_ascending_shift(window):
    parts, head, imu = window
    searched = list(by_time_shift(parts, head, imu))
    enumerated = list(candidates(parts, head, imu))
    assert len(searched) == len(enumerated)
    assert set(searched) == set(enumerated)
    shifts = [item.time_shift for item in searched]
    assert shifts == sorted(shifts)


@settings(deadline=None, max_examples=60)
@given(windows(), st.integers(1, 20))
def test_cut_search_holds_the_least_shifted_candidates(window, wanted):
    parts, head, imu = window
    first = [item.time_shift for item in islice(by_time_shift(parts, head, imu), wanted)]
    every = sorted(item.time_shift for item in candidates(parts, head, imu))
    assert first == every[:wanted]


def test_first_candidates_of_a_huge_window_come_without_enumerating_it():
    # 3^23 candidates could never be enumerated; the test hangs where the search tries to.
    count = 24
    core = [
        CoreMeasurement(7 * i, f'sensor_{i}', CoreKind.GNSS if i % 3 else CoreKind.LIDAR)
        for i in range(count)
    ]
    assert upper_bound(count, True) > 10**10
    found = list(islice(by_time_shift(elements(core), -3, imu_at(range(-3, 170, 4))), 50))
    shifts = [item.time_shift for item in found]
    assert len(set(found)) == 50
    assert shifts == sorted(shifts)


def test_same_window_is_searched_in_the_same_order_every_time():
    core = [CoreMeasurement(10 * i, f'sensor_{i}', CoreKind.GNSS) for i in range(5)]
    runs = [list(by_time_shift(elements(core), None, imu_at(range(50)))) for _ in range(2)]
    assert runs[0] == runs[1]


def test_empty_window_has_no_candidate():
    assert list(by_time_shift((), None, imu_at([1, 2]))) == []
