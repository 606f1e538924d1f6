"""The factors of a window's candidates; what candidates share is built once."""

from collections.abc import Iterable, Sequence

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.candidates.model import (
    Candidate,
    Cluster,
    CoreMeasurement,
)
from incremental_mapper.frontend.front_end import PreparedFix
from incremental_mapper.frontend.gap_matching import LONG
from incremental_mapper.frontend.match_noise import carried
from incremental_mapper.frontend.prepared_scan import PreparedScan
from incremental_mapper.graph.connectivity import Partition, Partitions
from incremental_mapper.graph.factors import (
    Factor,
    FactorKind,
    between_factor,
    gnss_factor,
    pose_prior,
    pose_sigmas,
)
from incremental_mapper.graph.motion_compensation import MotionCompensation
from incremental_mapper.graph.span_factors import SpanFactors
from incremental_mapper.graph.window_inputs import WindowInputs
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.variables import pose_key

UNSEEN_SPEED = 0.5
"""m/s; deviation of the velocity with which a measurement is moved where there is no IMU: the noise
of a match over 0.1 s is 0.3."""
UNSEEN_TURN = 0.05
"""rad/s; the same of its rate of turn: a match's noise over 0.1 s is 0.03."""
UNSEEN = np.diag(pose_sigmas(UNSEEN_SPEED, UNSEEN_TURN) ** 2)
GAP_NOISE = 5.0
"""So many times the noise of a match has one over a gap: 0.15 to 0.22 m while a simulated car sets
off, where matches at 10 Hz have 0.03 m."""


