"""Union-find against a graph search, and which clusters of a candidate hang loose."""

import gtsam
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from incremental_mapper.candidates.model import (
    HEAD,
    Candidate,
    Cluster,
    Connection,
    CoreKind,
    CoreMeasurement,
)
from incremental_mapper.config import Config
from incremental_mapper.frontend.dead_reckoning import State
from incremental_mapper.frontend.front_end import PreparedFix
from incremental_mapper.frontend.gnss import IDENTITY_ALIGNMENT
from incremental_mapper.frontend.imu_preintegration import EMPTY_SERIES, preintegration_parameters
from incremental_mapper.frontend.scan_preparation import PreparedScan
from incremental_mapper.graph.connectivity import UnionFind
from incremental_mapper.graph.factor_builder import WindowFactors, WindowInputs
from incremental_mapper.graph.frontier import Frontier

edges = st.lists(st.tuples(st.integers(0, 15), st.integers(0, 15)), max_size=30)


def reached(start, pairs):
    """Nodes that a search from ``start`` finds."""
    found, waiting = {start}, [start]
    while waiting:
        node = waiting.pop()
        for one, other in pairs:
            for here, there in ((one, other), (other, one)):
                if here == node and there not in found:
                    found.add(there)
                    waiting.append(there)
    return found


@given(edges)
def test_sets_are_those_of_a_graph_search(pairs):
    sets = UnionFind(range(16))
    for pair in pairs:
        sets.union(*pair)
    for node in range(16):
        same = {other for other in range(16) if sets.find(other) == sets.find(node)}
        assert same == reached(node, pairs)
    assert sets.sets == len({frozenset(reached(node, pairs)) for node in range(16)})


@given(edges)
def test_nodes_come_into_being_when_they_are_named(pairs):
    sets = UnionFind()
    for pair in pairs:
        sets.union(*pair)
    named = {node for pair in pairs for node in pair}
    assert sets.sets == len({frozenset(reached(node, pairs)) for node in named})


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
    """Loose members of a candidate with clusters ``groups`` (positions in ``items``)."""
    config = Config()
    cores = [item.core for item in items]
    clusters = tuple(
        Cluster(tuple(cores[i] for i in group), group[0], group[-1]) for group in groups
    )
    connections = tuple(Connection(start, end, 0, clusters[end].stamp, 0) for start, end in links)
    inputs = WindowInputs(
        prepared={item.core: item for item in items},
        states={},
        series=EMPTY_SERIES,
        parameters=preintegration_parameters(config.preintegration, np.eye(4)),
        frontier=frontier,
        head_state=State(0, gtsam.Pose3(), np.zeros(3), gtsam.imuBias.ConstantBias()),
        scan_offsets={},
        alignment=IDENTITY_ALIGNMENT,
        fix_inflation={},
        config=config,
    )
    loose = WindowFactors(inputs, len(items)).components(Candidate(clusters, connections))
    return [[member for cluster in part for member in cluster.members] for part in loose]


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
