"""Which clusters of a candidate hang together, decided before anything is solved (paper, step 5).

What candidates with the same clusters share is made once: their numbers, the cluster of every
scan, and which clusters odometry alone joins. A candidate's connections then only join components.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from incremental_mapper.candidates.model import HEAD, Candidate, Cluster, CoreMeasurement
from incremental_mapper.frontend.front_end import Prepared
from incremental_mapper.frontend.match_noise import weak_directions
from incremental_mapper.frontend.prepared_scan import PreparedScan
from incremental_mapper.graph.factors import Factor
from incremental_mapper.graph.frontier import Frontier

LOCAL = 1 << 40
"""Candidates' clusters are numbered from here on while they compete, the same in every window."""
GRAPH = 0
"""The place of all of G(t-1) before those of a candidate's clusters."""


@dataclass(frozen=True, slots=True, eq=False)
class Partition:
    """What candidates with the same ``clusters`` share.

    Attributes:
        clusters: The clusters in time order.
        numbered: The clusters by their number.
        homes: Number of the cluster of every scan, by sensor and stamp (ns).
        components: Component of every cluster without any connection; 0 is that of G(t-1).
        firm: The same where matches that are weak in some direction join nothing.
        factors: Odometry and fixes of the clusters' members, by the clusters' first elements.
    """

    clusters: tuple[Cluster, ...]
    numbered: Mapping[int, Cluster]
    homes: Mapping[tuple[str, int], int]
    components: tuple[int, ...]
    firm: tuple[int, ...]
    factors: dict[int, Sequence[Factor]] = field(default_factory=dict)

    def unconnected(self, candidate: Candidate) -> list[list[Cluster]]:
        """The components of one of the candidates that do not reach G(t-1).

        Args:
            candidate: A candidate with these clusters.

        Returns:
            The clusters of each such component, both in time order; empty where the candidate is
            connected.
        """
        found: dict[int, list[Cluster]] = {}
        labels = _joined(self.components, candidate)
        for cluster, label in zip(self.clusters, labels, strict=True):
            if label:
                found.setdefault(label, []).append(cluster)
        return list(found.values())

    def held(self, candidate: Candidate) -> bool:
        """Whether no cluster hangs on matches that the scans hold weakly.

        Args:
            candidate: A candidate with these clusters.
        """
        return not any(_joined(self.firm, candidate))


def _joined(labels: tuple[int, ...], candidate: Candidate) -> tuple[int, ...]:
    """The components of its clusters, joined by a candidate's connections."""
    if not any(labels):
        return labels
    for link in candidate.connections:
        start = 0 if link.start == HEAD else labels[link.start]
        low, high = sorted((start, labels[link.end]))
        labels = tuple(low if label == high else label for label in labels)
    return labels


class Partitions:
    """The partitions of a window."""

    def __init__(self, prepared: Mapping[CoreMeasurement, Prepared], frontier: Frontier) -> None:
        self._prepared = prepared
        self._is_first = frontier.newest is None
        self._homes = frontier.homes()
        self._elements = len({core.stamp for core in prepared})
        self._made: dict[int, Partition] = {}
        self._weak = {
            core
            for core, item in prepared.items()
            if isinstance(item, PreparedScan)
            and item.covariance is not None
            and weak_directions(item.covariance)
        }

    @property
    def touched(self) -> bool:
        """Whether any scan is matched to one of G(t-1)."""
        return any(
            isinstance(item, PreparedScan) and (core.sensor, item.previous) in self._homes
            for core, item in self._prepared.items()
        )

    def number(self, cluster: Cluster) -> int:
        """Number of a cluster while candidates compete; unique within the window."""
        return LOCAL + cluster.first * self._elements + cluster.last

    def of(self, candidate: Candidate) -> Partition:
        """What the candidates with these clusters share.

        Args:
            candidate: A candidate of the window; enumerations hand on the same tuple of clusters.

        Returns:
            The same object for the same tuple.
        """
        known = self._made.get(id(candidate.clusters))
        if known is None:
            known = self._made[id(candidate.clusters)] = self._make(candidate.clusters)
        return known

    def _make(self, clusters: tuple[Cluster, ...]) -> Partition:
        numbers = tuple(self.number(cluster) for cluster in clusters)
        homes = dict(self._homes)
        known = set(homes.values())
        for cluster, own in zip(clusters, numbers, strict=True):
            for core in cluster.members:
                homes[core.sensor, core.stamp] = own
        places = {number: place for place, number in enumerate(numbers, GRAPH + 1)}
        first = [(GRAPH, GRAPH + 1)] if self._is_first and numbers else []
        every, firm = first.copy(), first
        for place, cluster in enumerate(clusters, GRAPH + 1):
            for core in cluster.members:
                item = self._prepared[core]
                if isinstance(item, PreparedScan) and item.previous is not None:
                    other = homes.get((core.sensor, item.previous))
                    if other is not None:
                        ends = GRAPH if other in known else places[other], place
                        every.append(ends)
                        if core not in self._weak:
                            firm.append(ends)
        numbered = dict(zip(numbers, clusters, strict=True))
        count = len(clusters)
        return Partition(clusters, numbered, homes, _labels(count, every), _labels(count, firm))


def _labels(count: int, joined: Sequence[tuple[int, int]]) -> tuple[int, ...]:
    """Component of every cluster by the places that matches join; 0 is that of G(t-1)."""
    # Of the few clusters of a window: a library's sets take longer to be filled.
    labels = list(range(count + 1))
    for ends in joined:
        low, high = sorted(labels[place] for place in ends)
        if low != high:
            labels = [low if label == high else label for label in labels]
    found = {labels[GRAPH]: 0}
    return tuple(found.setdefault(label, len(found)) for label in labels[GRAPH + 1 :])
