"""Clusters, connections and candidates: their stamps, shifts and counts."""

import pytest

from incremental_mapper.candidates.model import (
    HEAD,
    Candidate,
    Cluster,
    Connection,
    CoreKind,
    CoreMeasurement,
)


def cluster(*stamps, first=0):
    members = tuple(CoreMeasurement(stamp, f'l{stamp}', CoreKind.LIDAR) for stamp in stamps)
    return Cluster(members, first, first)


@pytest.mark.parametrize(
    ('stamps', 'median', 'length'),
    [((5,), 5, 0), ((5, 8), 8, 3), ((5, 8, 20), 8, 15), ((5, 8, 20, 21), 20, 16)],
)
def test_stamp_is_the_median_member_and_range_the_whole_cluster(stamps, median, length):
    assert cluster(*stamps).stamp == median
    assert cluster(*stamps).time_range == length


def test_candidate_adds_up_what_its_clusters_and_connections_shift():
    clusters = cluster(10, 14), cluster(20), cluster(30, 37)
    links = Connection(HEAD, 0, 2, 14, 5), Connection(0, 2, 14, 37, 15)
    candidate = Candidate(clusters, links)
    assert [link.shift for link in links] == [3, 1]
    assert candidate.time_shift == 4 + 0 + 7 + 3 + 1
    assert candidate.inertial_clusters == {HEAD, 0, 2}
    # Three poses, and velocity and bias of two clusters: that of the head is there already.
    assert candidate.vertices == 3 + 2 * 2
    assert candidate.merges
    alone = Candidate(clusters[1:2], ())
    assert (alone.time_shift, alone.vertices, alone.merges) == (0, 1, False)
    assert alone.inertial_clusters == frozenset()


def test_two_sensors_of_one_stamp_are_not_merged():
    members = tuple(CoreMeasurement(4, name, CoreKind.LIDAR) for name in ('a', 'b'))
    candidate = Candidate((Cluster(members),), ())
    assert not candidate.merges and candidate.time_shift == 0


def of(*sensors, at=0):
    members = [
        CoreMeasurement(at, name, CoreKind.GNSS if name == 'gps' else CoreKind.LIDAR)
        for name in sensors
    ]
    return Cluster(tuple(members))


@pytest.mark.parametrize(
    ('clusters', 'ends', 'linked'),
    [
        ((of('left'), of('right')), (0, 1), True),
        ((of('left'), of('right')), (1,), False),
        ((of('left'), of('right'), of('left')), (1, 2), True),
        ((of('left', 'right'), of('left')), (0,), True),
        ((of('left', 'right'), of('left')), (1,), False),
        ((of('gps'), of('left')), (1,), True),
        ((of('gps'), of('left')), (0,), False),
        ((of('gps'),), (), True),
    ],
)
def test_linked_are_those_whose_lidars_all_have_an_end_of_a_span(clusters, ends, linked):
    starts = (HEAD, *ends[:-1])
    spans = [Connection(*pair, 0, 1, 0) for pair in zip(starts, ends, strict=False)]
    assert Candidate(clusters, tuple(spans)).linked is linked
