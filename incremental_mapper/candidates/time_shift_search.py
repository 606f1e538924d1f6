"""Candidates in the order of their time shift or size, without enumerating all of them first.

Both are sums over clusters and connections, so the cheapest completion of a partial candidate
follows from dynamic programming; with it as the bound, a best-first search
yields complete candidates in ascending order and stops whenever the caller has enough.
"""

import heapq
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import count
from typing import TypeAlias

from incremental_mapper.candidates.enumeration import connect
from incremental_mapper.candidates.model import HEAD, Candidate, Cluster
from incremental_mapper.candidates.partitions import Element, make_cluster
from incremental_mapper.candidates.spans import ImuStamps

_Links: TypeAlias = tuple[tuple[int, int], ...]
_Node: TypeAlias = tuple[int | None, bool]
"""Stamp of the cluster that the chain goes on from, None before there is one, and whether its
velocity and bias are counted already."""
_Entry: TypeAlias = tuple[int, int, int, int, _Node, tuple[Cluster, ...], tuple[int, ...], _Links]
"""Bound, -position, tie-breaker, position, last node, clusters, nodes, links."""

_VARIABLE = 10**15
"""What a variable costs where the fewest are looked for: more time shift, in nanoseconds, than a
window can have."""


def by_time_shift(
    elements: Sequence[Element], head: int | None, imu: ImuStamps, may_merge: bool = True
) -> Iterator[Candidate]:
    """Distinct candidates of a window in ascending order of total time shift, exactly.

    The shift is Σ cluster ranges + Σ over connections of (first IMU stamp − stamp of the cluster
    where the connection starts) (paper, Minimum Time Shift).

    Args:
        elements: The window's elements in time order.
        head: Stamp (ns) of the cluster of G(t-1) to connect from, None where there is none.
        imu: Which IMU samples lie between two stamps.
        may_merge: Whether measurements of different stamps may share a cluster.

    Yields:
        Candidates, connected or not; stop whenever there are enough.
    """
    return _by_cost(elements, head, imu, may_merge, 0)


def by_vertices(
    elements: Sequence[Element], head: int | None, imu: ImuStamps, may_merge: bool = True
) -> Iterator[Candidate]:
    """Distinct candidates of a window in ascending order of vertices, then of time shift, exactly.

    Args:
        elements: The window's elements in time order.
        head: Stamp (ns) of the cluster of G(t-1) to connect from, None where there is none.
        imu: Which IMU samples lie between two stamps.
        may_merge: Whether measurements of different stamps may share a cluster.

    Yields:
        Candidates, connected or not; stop whenever there are enough.
    """
    return _by_cost(elements, head, imu, may_merge, _VARIABLE)


def _by_cost(
    elements: Sequence[Element], head: int | None, imu: ImuStamps, may_merge: bool, variable: int
) -> Iterator[Candidate]:
    """Candidates in ascending order of time shift plus ``variable`` for each vertex."""
    length = len(elements)
    if length == 0:
        return

    @cache
    def cluster(first: int, last: int) -> Cluster | None:
        return make_cluster(elements, first, last)

    @cache
    def sample(start: int | None, end: int) -> int | None:
        return None if start is None else imu.first_sample(start, end)

    def shift(start: int | None, end: int) -> int:
        first = sample(start, end)
        return 0 if start is None or first is None else first - start

    @cache
    def useful(node: int | None, position: int) -> int | None:
        # A node that nothing later can be connected to is as good as none.
        later = (elements[index][0].stamp for index in range(position, length))
        return node if any(sample(node, stamp) is not None for stamp in later) else None

    def steps(position: int, node: _Node) -> Iterator[tuple[int, Cluster, bool, _Node, int]]:
        # One more cluster: where it ends, itself, whether the chain visits it, the node that
        # follows, and the cost.
        stamp, counted = node
        for last in range(position, length):
            merged = cluster(position, last)
            if merged is None or (last > position and not may_merge):
                return  # a longer cluster holds the same two scans
            cost = merged.time_range + variable
            linked = sample(stamp, merged.stamp) is not None
            inertial = variable * (2 + 2 * (not counted)) if linked else 0
            onward = merged.stamp, linked and variable > 0
            yield last + 1, merged, True, onward, cost + shift(stamp, merged.stamp) + inertial
            if last + 1 < length and not (position == 0 and head is None):
                yield last + 1, merged, False, node, cost

    @cache
    def cheapest(position: int, node: _Node) -> int:
        if position == length:
            return 0
        return min(
            cost + cheapest(after, onward) for after, _, _, onward, cost in steps(position, node)
        )

    order = count()
    # Where IMU samples are missing, many chains of nodes make the same connections: each is
    # followed once, else their number would grow without bound.
    seen: set[tuple[int | None, tuple[tuple[int, int], ...], _Links]] = set()
    start_nodes = () if head is None else (HEAD,)
    start = head, True  # what G(t-1) has costs nothing
    heap: list[_Entry] = [(cheapest(0, start), 0, next(order), 0, start, (), start_nodes, ())]
    while heap:
        bound, _, _, position, node, clusters, nodes, links = heapq.heappop(heap)
        bounds = tuple((cluster.first, cluster.last) for cluster in clusters)
        key = (useful(node[0], position), bounds, links)
        if key in seen:
            continue
        seen.add(key)
        if position == length:
            yield connect(clusters, nodes, head, imu)
            continue
        spent = bound - cheapest(position, node)
        for after, merged, visited, onward, cost in steps(position, node):
            linked = visited and sample(node[0], merged.stamp) is not None
            heapq.heappush(
                heap,
                (
                    spent + cost + cheapest(after, onward),
                    -after,
                    next(order),
                    after,
                    onward,
                    (*clusters, merged),
                    (*nodes, len(clusters)) if visited else nodes,
                    (*links, (nodes[-1], len(clusters))) if linked else links,
                ),
            )
