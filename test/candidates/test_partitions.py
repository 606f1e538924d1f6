"""Partitions of a window: the order in which they come, the finest first."""

from itertools import pairwise

import pytest
from hypothesis import given, settings
from window_cases import imu_at, windows

from incremental_mapper.candidates.enumeration import base_candidate, candidates
from incremental_mapper.candidates.model import CoreKind, CoreMeasurement
from incremental_mapper.candidates.partitions import (
    compositions,
    group_elements,
    make_cluster,
    partitions,
)


@pytest.mark.parametrize('length', range(1, 8))
def test_runs_are_cut_finest_first_and_every_way_once(length):
    found = list(compositions(length))
    assert found[0] == tuple((i, i) for i in range(length))
    assert found[-1] == ((0, length - 1),)
    assert len(set(found)) == len(found) == 2 ** (length - 1)
    assert all(len(one) >= len(other) for one, other in pairwise(found))
    for runs in found:
        assert runs[0][0] == 0 and runs[-1][1] == length - 1
        assert all(last + 1 == first for (_, last), (first, _) in pairwise(runs))
        assert all(first <= last for first, last in runs)


@settings(deadline=None, max_examples=60)
@given(windows())
def test_first_candidate_is_that_of_the_conventional_graph(window):
    elements, head, imu = window
    first = next(candidates(elements, head, imu))
    assert first.clusters == base_candidate(elements, head, imu).clusters
    assert [cluster.members for cluster in first.clusters] == list(elements)
    counts = [len(clusters) for clusters in partitions(elements)]
    assert counts == sorted(counts, reverse=True)
    # The map is judged at the points of the first one: with all connections, as the base graph.
    dense = imu_at(range(-30, 70))
    assert next(candidates(elements, head, dense)) == base_candidate(elements, head, dense)


def test_elements_are_groups_of_one_stamp_in_time_order():
    core = [
        CoreMeasurement(stamp, sensor, CoreKind.LIDAR)
        for stamp, sensor in ((7, 'b'), (3, 'a'), (7, 'a'), (5, 'c'))
    ]
    found = group_elements(core)
    assert [[(item.stamp, item.sensor) for item in part] for part in found] == [
        [(3, 'a')],
        [(5, 'c')],
        [(7, 'a'), (7, 'b')],
    ]
    assert group_elements([]) == ()
    assert list(partitions(())) == []


def test_cluster_holds_each_lidar_once_and_any_number_of_fixes():
    core = [
        CoreMeasurement(1, 'left', CoreKind.LIDAR),
        CoreMeasurement(2, 'gps', CoreKind.GNSS),
        CoreMeasurement(3, 'gps', CoreKind.GNSS),
        CoreMeasurement(4, 'left', CoreKind.LIDAR),
    ]
    elements = group_elements(core)
    whole = make_cluster(elements, 0, 2)
    assert whole.members == tuple(core[:3])
    assert (whole.first, whole.last, whole.stamp, whole.time_range) == (0, 2, 2, 2)
    assert make_cluster(elements, 0, 3) is None
    assert make_cluster(elements, 1, 3).members == tuple(core[1:])
