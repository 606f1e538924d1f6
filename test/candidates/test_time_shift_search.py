"""The search in order of time shift yields what the enumeration yields, in order."""

from itertools import islice

from hypothesis import given, settings
from hypothesis import strategies as st
from window_cases import imu_at, windows

from incremental_mapper.candidates.enumeration import candidates, upper_bound
from incremental_mapper.candidates.model import CoreKind, CoreMeasurement
from incremental_mapper.candidates.partitions import group_elements
from incremental_mapper.candidates.time_shift_search import by_time_shift, by_vertices


@settings(deadline=None, max_examples=120)
@given(windows())
def test_search_yields_the_enumeration_once_each_in_ascending_shift(window):
    elements, head, imu = window
    searched = list(by_time_shift(elements, head, imu))
    enumerated = list(candidates(elements, head, imu))
    assert len(searched) == len(enumerated)
    assert set(searched) == set(enumerated)
    shifts = [item.time_shift for item in searched]
    assert shifts == sorted(shifts)


@settings(deadline=None, max_examples=60)
@given(windows(), st.integers(1, 20))
def test_cut_search_holds_the_least_shifted_candidates(window, wanted):
    elements, head, imu = window
    first = [item.time_shift for item in islice(by_time_shift(elements, head, imu), wanted)]
    every = sorted(item.time_shift for item in candidates(elements, head, imu))
    assert first == every[:wanted]


@settings(deadline=None, max_examples=120)
@given(windows())
def test_search_by_size_yields_the_enumeration_once_each_the_smallest_first(window):
    elements, head, imu = window
    searched = list(by_vertices(elements, head, imu))
    assert len(searched) == len(set(searched))
    assert set(searched) == set(candidates(elements, head, imu))
    sizes = [(item.vertices, item.time_shift) for item in searched]
    assert sizes == sorted(sizes)


def test_first_candidates_of_a_huge_window_come_without_enumerating_it():
    # 3^23 candidates could never be enumerated; the test hangs where the search tries to.
    count = 24
    core = [
        CoreMeasurement(7 * i, f'sensor_{i}', CoreKind.GNSS if i % 3 else CoreKind.LIDAR)
        for i in range(count)
    ]
    assert upper_bound(count, True) > 10**10
    found = list(islice(by_time_shift(group_elements(core), -3, imu_at(range(-3, 170, 4))), 50))
    shifts = [item.time_shift for item in found]
    assert len(set(found)) == 50
    assert shifts == sorted(shifts)


def test_same_window_is_searched_in_the_same_order_every_time():
    core = [CoreMeasurement(10 * i, f'sensor_{i}', CoreKind.GNSS) for i in range(5)]
    runs = [list(by_time_shift(group_elements(core), None, imu_at(range(50)))) for _ in range(2)]
    assert runs[0] == runs[1]


def test_empty_window_has_no_candidate():
    assert list(by_time_shift((), None, imu_at([1, 2]))) == []


def test_a_window_of_ninety_fixes_that_nothing_connects_is_given_up():
    """Without scans it has millions of prefixes before a thousand candidates are whole."""
    stamps = [index * 10**7 + index % 7 for index in range(90)]
    core = [CoreMeasurement(stamp, 'gnss', CoreKind.GNSS) for stamp in stamps]
    elements = group_elements(core)
    found = list(by_time_shift(elements, None, imu_at([1, 10**8]), most=2000))
    every = list(islice(by_time_shift(elements, None, imu_at([1, 10**8])), len(found) + 1))
    assert found == every[:-1]