class FactorBuilder:
    """Builds candidates' factors; the same cluster has the same keys in every candidate."""

    def __init__(
        self, inputs: WindowInputs, partitions: Partitions, compensation: MotionCompensation
    ) -> None:
        """Nothing is built before it is asked for.

        Args:
            inputs: Everything that the factors of the window are made of.
            partitions: The numbers of the window's clusters, and what they share.
            compensation: Where the members of a cluster stand in it.
        """
        self._in = inputs
        self._partitions = partitions
        self._compensation = compensation
        self._spans = SpanFactors(inputs, partitions, compensation)
        self._cache: dict[tuple[object, ...], tuple[Factor, ...]] = {}
        # Of whole candidates, which stay alive as the keys of their factors.
        self._made: dict[int, tuple[Candidate, Sequence[Factor]]] = {}
        odometry = inputs.config.odometry
        self._constant = np.diag(
            pose_sigmas(odometry.sigma_translation, odometry.sigma_rotation) ** 2
        )

    def factors(self, candidate: Candidate, since: int = 0) -> Sequence[Factor]:
        """All factors of a candidate except those that hold unconnected components.

        Args:
            candidate: A candidate of the window.
            since: Index of the first cluster whose factors are wanted; 0 gives all of them.

        Returns:
            Odometry and fixes of the clusters' members, then IMU factors of the connections and
            the clusters that they pass over, then what holds velocity and bias where a chain of
            spans starts, and in the first window the prior.
        """
        if since:
            return self._factors(candidate, since)
        known = self._made.get(id(candidate))
        if known is None:
            known = self._made[id(candidate)] = candidate, self._factors(candidate, 0)
        return known[1]

    def _factors(self, candidate: Candidate, since: int) -> Sequence[Factor]:
        partition = self._partitions.of(candidate)
        made: list[Factor] = []
        for cluster in candidate.clusters[since:]:
            if cluster.first not in partition.factors:
                partition.factors[cluster.first] = self._of_cluster(cluster, partition)
            made.extend(partition.factors[cluster.first])
        made.extend(self._spans.factors(candidate, since))
        if self._in.frontier.newest is None and since == 0:
            first = candidate.clusters[0]
            made.append(self._first_prior(first))
        return made

    def _of_cluster(self, cluster: Cluster, partition: Partition) -> Sequence[Factor]:
        """Odometry and fixes of a cluster's members."""
        made: list[Factor] = []
        for core in cluster.members:
            item = self._in.prepared[core]
            if isinstance(item, PreparedFix):
                made.extend(self._gnss(item, cluster))
            elif item.previous is not None and (core.sensor, item.previous) in partition.homes:
                start = partition.homes[core.sensor, item.previous]
                made.extend(self._odometry(item, start, partition.numbered.get(start), cluster))
        return made

    def has_odometry(self, core: CoreMeasurement) -> bool:
        """Whether a scan is linked to an earlier one."""
        item = self._in.prepared[core]
        return isinstance(item, PreparedScan) and item.previous is not None

    def continued_scans(self, core: Iterable[CoreMeasurement]) -> set[tuple[str, int]]:
        """Earlier scans that some scans are matched to.

        Args:
            core: Core measurements of the window.

        Returns:
            Their sensors and stamps (ns).
        """
        items = [self._in.prepared[one] for one in core]
        return {
            (item.core.sensor, item.previous)
            for item in items
            if isinstance(item, PreparedScan) and item.previous is not None
        }

    def regularising_prior(self, cluster: Cluster) -> Factor:
        """Hold a component that nothing connects, at its predicted pose.

        Args:
            cluster: A cluster of the component.

        Returns:
            A weak prior on its pose.
        """
        graph = self._in.config.graph
        sigmas = pose_sigmas(graph.weak_sigma_position, graph.weak_sigma_rotation)
        pose = self._in.states[cluster.stamp].pose
        return pose_prior(pose_key(self._partitions.number(cluster)), pose, sigmas, cluster.stamp)

    def bridge(self, cluster: Cluster, first: Cluster, newest: gtsam.Pose3 | None) -> Factor:
        """Tie a component loosely to G(t-1), by the predicted motion.

        Args:
            cluster: A cluster of the component.
            first: The window's first cluster, which takes the place of a G(t-1) that is not there.
            newest: T_map_base of the newest cluster of G(t-1), None where there is none.

        Returns:
            A relative pose with large standard deviations, which grow with the hole: however
            long it was, the earlier map must not follow what comes after it.
        """
        graph, frontier = self._in.config.graph, self._in.frontier
        if frontier.newest is None or newest is None:
            anchor, stamp = self._partitions.number(first), first.stamp
            pose = self._in.states[stamp].pose
        else:
            anchor, stamp, pose = frontier.newest, frontier.newest_stamp, newest
        unseen = max(abs(cluster.stamp - stamp) / NANOSECONDS - 1.0, 0.0)
        position = graph.weak_sigma_position + graph.bridge_speed * unseen
        rotation = min(graph.weak_sigma_rotation + graph.bridge_rate * unseen, np.pi)
        return between_factor(
            FactorKind.BRIDGE,
            (pose_key(anchor), pose_key(self._partitions.number(cluster))),
            pose.between(self._in.states[cluster.stamp].pose),
            np.diag(pose_sigmas(position, max(rotation, graph.weak_sigma_rotation)) ** 2),
            None,
            (stamp, cluster.stamp),
        )

    def _odometry(
        self, item: PreparedScan, start: int, start_cluster: Cluster | None, end: Cluster
    ) -> tuple[Factor, ...]:
        own = self._partitions.number(end)
        key = ('odometry', item.core, start, own)
        if key not in self._cache:
            assert item.previous is not None and item.T_previous_current is not None
            before = (
                self._in.scan_offsets.get((item.core.sensor, item.previous), gtsam.Pose3())
                if start_cluster is None
                else self._compensation.offset(start_cluster, item.previous)
            )
            after = self._compensation.offset(end, item.core.stamp)
            motion = before.compose(item.T_previous_current).compose(after.inverse())
            self._cache[key] = (
                between_factor(
                    FactorKind.ODOMETRY,
                    (pose_key(start), pose_key(own)),
                    motion,
                    self._covariance(item, after, end, start_cluster),
                    item.core.sensor,
                    (item.previous, item.core.stamp),
                ),
            )
        return self._cache[key]

    def _covariance(
        self, item: PreparedScan, T_end_scan: gtsam.Pose3, end: Cluster, start: Cluster | None
    ) -> NDArray[np.float64]:
        """Covariance of a match in the frame of a cluster, in which its scan stands.

        With what moving its ends across IMU holes adds, and more over a gap.
        """
        unseen = self._compensation.unseen(end, item.core.stamp)
        assert item.previous is not None
        if start is not None:
            unseen += self._compensation.unseen(start, item.previous)
        known = item.covariance
        covariance = self._constant if known is None else carried(known, T_end_scan)
        if unseen > 0.0:
            covariance = covariance + unseen**2 * UNSEEN
        over_gap = item.core.stamp - item.previous > LONG * NANOSECONDS
        return GAP_NOISE**2 * covariance if over_gap else covariance

    def _gnss(self, item: PreparedFix, cluster: Cluster) -> tuple[Factor, ...]:
        own = self._partitions.number(cluster)
        key = ('gnss', item.core, own)
        if key not in self._cache:
            config = self._in.config
            spread, upward = self._in.fix_inflation.get(item.core.stamp, (0.0, 0.0))
            arm = config.gnss.matrix()[:3, 3]
            arm = self._compensation.offset(cluster, item.core.stamp).transformFrom(arm)
            moved = UNSEEN_SPEED * self._compensation.unseen(cluster, item.core.stamp)
            inflated = item.covariance + np.diag([spread**2, spread**2, upward**2])
            inflated += moved**2 * np.eye(3)
            self._cache[key] = (
                gnss_factor(
                    pose_key(own),
                    item.enu + self._in.enu_offset,
                    inflated,
                    arm,
                    config.fixes.robust_threshold,
                    item.core.sensor,
                    item.core.stamp,
                ),
            )
        return self._cache[key]

    def _first_prior(self, cluster: Cluster) -> Factor:
        """Prior that holds the map's first pose: level well, yaw by choice.

        Until fixes turn the map, its axes are those of this pose, as its origin is. Nothing else
        says anything of the yaw: where it is held loosely, what linear factors seem to say of it
        swings the whole map by degrees from window to window.
        """
        graph = self._in.config.graph
        yaw = min(graph.prior_sigma_yaw, graph.prior_sigma_level)
        sigmas = np.array([graph.prior_sigma_level] * 2 + [yaw] + [graph.prior_sigma_position] * 3)
        pose = self._in.states[cluster.stamp].pose
        return pose_prior(pose_key(self._partitions.number(cluster)), pose, sigmas, cluster.stamp)
