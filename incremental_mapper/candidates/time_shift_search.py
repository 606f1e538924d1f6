"""Candidates in the order of their time shift or size, without enumerating all of them first.

Both are sums over clusters and connections, so the cheapest completion of a partial candidate
follows from dynamic programming; with it as the bound, a best-first search
yields complete candidates in ascending order and stops whenever the caller has enough.
"""

import heapq
import sys
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import count
from typing import TypeAlias

from incremental_mapper.candidates.enumeration import connect
from incremental_mapper.candidates.model import HEAD, Candidate, Cluster, SpanBias
from incremental_mapper.candidates.partitions import Element, make_cluster
from incremental_mapper.candidates.spans import ImuStamps

_Node: TypeAlias = tuple[int | None, bool, bool]
"""Stamp of the cluster that the chain goes on from, None before there is one, whether its velocity
and bias are counted already, and whether a bias that all spans share is."""

_VARIABLE = 10**15
"""What a variable costs where the fewest are looked for: more time shift, in nanoseconds, than a
window can have."""


class _Prefix:
    """A candidate of the first elements: the one before it and one more cluster.

    Long windows have tens of thousands of them at a time, so none repeats what it begins with.
    ``path`` and ``links`` number the clusters' bounds and the connections so far: equal numbers,
    equal prefixes. They are given to those that are looked at.
    """

    __slots__ = ('before', 'cluster', 'links', 'newest', 'path', 'size')

    def __init__(
        self, before: '_Prefix | None', cluster: Cluster | None, size: int, newest: int | None
    ) -> None:
        self.before, self.cluster = before, cluster
        self.size = size  # clusters
        self.newest = newest  # node that the chain goes on from
        self.path = self.links = 0

    def whole(self) -> tuple[tuple[Cluster, ...], list[int]]:
        """All clusters, and the nodes of the chain in time order."""
        clusters: list[Cluster] = []
        nodes: list[int] = []
        part: _Prefix | None = self
        while part is not None:
            if part.cluster is not None:
                clusters.append(part.cluster)
            if part.newest is not None and (part.before is None or part.newest == part.size - 1):
                nodes.append(part.newest)
            part = part.before
        return tuple(reversed(clusters)), nodes[::-1]


_Entry: TypeAlias = tuple[int, int, int, int, _Node, bool, _Prefix]
"""Bound, -position, tie-breaker, position, last node, whether the newest cluster is linked to it,
and the prefix."""


def by_time_shift(
    elements: Sequence[Element],
    head: int | None,
    imu: ImuStamps,
    may_merge: bool = True,
    most: int = sys.maxsize,
) -> Iterator[Candidate]:
    """Distinct candidates of a window in ascending order of total time shift, exactly.

    The shift is Σ cluster ranges + Σ over connections of (first IMU stamp − stamp of the cluster
    where the connection starts) (paper, Minimum Time Shift).

    Args:
        elements: The window's elements in time order.
        head: Stamp (ns) of the cluster of G(t-1) to connect from, None where there is none.
        imu: Which IMU samples lie between two stamps.
        may_merge: Whether measurements of different stamps may share a cluster.
        most: Prefixes of candidates after which the search gives up; in a window of ninety
            measurements there are millions before the first thousand candidates are whole.

    Yields:
        Candidates, connected or not; stop whenever there are enough.
    """
    return _by_cost(elements, head, imu, may_merge, 0, most)


def by_vertices(
    elements: Sequence[Element],
    head: int | None,
    imu: ImuStamps,
    may_merge: bool = True,
    most: int = sys.maxsize,
) -> Iterator[Candidate]:
    """Distinct candidates of a window in ascending order of vertices, then of time shift, exactly.

    Args:
        elements: The window's elements in time order.
        head: Stamp (ns) of the cluster of G(t-1) to connect from, None where there is none.
        imu: Which IMU samples lie between two stamps.
        may_merge: Whether measurements of different stamps may share a cluster.
        most: Prefixes of candidates after which the search gives up.

    Yields:
        Candidates, connected or not; stop whenever there are enough.
    """
    return _by_cost(elements, head, imu, may_merge, _VARIABLE, most)


def _by_cost(
    elements: Sequence[Element],
    head: int | None,
    imu: ImuStamps,
    may_merge: bool,
    variable: int,
    most: int,
) -> Iterator[Candidate]:
    """Candidates in ascending order of time shift plus ``variable`` for each vertex."""
    length = len(elements)
    if length == 0:
        return
    each = variable * (2 if imu.bias is SpanBias.EACH_END else 1)

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
        stamp, counted, biased = node
        for last in range(position, length):
            merged = cluster(position, last)
            if merged is None or (last > position and not may_merge):
                return  # a longer cluster holds the same two scans
            cost = merged.time_range + variable
            linked = sample(stamp, merged.stamp) is not None
            inertial = each * (1 + (not counted)) + variable * (not biased) if linked else 0
            onward = merged.stamp, linked and variable > 0, biased or (linked and variable > 0)
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
    paths: dict[tuple[int, int], int] = {}
    links: dict[tuple[int, int | None, int], int] = {}
    seen: set[tuple[int | None, int, int]] = set()
    start = head, True, imu.bias is not SpanBias.NEW  # what G(t-1) has costs nothing
    empty = _Prefix(None, None, 0, None if head is None else HEAD)
    heap: list[_Entry] = [(cheapest(0, start), 0, next(order), 0, start, False, empty)]
    made = 0
    while heap and made < most:
        bound, _, _, position, node, linked, prefix = heapq.heappop(heap)
        if prefix.before is not None:
            before = prefix.before
            prefix.path = paths.setdefault((before.path, position), len(paths) + 1)
            prefix.links = before.links
            if linked:
                link = before.links, before.newest, before.size
                prefix.links = links.setdefault(link, len(links) + 1)
        key = (useful(node[0], position), prefix.path, prefix.links)
        if key in seen:
            continue
        seen.add(key)
        if position == length:
            yield connect(*prefix.whole(), head, imu)
            continue
        spent = bound - cheapest(position, node)
        for after, merged, visited, onward, cost in steps(position, node):
            bound = spent + cost + cheapest(after, onward)
            joins = visited and sample(node[0], merged.stamp) is not None
            newest = prefix.size if visited else prefix.newest
            longer = _Prefix(prefix, merged, prefix.size + 1, newest)
            made += 1
            heapq.heappush(heap, (bound, -after, next(order), after, onward, joins, longer))
