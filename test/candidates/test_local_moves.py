"""Single decisions lead from any candidate to any other, and never out of the enumeration."""

from itertools import combinations

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st
from window_cases import imu_at, windows

from incremental_mapper.candidates.enumeration import base_candidate, candidates, connect
from incremental_mapper.candidates.local_moves import neighbours
from incremental_mapper.candidates.model import HEAD, CoreKind, CoreMeasurement
from incremental_mapper.candidates.partitions import group_elements, make_cluster
from incremental_mapper.candidates.spans import ImuStamps

# One sample: the first and the last cluster of a chain cannot be connected to any other, so that
# a connection between two others appears at once or not at all.
PARTS = tuple(
    (CoreMeasurement(stamp, 'gps' if stamp == 10 else 'left', kind),)
    for stamp, kind in (
        (0, CoreKind.LIDAR),
        (1, CoreKind.LIDAR),
        (2, CoreKind.LIDAR),
        (10, CoreKind.GNSS),
        (18, CoreKind.LIDAR),
    )
)
RARE_SAMPLES = PARTS, None, ImuStamps(np.array([9]), max_gap=8)


@settings(deadline=None, max_examples=80)
@given(windows())
@example(RARE_SAMPLES)
def test_neighbours_are_candidates_and_reach_all_of_them(window):
    elements, head, imu = window
    every = set(candidates(elements, head, imu))
    start = base_candidate(elements, head, imu)
    seen, waiting = {start}, [start]
    while waiting:
        for other in neighbours(waiting.pop(), elements, head, imu):
            assert other in every
            if other not in seen:
                seen.add(other)
                waiting.append(other)
    assert seen == every


def bounds_of(candidate):
    return tuple((cluster.first, cluster.last) for cluster in candidate.clusters)


def decisions(candidate, head):
    """Runs of elements, and the clusters that the chain visits between its two ends."""
    chain = {link.end for link in candidate.connections}
    chain |= {link.start for link in candidate.connections if link.start >= 0}
    ends = {len(candidate.clusters) - 1} | ({0} if head is None else set())
    return bounds_of(candidate), frozenset(chain - ends)


def single_decisions(candidate, head):
    """By hand: what may differ, as runs and the first elements of the clusters visited inside."""
    bounds, chain = decisions(candidate, head)
    count = len(bounds)
    inner = range(0 if head is not None else 1, count - 1)
    found = set()
    for index in inner:
        found.add((bounds, chain ^ {index}))
    for index in range(count - 1):
        joined = (*bounds[:index], (bounds[index][0], bounds[index + 1][1]), *bounds[index + 2 :])
        found.add((joined, frozenset(node - (node > index) for node in chain)))
    for index, (first, last) in enumerate(bounds):
        for cut in range(first + 1, last + 1):
            split = (*bounds[:index], (first, cut - 1), (cut, last), *bounds[index + 1 :])
            rest = {node + (node > index) for node in chain - {index}}
            for own in ((), (index,), (index + 1,), (index, index + 1)):
                found.add((split, frozenset(rest | set(own))))
    return {(bounds, inside(bounds, chain, head)) for bounds, chain in found}


def inside(bounds, chain, head):
    ends = {len(bounds) - 1} | ({0} if head is None else set())
    return frozenset(chain - ends)


def loop_free(elements, bounds):
    return all(make_cluster(elements, first, last) is not None for first, last in bounds)


@settings(deadline=None, max_examples=40)
@given(windows(), st.randoms(use_true_random=False))
def test_neighbours_differ_by_exactly_one_merge_split_or_visit(window, random):
    elements, head, _ = window
    imu = imu_at(range(-30, 70))  # every step is a connection: decisions show
    every = list(candidates(elements, head, imu))
    for candidate in random.sample(every, min(len(every), 10)):
        found = {decisions(item, head) for item in neighbours(candidate, elements, head, imu)} - {
            decisions(candidate, head)
        }
        expected = {
            item for item in single_decisions(candidate, head) if loop_free(elements, item[0])
        } - {decisions(candidate, head)}
        assert found == expected


def test_merged_cluster_is_split_at_every_place_and_in_every_way():
    core = [CoreMeasurement(stamp, 'gps', CoreKind.GNSS) for stamp in (0, 10, 20, 30)]
    elements, imu = group_elements(core), imu_at(range(-5, 40))
    every = list(candidates(elements, -5, imu))
    (whole,) = [item for item in every if len(item.clusters) == 1]
    found = set(neighbours(whole, elements, -5, imu))
    assert {bounds_of(item) for item in found} == {
        ((0, 0), (1, 3)),
        ((0, 1), (2, 3)),
        ((0, 2), (3, 3)),
    }
    # The last cluster is always visited, the one before it may be.
    assert len(found) == 6


@settings(deadline=None, max_examples=60)
@given(windows())
@example(RARE_SAMPLES)
def test_two_clusters_join_the_chain_at_once_where_neither_alone_makes_a_difference(window):
    elements, head, imu = window
    for candidate in list(candidates(elements, head, imu))[:40]:
        inner = range(0 if head is not None else 1, len(candidate.clusters) - 1)
        chain = {node for link in candidate.connections for node in (link.start, link.end)}

        def with_nodes(*more, candidate=candidate, chain=chain):
            ends = {len(candidate.clusters) - 1} | ({0} if head is None else set())
            nodes = sorted((chain - {HEAD}) | ends | set(more))
            start = [] if head is None else [HEAD]
            return connect(candidate.clusters, [*start, *nodes], head, imu)

        idle = [node for node in inner if node not in chain and with_nodes(node) == candidate]
        found = set(neighbours(candidate, elements, head, imu))
        for pair in combinations(idle, 2):
            assert with_nodes(*pair) in found
