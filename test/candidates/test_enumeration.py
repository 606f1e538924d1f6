"""Partitions, connections and candidates against a brute-force oracle written on its own."""

from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from incremental_mapper.candidates.enumeration import base_candidate, candidates, upper_bound
from incremental_mapper.candidates.model import (
    HEAD,
    Candidate,
    Cluster,
    Connection,
    CoreKind,
    CoreMeasurement,
)
from incremental_mapper.candidates.partitions import group_elements, make_cluster, partitions
from incremental_mapper.candidates.spans import ImuStamps

NO_LIMIT = 10**12
SENSORS = {
    'left': CoreKind.LIDAR,
    'right': CoreKind.LIDAR,
    'gps': CoreKind.GNSS,
    'other_gps': CoreKind.GNSS,
}


def imu_at(stamps, max_gap=NO_LIMIT):
    return ImuStamps(np.array(sorted(stamps), dtype=np.int64), max_gap)


def distinct_sensors(stamps):
    """Core measurements of so many LiDARs and receivers that any of them may be merged."""
    kinds = (CoreKind.LIDAR, CoreKind.GNSS)
    return [CoreMeasurement(stamp, f'sensor_{i}', kinds[i % 2]) for i, stamp in enumerate(stamps)]


@st.composite
def windows(draw, max_elements=8):
    """Core measurements, a head or none, sparse IMU stamps and the longest hole allowed."""
    keys = draw(
        st.sets(
            st.tuples(st.integers(0, 40), st.sampled_from(sorted(SENSORS))),
            min_size=1,
            max_size=max_elements,
        )
    )
    core = [CoreMeasurement(stamp, sensor, SENSORS[sensor]) for stamp, sensor in sorted(keys)]
    head = draw(st.none() | st.integers(-15, -1))
    imu = draw(st.sets(st.integers(-20, 45), max_size=30))
    return core, head, imu_at(imu, draw(st.sampled_from([6, 15, NO_LIMIT])))


# The oracle: bit masks over gaps and clusters, plain scans over the stamps.


def oracle_partitions(core):
    stamps = sorted({item.stamp for item in core})
    found = set()
    for cuts in product([False, True], repeat=len(stamps) - 1):
        groups = [[stamps[0]]]
        for stamp, cut in zip(stamps[1:], cuts, strict=True):
            if cut:
                groups.append([])
            groups[-1].append(stamp)
        members = [tuple(sorted(item for item in core if item.stamp in group)) for group in groups]
        if not any(meets_twice(group) for group in members):
            found.add(tuple(members))
    return found


def meets_twice(members):
    lidars = [item.sensor for item in members if item.kind is CoreKind.LIDAR]
    return any(lidars.count(sensor) > 1 for sensor in lidars)


