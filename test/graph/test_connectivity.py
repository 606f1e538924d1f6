"""Which clusters of a candidate reach G(t-1)."""

from dataclasses import replace

import gtsam
import numpy as np

from incremental_mapper.candidates.model import (
    HEAD,
    Candidate,
    Cluster,
    Connection,
    CoreKind,
    CoreMeasurement,
)
from incremental_mapper.frontend.front_end import PreparedFix
from incremental_mapper.frontend.prepared_scan import PreparedScan
from incremental_mapper.graph.connectivity import Partitions
from incremental_mapper.graph.frontier import Frontier

# Components of a candidate. Stamps are plain numbers; G(t-1) has clusters 0 to 9.

LEFT, RIGHT = (CoreMeasurement(s, n, CoreKind.LIDAR) for s, n in ((100, 'left'), (137, 'right')))
FIX = CoreMeasurement(120, 'gps', CoreKind.GNSS)
LATER = CoreMeasurement(200, 'left', CoreKind.LIDAR)
GROWN = Frontier(
    chains={'left': (7, 0), 'right': (8, 37)}, head=9, head_stamp=50, newest=9, newest_stamp=50
)


def scan(core, previous):
    motion = None if previous is None else gtsam.Pose3()
    nowhere = np.zeros((1, 3))
    return PreparedScan(
        core=core,
        thinned=nowhere,
        sparse=nowhere,
        previous=previous,
        T_previous_current=motion,
    )


def components(items, groups, links=(), frontier=GROWN):
    """Unconnected members of a candidate with clusters ``groups`` (positions in ``items``)."""
    cores = [item.core for item in items]
    clusters = tuple(
        Cluster(tuple(cores[i] for i in group), group[0], group[-1]) for group in groups
    )
    connections = tuple(Connection(start, end, 0, clusters[end].stamp, 0) for start, end in links)
    partitions = Partitions({item.core: item for item in items}, frontier)
    candidate = Candidate(clusters, connections)
    unconnected = partitions.of(candidate).unconnected(candidate)
    return [[member for cluster in part for member in cluster.members] for part in unconnected]


def held(items, groups, links=()):
    cores = [item.core for item in items]
    clusters = tuple(
        Cluster(tuple(cores[i] for i in group), group[0], group[-1]) for group in groups
    )
    connections = tuple(Connection(start, end, 0, clusters[end].stamp, 0) for start, end in links)
    partitions = Partitions({item.core: item for item in items}, GROWN)
    candidate = Candidate(clusters, connections)
    assert not partitions.of(candidate).unconnected(candidate)
    return partitions.of(candidate).held(candidate)


FIRST = [scan(LEFT, None), PreparedFix(FIX, np.zeros(3), np.eye(3)), scan(RIGHT, None)]
NEXT = [scan(LEFT, 0), PreparedFix(FIX, np.zeros(3), np.eye(3)), scan(RIGHT, 37)]
ALONE = ((0,), (1,), (2,))


def test_fix_without_imu_around_it_is_loose_alone():
    assert components(NEXT, ALONE) == [[FIX]]


def test_fix_without_imu_around_it_is_connected_when_merged_with_a_scan():
    assert components(NEXT, ((0, 1), (2,))) == []
    assert components(NEXT, ((0,), (1, 2))) == []


def test_fix_is_connected_by_a_span_from_the_head_or_from_a_connected_cluster():
    assert components(NEXT, ALONE, [(HEAD, 1)]) == []
    assert components(NEXT, ALONE, [(0, 1)]) == []
    assert components(NEXT, ALONE, [(1, 2)]) == []


def test_first_window_needs_one_component_only():
    assert components(FIRST, ((0, 1, 2),), frontier=Frontier()) == []
    assert components(FIRST, ALONE, [(0, 1), (1, 2)], Frontier()) == []


def test_first_window_without_imu_leaves_every_later_cluster_loose_by_itself():
    assert components(FIRST, ALONE, frontier=Frontier()) == [[FIX], [RIGHT]]


def test_loose_clusters_that_hang_together_are_one_component():
    assert components(FIRST, ALONE, [(1, 2)], Frontier()) == [[FIX, RIGHT]]


def test_scan_whose_predecessor_is_out_of_reach_is_loose():
    forgotten = Frontier(chains={'left': (7, 0)}, head=9, head_stamp=50, newest=9, newest_stamp=50)
    assert components(NEXT, ((0, 1), (2,)), frontier=forgotten) == [[RIGHT]]


def test_odometry_inside_the_window_carries_the_connection_on():
    items = [scan(LEFT, 0), scan(LATER, LEFT.stamp)]
    assert components(items, ((0,), (1,))) == []


def test_odometry_inside_the_window_connects_nothing_to_the_graph_by_itself():
    items = [scan(LEFT, None), scan(LATER, LEFT.stamp)]
    assert components(items, ((0,), (1,))) == [[LEFT, LATER]]


def test_odometry_of_the_other_lidar_is_not_mistaken_for_ones_own():
    # The right scan names a predecessor at a stamp that only the left chain has.
    assert components([scan(RIGHT, 0)], ((0,),)) == [[RIGHT]]


FIRM, OPEN = np.diag([1e-6] * 3 + [1e-4] * 3), np.diag([1e-6] * 3 + [0.09, 1e-4, 1e-4])


def test_a_cluster_that_hangs_on_a_weak_match_alone_is_not_held():
    left = scan(LEFT, 0)
    for covariance, firm in ((None, True), (FIRM, True), (OPEN, False)):
        items = [left, replace(scan(RIGHT, 37), covariance=covariance)]
        assert held(items, ((0,), (1,))) is firm
        assert held(items, ((0, 1),))  # the firm match of the left one holds both
        assert held(items, ((0,), (1,)), [(0, 1)])
        assert held(items, ((0,), (1,)), [(HEAD, 1)])


def test_a_chain_of_firm_matches_on_a_weak_one_is_not_held_without_a_connection():
    items = [replace(scan(LEFT, 0), covariance=OPEN), replace(scan(LATER, 100), covariance=FIRM)]
    assert not held(items, ((0,), (1,)))
    assert held(items, ((0,), (1,)), [(HEAD, 1)])
