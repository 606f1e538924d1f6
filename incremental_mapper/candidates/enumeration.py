"""All candidates of a window (paper, Algorithm 1, steps 3 and 4, and its appendix)."""

from collections.abc import Iterator, Sequence
from itertools import combinations, pairwise

from incremental_mapper.candidates.model import HEAD, Candidate, Cluster, Connection
from incremental_mapper.candidates.partitions import Element, partitions
from incremental_mapper.candidates.spans import ImuStamps


def upper_bound(count: int, has_head: bool) -> int:
    """Most candidates that a window can have (paper, appendix).

    Args:
        count: Number of elements N.
        has_head: Whether G(t-1) has a cluster to connect from.

    Returns:
        3^(N-1) with such a cluster, else ceil(3^(N-1) / 2); 0 without elements.
    """
    if count == 0:
        return 0
    power = int(3 ** (count - 1))
    return power if has_head else (power + 1) // 2


def connect(
    clusters: tuple[Cluster, ...], nodes: Sequence[int], head: int | None, imu: ImuStamps
) -> Candidate:
    """Connect the clusters at ``nodes`` (ascending, HEAD for G(t-1)) one after the other.

    A step without a usable IMU span makes no connection.
    """
    connections: list[Connection] = []
    for start, end in pairwise(nodes):
        start_stamp = head if start == HEAD else clusters[start].stamp
        assert start_stamp is not None
        end_stamp = clusters[end].stamp
        first = imu.first_sample(start_stamp, end_stamp)
        if first is not None:
            connections.append(Connection(start, end, start_stamp, end_stamp, first))
    return Candidate(clusters, tuple(connections), imu.bias)


def chains(count: int, has_head: bool) -> Iterator[tuple[int, ...]]:
    """All ways of stepping through ``count`` clusters from the first (or HEAD) to the last."""
    first, rest = (HEAD, range(count - 1)) if has_head else (0, range(1, count - 1))
    if not has_head and count == 1:
        yield (0,)
        return
    for skipped in range(len(rest) + 1):
        for inner in combinations(rest, len(rest) - skipped):
            yield (first, *inner, count - 1)


def candidates(
    elements: Sequence[Element], head: int | None, imu: ImuStamps
) -> Iterator[Candidate]:
    """Every distinct candidate of a window (paper, Algorithm 1, steps 3 and 4).

    Args:
        elements: The window's elements in time order.
        head: Stamp (ns) of the cluster of G(t-1) to connect from, None where there is none.
        imu: Which IMU samples lie between two stamps.

    Yields:
        Candidates, partition by partition, the finest first. A step without an IMU sample makes no
        connection, and candidates that come out identical are yielded once.
    """
    for clusters in partitions(elements):
        seen: set[tuple[Connection, ...]] = set()
        for nodes in chains(len(clusters), head is not None):
            candidate = connect(clusters, nodes, head, imu)
            if candidate.connections not in seen:
                seen.add(candidate.connections)
                yield candidate


def base_candidate(elements: Sequence[Element], head: int | None, imu: ImuStamps) -> Candidate:
    """The conventional graph: one cluster an element, consecutive connections (paper, Base).

    Args:
        elements: The window's elements in time order.
        head: Stamp (ns) of the cluster of G(t-1) to connect from, None where there is none.
        imu: Which IMU samples lie between two stamps.

    Returns:
        The candidate; it may be unconnected.
    """
    clusters = tuple(Cluster(part, i, i) for i, part in enumerate(elements))
    start = [] if head is None else [HEAD]
    return connect(clusters, [*start, *range(len(clusters))], head, imu)