def oracle_median(members):
    return sorted(item.stamp for item in members)[len(members) // 2]


def oracle_first(start, end, imu):
    inside = [int(stamp) for stamp in imu.stamps if start <= stamp < end]
    if not inside:
        return None
    marks = [start, *inside, end]
    holes = [after - before for before, after in pairwise(marks)]
    return inside[0] if max(holes) <= imu.max_gap else None


def oracle_candidates(core, head, imu):
    found = set()
    for members in oracle_partitions(core):
        stamps = [oracle_median(group) for group in members]
        last = len(stamps) - 1
        free = range(last) if head is not None else range(1, last)
        for visits in product([False, True], repeat=len(free)):
            path = [i for i, visit in zip(free, visits, strict=True) if visit]
            path = sorted({*path, last} | ({0} if head is None else set()))
            nodes = path if head is None else [HEAD, *path]
            links = []
            for start, end in pairwise(nodes):
                begin = head if start == HEAD else stamps[start]
                first = oracle_first(begin, stamps[end], imu)
                if first is not None:
                    links.append((start, end, begin, stamps[end], first))
            found.add((members, tuple(links)))
    return found


def described(candidate):
    links = tuple(
        (link.start, link.end, link.start_stamp, link.end_stamp, link.first_sample)
        for link in candidate.connections
    )
    return tuple(cluster.members for cluster in candidate.clusters), links


@pytest.mark.parametrize('count', range(1, 9))
def test_distinct_sensors_make_two_to_the_n_minus_one_partitions(count):
    elements = group_elements(distinct_sensors(range(0, 10 * count, 10)))
    found = [tuple(c.members for c in clusters) for clusters in partitions(elements)]
    assert len(found) == len(set(found)) == 2 ** (count - 1)


@pytest.mark.parametrize('count', range(1, 9))
@pytest.mark.parametrize('head', [None, -10])
def test_dense_imu_makes_every_candidate_of_the_bound(count, head):
    core = distinct_sensors(range(0, 10 * count, 10))
    found = list(candidates(group_elements(core), head, imu_at(range(-10, 10 * count))))
    expected = -(-(3 ** (count - 1)) // 2) if head is None else 3 ** (count - 1)
    assert len(found) == len({described(item) for item in found}) == expected
    assert upper_bound(count, head is not None) == expected


def test_no_measurement_makes_no_candidate():
    assert upper_bound(0, True) == upper_bound(0, False) == 0
    assert list(candidates((), 0, imu_at([1]))) == []


@settings(deadline=None, max_examples=120)
@given(windows())
def test_partitions_are_those_of_the_oracle(window):
    core, _, _ = window
    found = [tuple(c.members for c in clusters) for clusters in partitions(group_elements(core))]
    assert len(found) == len(set(found))
    assert set(found) == oracle_partitions(core)


@settings(deadline=None, max_examples=80)
@given(windows(max_elements=7))
def test_candidates_are_those_of_the_oracle_each_once(window):
    core, head, imu = window
    found = [described(item) for item in candidates(group_elements(core), head, imu)]
    assert len(found) == len(set(found))
    assert set(found) == oracle_candidates(core, head, imu)


@settings(deadline=None, max_examples=30)
@given(windows(max_elements=6))
def test_spans_neither_overlap_nor_share_a_sample(window):
    core, head, imu = window
    for candidate in candidates(group_elements(core), head, imu):
        spans = [(link.start_stamp, link.end_stamp) for link in candidate.connections]
        for (_, end), (start, _) in pairwise(spans):
            assert end <= start
        for stamp in imu.stamps:
            assert sum(start <= stamp < end for start, end in spans) <= 1
        for link in candidate.connections:
            assert link.start < link.end
            assert link.start_stamp <= link.first_sample < link.end_stamp


@settings(deadline=None, max_examples=30)
@given(windows(max_elements=6))
def test_every_measurement_is_in_exactly_one_cluster_and_no_lidar_twice(window):
    core, head, imu = window
    for candidate in candidates(group_elements(core), head, imu):
        members = [item for cluster in candidate.clusters for item in cluster.members]
        assert members == sorted(core)
        assert not any(meets_twice(cluster.members) for cluster in candidate.clusters)


@settings(deadline=None, max_examples=30)
@given(windows(max_elements=6))
def test_time_shift_is_ranges_plus_waits_for_the_first_sample(window):
    core, head, imu = window
    for candidate in candidates(group_elements(core), head, imu):
        ranges = sum(
            max(item.stamp for item in cluster.members)
            - min(item.stamp for item in cluster.members)
            for cluster in candidate.clusters
        )
        waits = 0
        for link in candidate.connections:
            start = head if link.start == HEAD else candidate.clusters[link.start].stamp
            end = candidate.clusters[link.end].stamp
            waits += min(int(s) for s in imu.stamps if start <= s < end) - start
        assert candidate.time_shift == ranges + waits


@settings(deadline=None, max_examples=30)
@given(windows(max_elements=6))
def test_clusters_at_the_ends_of_connections_have_velocity_and_bias(window):
    core, head, imu = window
    for candidate in candidates(group_elements(core), head, imu):
        touched = {i for link in candidate.connections for i in (link.start, link.end)}
        assert candidate.inertial_clusters == touched
        inside = [i for i in touched if i != HEAD]
        assert candidate.vertices == len(candidate.clusters) + 2 * len(inside)


@given(st.lists(st.integers(0, 1000), min_size=1, max_size=8, unique=True))
def test_cluster_stamp_is_the_median_member(stamps):
    core = distinct_sensors(stamps)
    elements = group_elements(core)
    cluster = make_cluster(elements, 0, len(elements) - 1)
    assert cluster.stamp == sorted(stamps)[len(stamps) // 2]
    assert cluster.time_range == max(stamps) - min(stamps)


def test_measurements_of_one_stamp_are_never_split():
    core = [
        CoreMeasurement(5, 'right', CoreKind.LIDAR),
        CoreMeasurement(5, 'left', CoreKind.LIDAR),
        CoreMeasurement(9, 'gps', CoreKind.GNSS),
    ]
    elements = group_elements(core)
    assert [len(part) for part in elements] == [2, 1]
    assert len(list(partitions(elements))) == 2


def test_two_scans_of_one_lidar_never_share_a_cluster_even_with_others_between():
    core = [
        CoreMeasurement(0, 'left', CoreKind.LIDAR),
        CoreMeasurement(1, 'gps', CoreKind.GNSS),
        CoreMeasurement(2, 'left', CoreKind.LIDAR),
    ]
    sizes = {
        tuple(len(c.members) for c in clusters) for clusters in partitions(group_elements(core))
    }
    assert sizes == {(1, 1, 1), (2, 1), (1, 2)}


def test_two_fixes_of_one_receiver_may_share_a_cluster():
    core = [CoreMeasurement(0, 'gps', CoreKind.GNSS), CoreMeasurement(1, 'gps', CoreKind.GNSS)]
    assert len(list(partitions(group_elements(core)))) == 2


def test_candidates_without_imu_are_the_partitions_once_each():
    core = distinct_sensors(range(0, 50, 10))
    found = list(candidates(group_elements(core), -10, imu_at([])))
    assert len(found) == 2**4
    assert all(item.connections == () for item in found)


def test_step_without_sample_makes_no_connection():
    # One sample between the second and the third cluster only.
    elements = group_elements(distinct_sensors([0, 10, 20]))
    finest = base_candidate(elements, None, imu_at([15]))
    assert finest.connections == (Connection(1, 2, 10, 20, 15),)


def test_sample_at_the_start_is_inside_and_at_the_end_is_not():
    imu = imu_at([10, 20])
    assert imu.first_sample(10, 20) == 10
    assert imu.first_sample(11, 20) is None
    assert imu.bounds(10, 20) == (0, 1)


@pytest.mark.parametrize(
    ('stamps', 'usable'),
    [([5, 10, 15], True), ([7, 12], False), ([5, 11, 15], False), ([5, 10, 14], False)],
)
def test_hole_longer_than_max_gap_anywhere_in_the_span_makes_no_connection(stamps, usable):
    assert (imu_at(stamps, 5).first_sample(0, 20) is not None) is usable


def test_base_candidate_keeps_every_element_and_connects_neighbours_from_the_head_on():
    elements = group_elements(distinct_sensors([0, 10, 20]))
    base = base_candidate(elements, -10, imu_at([-5, 5, 15]))
    assert [cluster.members for cluster in base.clusters] == list(elements)
    assert [(link.start, link.end) for link in base.connections] == [(HEAD, 0), (0, 1), (1, 2)]
    assert base.time_shift == 3 * 5


def test_head_adds_no_vertices_of_its_own():
    core = CoreMeasurement(10, 'left', CoreKind.LIDAR)
    candidate = Candidate((Cluster((core,)),), (Connection(HEAD, 0, 0, 10, 5),))
    assert candidate.vertices == 3
