"""G(t): every cluster, factor and value so far, and the lag in which it still changes."""

from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import TypeAlias

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import DisjointSet

from incremental_mapper.candidates.model import Cluster, CoreMeasurement
from incremental_mapper.config import MOST_SUBMAP_SCANS
from incremental_mapper.graph.factor_archive import FactorArchive
from incremental_mapper.graph.factors import BETWEEN_STATES, Factor
from incremental_mapper.graph.frontier import Frontier
from incremental_mapper.map.store import MemoryStore, PointStore, StoredPoints
from incremental_mapper.smoothing.correction import Evidence, hold, release, with_evidence
from incremental_mapper.smoothing.marginal_prior import MarginalPrior, marginalise
from incremental_mapper.variables import (
    bias_key,
    cluster_of,
    copy_value,
    insert_moved,
    kind_of,
    pose_key,
    velocity_key,
)

KNOWN_VELOCITY = 0.5
"""m/s; a velocity with a smaller standard deviation may be used to predict motion."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacedCluster:
    """A cluster of G(t) under its final number.

    ``joined`` are measurements that came to it later, while the vehicle stood; it stood there
    at the stamps ``stood`` (ns), one for each window.
    """

    id: int
    window: int
    cluster: Cluster
    joined: tuple[CoreMeasurement, ...] = ()
    stood: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class PlacedScan:
    """A scan of the map: its points in base_link, and where its cluster holds it.

    ``T_cluster_scan`` is the identity unless motion is compensated within clusters. ``thinned``
    ones have the points of a saved map: those voxels that they saw first.
    """

    cluster: int
    stamp: int
    sensor: str
    stored: StoredPoints
    T_cluster_scan: gtsam.Pose3
    thinned: bool = False

    @property
    def points(self) -> NDArray[np.float32]:
        """Points (N, 3) in base_link, metres; fetched from where the map keeps them."""
        return self.cloud[:, :3]

    @property
    def cloud(self) -> NDArray[np.float32]:
        """As ``points``, or (N, 4) with their intensities where the LiDAR measures them."""
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


Recent: TypeAlias = deque[tuple[PlacedScan, NDArray[np.float64]]]
"""Scans with their points (M, 3) in base_link for scoring, the newest ones."""
LEAST_RECENT = 20
"""So many scans that the newest of every LiDAR is among them."""


def recent_scans(wanted: int = MOST_SUBMAP_SCANS) -> Recent:
    """Room for the newest scans: at 64 beams each takes 0.1 MB.

    Args:
        wanted: ``mom.submap_scans``.
    """
    return deque(maxlen=max(wanted, LEAST_RECENT))


@dataclass(slots=True)
class GraphState:
    """All that the mapper remembers; it is changed through its methods alone.

    Attributes:
        store: Keeps the points of the scans.
        clusters: All clusters, each at the place of its number.
        factors: All factors.
        scans: All scans.
        recent: The newest scans with their points (M, 3) in base_link for scoring.
        fixes: All fixes.
        prior: The newest part of G(t), which still changes.
        values: Final values of the variables that have left it.
        components: Which variables hang together by measurements.
        frontier: What a new factor may touch.
        scan_offsets: T_cluster_scan of each LiDAR's last scan, by sensor and stamp (ns).
        last_velocity: The newest velocity (3,), m/s in the map.
        last_bias: The newest IMU bias.
        velocity_known: Whether the graph has pinned the velocity down since the start.
        enu_offset: Where ENU's origin lies in the map, (3,) metres; None before the first fix.
        georeferenced: Whether the map is ENU.
        closures: Closed loops that are in it already; other factors are in ``factors``.
        oldest: Stamp (ns) before which poses change no more, window by window.
        corrections: How often all of it was moved at once: by closures, or into another frame.
        shifted: Metres that closures have moved its poses by, summed up.
        factor_counts: Factors by kind.
        inertial: Clusters with a velocity.
        biased: Clusters with a bias, which may serve the spans of others.
    """

    store: PointStore = field(default_factory=MemoryStore)
    clusters: list[PlacedCluster] = field(default_factory=list)
    factors: FactorArchive = field(default_factory=FactorArchive)
    scans: list[PlacedScan] = field(default_factory=list)
    recent: Recent = field(default_factory=recent_scans)
    fixes: list[PlacedFix] = field(default_factory=list)
    prior: MarginalPrior = field(default_factory=MarginalPrior)
    values: gtsam.Values = field(default_factory=gtsam.Values)
    components: DisjointSet = field(default_factory=DisjointSet)
    frontier: Frontier = field(default_factory=Frontier)
    scan_offsets: dict[tuple[str, int], gtsam.Pose3] = field(default_factory=dict)
    last_velocity: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    last_bias: gtsam.imuBias.ConstantBias = field(default_factory=gtsam.imuBias.ConstantBias)
    velocity_known: bool = False
    enu_offset: NDArray[np.float64] | None = None
    georeferenced: bool = False
    closures: list[Factor] = field(default_factory=list)
    oldest: int = 0
    corrections: int = 0
    shifted: float = 0.0
    factor_counts: Counter[str] = field(default_factory=Counter)
    inertial: set[int] = field(default_factory=set)
    biased: set[int] = field(default_factory=set)

    def __post_init__(self) -> None:
        if not isinstance(self.factors, FactorArchive):
            self.factors = FactorArchive(self.factors)

    # --- what it is asked

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
        stamp = self.prior.clusters.get(cluster)
        if stamp is None or stamp >= self.oldest:
            return stamp is not None
        return not any(cluster_of(key) == cluster for key in self.prior.held)

    def has_inertial(self, cluster: int) -> bool:
        """Whether a cluster has a velocity."""
        key = velocity_key(cluster)
        return self.values.exists(key) or self.prior.base.exists(key)

    def all_values(self) -> gtsam.Values:
        """Newest estimate of every variable of G(t)."""
        values = gtsam.Values(self.values)
        values.insert(self.prior.values)
        return values

    def holder(self, key: int) -> gtsam.Values:
        """The values that hold a variable's newest estimate."""
        return self.prior.holder(key) if self.prior.base.exists(key) else self.values

    # --- how it changes, window by window

    def add_clusters(
        self,
        clusters: Sequence[PlacedCluster],
        scans: Sequence[tuple[PlacedScan, NDArray[np.float64]]],
        fixes: Sequence[PlacedFix],
    ) -> None:
        """Append clusters and what they are made of.

        Args:
            clusters: Numbered on from those that are there.
            scans: Each with its points (M, 3) in base_link for scoring.
            fixes: Their places in ``factors`` count the factors to come.
        """
        self.clusters.extend(clusters)
        self.scans.extend(scan for scan, _ in scans)
        self.recent.extend(scans)
        self.fixes.extend(fixes)

    def add_joined(
        self, cluster: int, core: Sequence[CoreMeasurement], fixes: Sequence[PlacedFix]
    ) -> None:
        """Let measurements of a vehicle that stands join a cluster.

        Args:
            cluster: Its number.
            core: The measurements of a window.
            fixes: Those of them that are fixes; their places count the factors to come.
        """
        before = self.clusters[cluster]
        self.clusters[cluster] = replace(
            before,
            joined=(*before.joined, *core),
            stood=(*before.stood, max(item.stamp for item in core)),
        )
        self.fixes.extend(fixes)
        self.scan_offsets |= {(item.sensor, item.stamp): gtsam.Pose3() for item in core}

    def creep(self, moved: Mapping[str, gtsam.Pose3]) -> None:
        """A vehicle that seemed to stand has crept on.

        Args:
            moved: How far, by what the LiDARs say; the next scans are matched from there.
        """
        for name, (_, stamp) in self.frontier.chains.items():
            if name in moved and (name, stamp) in self.scan_offsets:
                self.scan_offsets[name, stamp] = moved[name]

    def add_factors(self, made: Sequence[Factor], prior: MarginalPrior) -> None:
        """Append factors, with the marginal prior that holds what they say.

        They are counted here, so that statistics cost the same all along a drive.
        """
        self.prior = prior
        self.factors.extend(made)
        for factor in made:
            self.factor_counts[str(factor.kind)] += 1
            for key in factor.keys:
                if kind_of(key) == 'v':
                    self.inertial.add(cluster_of(key))
                elif kind_of(key) == 'b':
                    self.biased.add(cluster_of(key))
            # What carries velocity and bias over is no measurement: what only that holds
            # together counts as apart.
            if factor.kind not in BETWEEN_STATES:
                for key in factor.keys:
                    self.components.add(key)
                    self.components.merge(factor.keys[0], key)

    def define_enu(self, offset: NDArray[np.float64]) -> None:
        """Note where ENU's origin lies in the map, (3,) metres, until the map is ENU."""
        self.enu_offset = offset

    def advance(
        self, frontier: Frontier, predicted_velocity: NDArray[np.float64], oldest: int
    ) -> None:
        """Move the frontier on, and marginalise what it leaves behind.

        Args:
            frontier: The new one.
            predicted_velocity: The newest velocity (3,), m/s in the map, where the graph has none.
            oldest: Stamp (ns) before which eliminated variables no longer change.
        """
        self.frontier = frontier
        chains = frontier.chains
        self.scan_offsets = {
            (name, stamp): self._scan_offset(name, stamp, 50 * len(chains))
            for name, (_, stamp) in chains.items()
        }
        head = frontier.head
        if head is not None and frontier.head_inertial:
            self.last_velocity = self.velocity(head)
            if frontier.bias is not None:
                self.last_bias = self.bias(frontier.bias)
            self.velocity_known = self.velocity_known or self._pins_velocity(head)
        else:
            self.last_velocity = predicted_velocity
        self.prior, gone = marginalise(self.prior, frontier.keys(), oldest)
        self.values.insert(gone)
        self.oldest = oldest

    def _scan_offset(self, sensor: str, stamp: int, newest: int) -> gtsam.Pose3:
        """T_cluster_scan of a scan: one of so many, or one whose offset is kept."""
        for scan in islice(reversed(self.scans), newest):
            if scan.stamp == stamp and scan.sensor == sensor:
                return scan.T_cluster_scan
        return self.scan_offsets[sensor, stamp]

    def turn_to_enu(
        self,
        T_enu_map: gtsam.Pose3,
        factors: Sequence[Factor],
        prior: MarginalPrior,
        values: gtsam.Values,
    ) -> None:
        """Replace all of G(t) by the same in ENU, which is the map from here on.

        Args:
            T_enu_map: From the map so far.
            factors: All factors, in their order.
            prior: The newest part.
            values: The variables that have left it.
        """
        self.factors = FactorArchive(factors)
        self.prior, self.values = prior, values
        self.last_velocity = T_enu_map.rotation().rotate(self.last_velocity)
        self.enu_offset = np.zeros(3)
        self.georeferenced = True
        self.corrections += 1

    def refound(
        self,
        factors: Sequence[Factor],
        fixes: Sequence[PlacedFix],
        offset: NDArray[np.float64] | None,
        prior: MarginalPrior,
        values: gtsam.Values,
    ) -> None:
        """Replace all of G(t) by the same with fewer fixes; the map is not ENU until it is turned.

        Args:
            factors: The factors that are left, in their order.
            fixes: The fixes that are left, with their places among them.
            offset: Where ENU's origin lies in the map, (3,) metres; None without a fix.
            prior: The newest part.
            values: The variables that have left it.
        """
        self.factor_counts = Counter(str(factor.kind) for factor in factors)
        self.factors, self.fixes = FactorArchive(factors), list(fixes)
        self.prior, self.values = prior, values
        self.enu_offset, self.georeferenced = offset, False
        self.corrections += 1

    def hold(self) -> None:
        """Hold the frontier as it is, until evidence on it comes."""
        self.prior = hold(self.prior)

    def release(self) -> None:
        """Hold nothing any more."""
        self.prior = release(self.prior)

    def close(
        self,
        closures: Sequence[Factor],
        evidence: Evidence,
        older: gtsam.Values,
        left: gtsam.Values,
        since: int,
        shifted: float,
    ) -> None:
        """Take in closed loops, found while windows went on.

        Args:
            closures: All closures from now on.
            evidence: What they say of the frontier that is held.
            older: What had left the lag when it was held, as the closures have it; it is kept.
            left: The rest of what was there then.
            since: How many clusters there were then.
            shifted: By how many metres that moved a pose at the most.
        """
        self.prior = with_evidence(self.prior, evidence)
        T_new_old = evidence.T_new_old
        for key in left.keys():  # noqa: SIM118 (no mapping)
            if self.values.exists(key):
                copy_value(left, key, older)
        for cluster in range(since, len(self.clusters)):
            for key in (pose_key(cluster), velocity_key(cluster), bias_key(cluster)):
                if self.values.exists(key):
                    insert_moved(self.values, key, T_new_old, older)
        self.values = older
        self.last_velocity = T_new_old.rotation().rotate(self.last_velocity)
        self.closures = list(closures)
        self.corrections += 1
        self.shifted += shifted

    def _pins_velocity(self, cluster: int) -> bool:
        """Whether a cluster's velocity is certain enough to predict motion."""
        covariance = self.prior.covariance(velocity_key(cluster))
        if covariance is None:
            return False
        return bool(np.sqrt(np.linalg.eigvalsh(covariance)[-1]) < KNOWN_VELOCITY)
