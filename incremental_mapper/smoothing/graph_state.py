"""G(t): every cluster, factor and value so far, and the lag in which it still changes."""

from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.candidates.model import Cluster
from incremental_mapper.config import MOST_SUBMAP_SCANS
from incremental_mapper.frontend.gnss import Alignment
from incremental_mapper.graph.connectivity import UnionFind
from incremental_mapper.graph.factors import Factor
from incremental_mapper.graph.frontier import Frontier
from incremental_mapper.graph.values import bias_key, cluster_of, kind_of, pose_key, velocity_key
from incremental_mapper.map.store import MemoryStore, PointStore, StoredPoints
from incremental_mapper.smoothing.marginal_prior import MarginalPrior


@dataclass(frozen=True, slots=True, eq=False)
class PlacedCluster:
    """A cluster of G(t) under its final number."""

    id: int
    window: int
    cluster: Cluster


@dataclass(frozen=True, slots=True, eq=False)
class PlacedScan:
    """A scan of the map: its points in base_link, and where its cluster holds it.

    ``T_cluster_scan`` is the identity unless motion is compensated within clusters.
    """

    cluster: int
    stamp: int
    sensor: str
    stored: StoredPoints
    T_cluster_scan: gtsam.Pose3

    @property
    def points(self) -> NDArray[np.float32]:
        """Points (N, 3) in base_link, metres; fetched from where the map keeps them."""
        return self.stored.load()


@dataclass(frozen=True, slots=True, eq=False)
class PlacedFix:
    """A fix of G(t), in ENU, with the place of its factor in ``GraphState.factors``."""

    cluster: int
    stamp: int
    enu: NDArray[np.float64]
    covariance: NDArray[np.float64]
    lever_arm: NDArray[np.float64]
    factor: int


def _recent_scans() -> deque[tuple[PlacedScan, NDArray[np.float64]]]:
    return deque(maxlen=MOST_SUBMAP_SCANS)


@dataclass(slots=True)
class GraphState:
    """All that the mapper remembers.

    ``store`` keeps the points of the scans. ``prior`` is the newest part, ``values`` what has
    left it; ``recent`` are the newest scans with their points (M, 3) for scoring.
    ``scan_offsets`` is T_cluster_scan of each LiDAR's last scan. ``last_velocity`` and
    ``last_bias`` are the newest ones; ``velocity_known`` says that the graph has pinned the
    velocity down since the start.
    ``alignment`` is how ENU sits in the map; ``georeferenced`` says that the map is ENU.
    ``factor_counts`` are the factors by kind, ``inertial`` the clusters with velocity and bias.
    """

    store: PointStore = field(default_factory=MemoryStore)
    clusters: list[PlacedCluster] = field(default_factory=list)
    factors: list[Factor] = field(default_factory=list)
    scans: list[PlacedScan] = field(default_factory=list)
    recent: deque[tuple[PlacedScan, NDArray[np.float64]]] = field(default_factory=_recent_scans)
    fixes: list[PlacedFix] = field(default_factory=list)
    prior: MarginalPrior = field(default_factory=MarginalPrior)
    values: gtsam.Values = field(default_factory=gtsam.Values)
    components: UnionFind[int] = field(default_factory=UnionFind)
    frontier: Frontier = field(default_factory=Frontier)
    scan_offsets: dict[tuple[str, int], gtsam.Pose3] = field(default_factory=dict)
    last_velocity: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    last_bias: gtsam.imuBias.ConstantBias = field(default_factory=gtsam.imuBias.ConstantBias)
    velocity_known: bool = False
    alignment: Alignment | None = None
    georeferenced: bool = False
    factor_counts: Counter[str] = field(default_factory=Counter)
    inertial: set[int] = field(default_factory=set)

    def add_factors(self, made: Sequence[Factor]) -> None:
        """Append factors, and count them so that statistics cost the same all along a drive."""
        self.factors.extend(made)
        for factor in made:
            self.factor_counts[str(factor.kind)] += 1
            for key in factor.keys:
                if kind_of(key) == 'v':
                    self.inertial.add(cluster_of(key))

    def pose(self, cluster: int) -> gtsam.Pose3:
        """Newest estimate of a cluster's pose T_map_base."""
        return self.holder(pose_key(cluster)).atPose3(pose_key(cluster))

    def velocity(self, cluster: int) -> NDArray[np.float64]:
        """Newest estimate of a cluster's velocity (3,), m/s in the map."""
        key = velocity_key(cluster)
        velocity: NDArray[np.float64] = self.holder(key).atVector(key)
        return velocity

    def bias(self, cluster: int) -> gtsam.imuBias.ConstantBias:
        """Newest estimate of a cluster's IMU bias."""
        return self.holder(bias_key(cluster)).atConstantBias(bias_key(cluster))

    def recent_poses(self, scans: int) -> set[int]:
        """Keys of the poses that hold the newest ``scans`` scans."""
        return {pose_key(scan.cluster) for scan, _ in list(self.recent)[-scans:]}

    def in_lag(self, cluster: int) -> bool:
        """Whether a cluster's pose still changes."""
        return cluster in self.prior.clusters

    def has_inertial(self, cluster: int) -> bool:
        """Whether a cluster has velocity and bias."""
        key = velocity_key(cluster)
        return self.values.exists(key) or self.prior.base.exists(key)

    def all_values(self) -> gtsam.Values:
        """Newest estimate of every variable of G(t)."""
        values = gtsam.Values(self.values)
        values.insert(self.prior.values)
        return values

    def keep(self, gone: gtsam.Values) -> None:
        """Store variables that left the lag."""
        self.values.insert(gone)

    def holder(self, key: int) -> gtsam.Values:
        """The values that hold a variable's newest estimate."""
        return self.prior.holder(key) if self.prior.base.exists(key) else self.values
