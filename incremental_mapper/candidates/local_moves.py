"""Candidates that differ from a given one by a single decision, for a local search."""

from collections.abc import Iterator, Sequence
from itertools import combinations

from incremental_mapper.candidates.enumeration import connect
from incremental_mapper.candidates.model import HEAD, Candidate, Cluster
from incremental_mapper.candidates.partitions import Element, make_cluster
from incremental_mapper.candidates.spans import ImuStamps


def neighbours(
    candidate: Candidate, elements: Sequence[Element], head: int | None, imu: ImuStamps
) -> Iterator[Candidate]:
    """Candidates that differ from one by a single decision.

    Two clusters merged, one split, one more or less in the chain of connections; two more at once
    where neither alone would be connected to anything.

    Args:
        candidate: The candidate to start from.
        elements: The window's elements in time order.
        head: Stamp (ns) of the cluster of G(t-1) to connect from, None where there is none.
        imu: Which IMU samples lie between two stamps.

    Yields:
        Candidates; some may come more than once, or be the candidate itself where a decision makes
        no difference.
    """
    count = len(candidate.clusters)
    chain = {link.end for link in candidate.connections}
    chain |= {link.start for link in candidate.connections if link.start != HEAD}

    def made(bounds: Sequence[tuple[int, int]], visited: set[int]) -> Iterator[Candidate]:
        clusters: list[Cluster] = []
        for first, last in bounds:
            cluster = make_cluster(elements, first, last)
            if cluster is None:
                return
            clusters.append(cluster)
        # The chain starts at the head or at the first cluster, and ends at the last one.
        nodes = sorted(visited | {len(clusters) - 1} | ({0} if head is None else set()))
        yield connect(tuple(clusters), nodes if head is None else [HEAD, *nodes], head, imu)

    bounds = [(cluster.first, cluster.last) for cluster in candidate.clusters]
    idle: list[int] = []
    for index in range(count - 1):
        for other in made(bounds, chain ^ {index}):
            if index not in chain and other.connections == candidate.connections:
                idle.append(index)
            yield other
    # Where samples are rare, two clusters may have a span between them and neither to the chain.
    for pair in combinations(idle, 2):
        yield from made(bounds, chain.union(pair))
    for index in range(count - 1):
        joined = [*bounds[:index], (bounds[index][0], bounds[index + 1][1]), *bounds[index + 2 :]]
        yield from made(joined, {node - (node > index) for node in chain})
    for index, (first, last) in enumerate(bounds):
        for cut in range(first + 1, last + 1):
            split = [*bounds[:index], (first, cut - 1), (cut, last), *bounds[index + 1 :]]
            others = {node + (node > index) for node in chain - {index}}
            for own in ({index}, {index + 1}, {index, index + 1}, set[int]()):
                yield from made(split, others | own)
