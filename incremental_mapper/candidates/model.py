"""Core measurements, clusters, connections and candidates: the values that a window is made of."""

from dataclasses import dataclass
from enum import Enum, StrEnum, auto
from functools import cached_property


class CoreKind(StrEnum):
    """What a core measurement contributes (paper, Algorithm 1, step 1)."""

    LIDAR = 'lidar'
    GNSS = 'gnss'


@dataclass(frozen=True, slots=True, order=True)
class CoreMeasurement:
    """A measurement that needs a variable; identified by its stamp (ns) and sensor."""

    stamp: int
    sensor: str
    kind: CoreKind

    def __hash__(self) -> int:
        # Asked for thousands of times a second, and hardly two have the same stamp.
        return hash(self.stamp)


@dataclass(frozen=True, slots=True)
class Cluster:
    """Adjacent core measurements that share one pose variable (paper, section Definitions).

    ``members`` are sorted by stamp; ``first`` and ``last`` are the positions of the cluster's
    elements in the window.
    """

    members: tuple[CoreMeasurement, ...]
    first: int = 0
    last: int = 0

    @property
    def stamp(self) -> int:
        """Stamp of the median member, ``sorted_stamps[n // 2]``, in nanoseconds."""
        return self.members[len(self.members) // 2].stamp

    @property
    def time_range(self) -> int:
        """Last minus first stamp of the members, in nanoseconds."""
        return self.members[-1].stamp - self.members[0].stamp


class SpanBias(Enum):
    """Which bias the IMU spans of a window have."""

    EACH_END = auto()
    """Each end of a span has its own (paper)."""
    NEW = auto()
    """All spans of a candidate have the same one, which is one of its variables."""
    KEPT = auto()
    """All spans have one of G(t-1)."""


HEAD = -1
"""Index that a connection uses for the cluster of G(t-1) at the head of the composition."""


@dataclass(frozen=True, slots=True, order=True)
class Connection:
    """An IMU span between two clusters of a candidate, given by their indices; HEAD is G(t-1).

    ``start_stamp`` and ``end_stamp`` are the cluster stamps; ``first_sample`` is the stamp of the
    first IMU sample inside. The span holds the samples with start_stamp <= stamp < end_stamp.
    """

    start: int
    end: int
    start_stamp: int
    end_stamp: int
    first_sample: int

    @property
    def shift(self) -> int:
        """First IMU stamp minus the stamp of the cluster where the span starts, nanoseconds."""
        return self.first_sample - self.start_stamp


@dataclass(frozen=True)
class Candidate:
    """One way of building the window's graph: clusters in time order and their connections.

    ``bias`` says what the connections take for the bias of the IMU. What follows from the three is
    asked for again and again, and computed once.
    """

    clusters: tuple[Cluster, ...]
    connections: tuple[Connection, ...]
    bias: SpanBias = SpanBias.EACH_END

    @cached_property
    def time_shift(self) -> int:
        """Total time shift in nanoseconds (paper, equation for E in Minimum Time Shift)."""
        ranges = sum(cluster.time_range for cluster in self.clusters)
        return ranges + sum(connection.shift for connection in self.connections)

    @cached_property
    def inertial_clusters(self) -> frozenset[int]:
        """Indices of the clusters at the ends of spans, HEAD among them: those have a velocity."""
        ends = {connection.end for connection in self.connections}
        return frozenset(ends | {connection.start for connection in self.connections})

    @cached_property
    def linked(self) -> bool:
        """Whether each LiDAR has a scan in a cluster at which a span starts or ends.

        Matches hold a LiDAR's scans together, and nothing holds those of two LiDARs but spans and
        clusters that they share: without them the two chains drift apart, and no map shows it.
        """
        lidars = {
            core.sensor
            for cluster in self.clusters
            for core in cluster.members
            if core.kind is CoreKind.LIDAR
        }
        ends = self.inertial_clusters - {HEAD}
        return lidars <= {core.sensor for end in ends for core in self.clusters[end].members}

    @cached_property
    def merges(self) -> bool:
        """Whether measurements of different stamps share a cluster."""
        return any(cluster.time_range > 0 for cluster in self.clusters)

    @cached_property
    def vertices(self) -> int:
        """Variables that the candidate adds: poses, velocities at the ends of spans, and biases."""
        velocities = biases = len(self.inertial_clusters - {HEAD})
        if self.bias is not SpanBias.EACH_END:
            biases = int(self.bias is SpanBias.NEW and bool(self.connections))
        return len(self.clusters) + velocities + biases
