"""What candidates with the same clusters share, made once: numbers, homes, connectivity."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from incremental_mapper.candidates.model import HEAD, Candidate, Cluster, CoreMeasurement
from incremental_mapper.frontend.front_end import Prepared
from incremental_mapper.frontend.scan_preparation import PreparedScan
from incremental_mapper.graph.connectivity import UnionFind
from incremental_mapper.graph.factors import Factor
from incremental_mapper.graph.frontier import Frontier

LOCAL = 1 << 40
"""Candidates' clusters are numbered from here on while they compete, the same in every window."""
GRAPH = 'G(t-1)'
"""The node that stands for all of G(t-1) in the connectivity of a candidate."""


@dataclass(frozen=True, slots=True, eq=False)
class Partition:
    """What candidates with the same ``clusters`` share.

    ``numbered`` are the clusters by their number and ``homes`` the number of every scan's cluster.
    ``parts`` tell which of them hang together without any connection, 0 with G(t-1).
    ``factors`` are those of the clusters' members, by the clusters' first elements.
    """

    clusters: tuple[Cluster, ...]
    numbered: Mapping[int, Cluster]
    homes: Mapping[tuple[str, int], int]
    parts: tuple[int, ...]
    factors: dict[int, Sequence[Factor]] = field(default_factory=dict)

    def components(self, candidate: Candidate) -> list[list[Cluster]]:
        """Clusters of one of the candidates by component, without those that reach G(t-1)."""
        parts = self.parts
        if not any(parts):
            return []
        for link in candidate.connections:
            start = 0 if link.start == HEAD else parts[link.start]
            low, high = sorted((start, parts[link.end]))
            parts = tuple(low if part == high else part for part in parts)
        loose: dict[int, list[Cluster]] = {}
        for cluster, part in zip(self.clusters, parts, strict=True):
            if part:
                loose.setdefault(part, []).append(cluster)
        return list(loose.values())


class Partitions:
    """The partitions of a window with so many ``elements``."""

    def __init__(
        self, prepared: Mapping[CoreMeasurement, Prepared], frontier: Frontier, elements: int
    ) -> None:
        self._prepared = prepared
        self._frontier = frontier
        self._elements = elements
        self._made: dict[int, Partition] = {}

    def number(self, cluster: Cluster) -> int:
        """Number of a cluster while candidates compete; unique within the window."""
        return LOCAL + cluster.first * self._elements + cluster.last

    def of(self, candidate: Candidate) -> Partition:
        """What candidates with these clusters share; enumerations hand on the same tuple."""
        known = self._made.get(id(candidate.clusters))
        if known is None:
            known = self._made[id(candidate.clusters)] = self._make(candidate.clusters)
        return known

    def _make(self, clusters: tuple[Cluster, ...]) -> Partition:
        numbers = tuple(self.number(cluster) for cluster in clusters)
        homes = {(name, stamp): id_ for name, (id_, stamp) in self._frontier.chains.items()}
        known = set(homes.values())
        for cluster, own in zip(clusters, numbers, strict=True):
            for core in cluster.members:
                homes[core.sensor, core.stamp] = own
        sets: UnionFind[int | str] = UnionFind()
        if self._frontier.newest is None and numbers:
            sets.union(GRAPH, numbers[0])
        for cluster, own in zip(clusters, numbers, strict=True):
            for core in cluster.members:
                item = self._prepared[core]
                if isinstance(item, PreparedScan) and item.previous is not None:
                    other = homes.get((core.sensor, item.previous))
                    if other is not None:
                        sets.union(GRAPH if other in known else other, own)
        labels: dict[int | str, int] = {sets.find(GRAPH): 0}
        parts = tuple(labels.setdefault(sets.find(own), len(labels)) for own in numbers)
        return Partition(clusters, dict(zip(numbers, clusters, strict=True)), homes, parts)
