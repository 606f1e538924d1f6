"""Candidates in the order of their time shift, without enumerating all of them first.

The total time shift is a sum over clusters and connections, so the cheapest completion of a
partial candidate follows from dynamic programming; with it as the bound, a best-first search
yields complete candidates in ascending order and stops whenever the caller has enough.
"""

import heapq
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import count
from typing import TypeAlias

from incremental_mapper.candidates.clusters import HEAD, Candidate, Cluster
from incremental_mapper.candidates.enumeration import connect
from incremental_mapper.candidates.partitions import Element, make_cluster
from incremental_mapper.candidates.spans import ImuStamps

_Entry: TypeAlias = tuple[int, int, int, int, int | None, tuple[Cluster, ...], tuple[int, ...]]
"""Bound, -position, tie-breaker, position, stamp of the last node, clusters, nodes."""


def by_time_shift(
    parts: Sequence[Element], head: int | None, imu: ImuStamps
) -> Iterator[Candidate]:
    """Distinct candidates of a window in ascending order of total time shift."""
    length = len(parts)
    if length == 0:
        return

    @cache
    def cluster(first: int, last: int) -> Cluster | None:
        return make_cluster(parts, first, last)

    @cache
    def shift(start: int | None, end: int) -> int:
        if start is None:
            return 0
        sample = imu.first_sample(start, end)
        return 0 if sample is None else sample - start

    def steps(position: int, node: int | None) -> Iterator[tuple[int, Cluster, bool, int]]:
        # One more cluster: where it ends, itself, whether the chain visits it, and the cost.
        for last in range(position, length):
            merged = cluster(position, last)
            if merged is None:
                return  # a longer cluster holds the same two scans
            link = shift(node, merged.stamp)
            yield last + 1, merged, True, merged.time_range + link
            if last + 1 < length and not (position == 0 and head is None):
                yield last + 1, merged, False, merged.time_range

    @cache
    def cheapest(position: int, node: int | None) -> int:
        if position == length:
            return 0
        return min(
            cost + cheapest(after, merged.stamp if visited else node)
            for after, merged, visited, cost in steps(position, node)
        )

    order = count()
    seen: set[tuple[tuple[tuple[int, int], ...], tuple[tuple[int, int], ...]]] = set()
    start_nodes = () if head is None else (HEAD,)
    heap: list[_Entry] = [(cheapest(0, head), 0, next(order), 0, head, (), start_nodes)]
    while heap:
        bound, _, _, position, node, clusters, nodes = heapq.heappop(heap)
        if position == length:
            candidate = connect(clusters, nodes, head, imu)
            key = (
                tuple((cluster.first, cluster.last) for cluster in clusters),
                tuple((link.start, link.end) for link in candidate.connections),
            )
            if key not in seen:
                seen.add(key)
                yield candidate
            continue
        spent = bound - cheapest(position, node)
        for after, merged, visited, cost in steps(position, node):
            onward = merged.stamp if visited else node
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
                ),
            )
