"""The factors of a window's candidates; what candidates share is built once."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.candidates.model import (
    HEAD,
    Candidate,
    Cluster,
    Connection,
    CoreMeasurement,
)
from incremental_mapper.config import Config, Strategy
from incremental_mapper.frontend.dead_reckoning import State
from incremental_mapper.frontend.front_end import Prepared, PreparedFix
from incremental_mapper.frontend.gap_matching import LONG
from incremental_mapper.frontend.imu_preintegration import ImuSeries, integrate, preintegrate
from incremental_mapper.frontend.lidar_odometry import PreparedScan
from incremental_mapper.frontend.match_noise import carried
from incremental_mapper.graph.bias_sharing import BiasSharing
from incremental_mapper.graph.connectivity import Partition, Partitions
from incremental_mapper.graph.factors import (
    Factor,
    FactorKind,
    between_factor,
    bias_prior,
    bias_random_walk,
    constant_velocity_prior,
    gnss_factor,
    imu_factor,
    pose_prior,
    pose_sigmas,
    velocity_prior,
)
from incremental_mapper.graph.frontier import Frontier, chain_start
from incremental_mapper.graph.motion_compensation import MotionCompensation
from incremental_mapper.graph.passed_clusters import MotionSigmas, close_factor, passed_factor
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.variables import bias_key, pose_key, velocity_key

UNSEEN_ACCELERATION = 2.0
"""m/s^2 by which a car's acceleration may differ from what the nearest IMU sample says."""
UNSEEN_SPEED = 0.5
"""m/s; deviation of the velocity with which a measurement is moved where there is no IMU: the noise
of a match over 0.1 s is 0.3."""
UNSEEN_TURN = 0.05
"""rad/s; the same of its rate of turn: a match's noise over 0.1 s is 0.03."""
UNSEEN = np.diag(pose_sigmas(UNSEEN_SPEED, UNSEEN_TURN) ** 2)
GAP_NOISE = 5.0
"""So many times the noise of a match has one over a gap: 0.15 to 0.22 m while a simulated car sets
off, where matches at 10 Hz have 0.03 m."""
SHORTEST = NANOSECONDS // 1000
"""Nanoseconds for which velocity and bias may change at the least, so that no sigma is zero."""


@dataclass(frozen=True, slots=True, eq=False)
class WindowInputs:
    """Everything that the factors of a window are made of.

    Attributes:
        prepared: The core measurements with what the front end made of them.
        states: Predicted states at their stamps (ns).
        series: IMU samples that no span has used yet.
        parameters: Noise and gravity of the pre-integration.
        frontier: What G(t-1) lets a factor touch.
        head_state: State of the cluster of G(t-1) to connect from, or the first one of all.
        scan_offsets: T_cluster_scan of each LiDAR's last scan in G(t-1), by sensor and stamp.
        enu_offset: Where ENU's origin lies in the map, (3,) metres; the axes are the same.
        fix_inflation: Extra standard deviations of fixes, horizontal and vertical, by stamp.
        known: How well the motion of ``head_state`` is known.
        bias: Which bias the spans have.
        config: All settings.
    """

    prepared: Mapping[CoreMeasurement, Prepared]
    states: Mapping[int, State]
    series: ImuSeries
    parameters: gtsam.PreintegrationCombinedParams
    frontier: Frontier
    head_state: State
    scan_offsets: Mapping[tuple[str, int], gtsam.Pose3]
    enu_offset: NDArray[np.float64]
    fix_inflation: Mapping[int, tuple[float, float]]
    known: MotionSigmas
    bias: BiasSharing
    config: Config


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
        self._cache: dict[tuple[object, ...], tuple[Factor, ...]] = {}
        odometry = inputs.config.odometry
        self._constant = np.diag(
            pose_sigmas(odometry.sigma_translation, odometry.sigma_rotation) ** 2
        )

    def factors(self, candidate: Candidate, since: int = 0) -> list[Factor]:
        """All factors of a candidate except those that hold unconnected components.

        Args:
            candidate: A candidate of the window.
            since: Index of the first cluster whose factors are wanted; 0 gives all of them.

        Returns:
            Odometry and fixes of the clusters' members, then IMU factors of the connections and
            the clusters that they pass over, then what holds velocity and bias where a chain of
            spans starts, and in the first window the prior.
        """
        partition = self._partitions.of(candidate)
        made: list[Factor] = []
        for cluster in candidate.clusters[since:]:
            if cluster.first not in partition.factors:
                partition.factors[cluster.first] = self._of_cluster(cluster, partition)
            made.extend(partition.factors[cluster.first])
        links = [link for link in candidate.connections if link.end >= since]
        home = self._in.bias.home(candidate, self._partitions.number)
        for link in links:
            made.extend(self._imu(candidate, link.start, link.end, home))
            made.extend(self._passed(candidate, link, home))
        made.extend(self._close(candidate, since))
        made.extend(self._chain_starts(candidate, links))
        new = self._in.bias.new_home(candidate, self._partitions.number)
        if new is not None and candidate.connections[0] in links:
            made.append(self._new_bias(new, candidate.connections[0].start_stamp))
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

    def _ends(self, candidate: Candidate, index: int) -> tuple[int, int]:
        """Cluster number and stamp of one end of a connection."""
        if index == HEAD:
            assert self._in.frontier.head is not None
            return self._in.frontier.head, self._in.frontier.head_stamp
        cluster = candidate.clusters[index]
        return self._partitions.number(cluster), cluster.stamp

    def _imu(
        self, candidate: Candidate, start: int, end: int, home: int | None
    ) -> tuple[Factor, ...]:
        first, first_stamp = self._ends(candidate, start)
        last, last_stamp = self._ends(candidate, end)
        key = ('imu', first, last, home)
        if key not in self._cache:
            series, between = self._in.series, (first_stamp, last_stamp)
            low, high = np.searchsorted(series.stamps, between, side='left')
            span = preintegrate(
                series,
                *between,
                self._in.parameters,
                self._in.head_state.bias,
                constant_bias=home is not None,
            )
            stamps = series.stamps[low:high]
            self._cache[key] = (imu_factor(first, last, span, 'imu', between, stamps, home),)
        return self._cache[key]

    def _passed(self, candidate: Candidate, link: Connection, home: int | None) -> Iterator[Factor]:
        """Hold the clusters that a connection passes over."""
        if not self._in.config.graph.dead_reckoning:
            return
        start, stamp = self._ends(candidate, link.start)
        end, end_stamp = self._ends(candidate, link.end)
        for index in range(link.start + 1, link.end):
            if self._close_behind(candidate, index) is not None:
                continue
            cluster = candidate.clusters[index]
            own = self._partitions.number(cluster)
            key = ('passed', start, own, end, home)
            if key not in self._cache:
                series = self._in.series
                samples = series.within(stamp, cluster.stamp)
                if len(samples.stamps) == 0:
                    samples = series.nearest(stamp)
                span = integrate(
                    samples,
                    stamp,
                    cluster.stamp,
                    self._in.parameters,
                    self._in.head_state.bias,
                    constant_bias=True,
                )
                assert isinstance(span, gtsam.PreintegratedImuMeasurements)
                self._cache[key] = (
                    passed_factor(
                        (start, own, end),
                        (stamp, cluster.stamp, end_stamp),
                        span,
                        start if home is None else home,
                        self._in.config.preintegration,
                        len(samples.stamps),
                    ),
                )
            yield from self._cache[key]

    def _close(self, candidate: Candidate, since: int) -> Iterator[Factor]:
        """Hold the clusters that no IMU sample parts from one with a velocity before them."""
        for index in range(since, len(candidate.clusters)):
            behind = self._close_behind(candidate, index)
            if behind is None:
                continue
            start, stamp = self._ends(candidate, behind)
            cluster = candidate.clusters[index]
            own = self._partitions.number(cluster)
            key = ('close', start, own)
            if key not in self._cache:
                self._cache[key] = (
                    close_factor(
                        (start, own),
                        self._compensation.dead_reckon(stamp),
                        self._compensation.dead_reckon(cluster.stamp),
                        self._in.known,
                        self._in.config.preintegration,
                    ),
                )
            yield from self._cache[key]

    def _close_behind(self, candidate: Candidate, index: int) -> int | None:
        """Index of the last end of a span before a cluster, where no sample lies between.

        It is the same for all candidates that begin alike. The graph of base has no such factors.
        """
        config = self._in.config
        if not config.graph.dead_reckoning or config.selection.strategy == Strategy.BASE:
            return None
        ends = {link.end for link in candidate.connections}
        if index in ends:
            return None
        behind = max((end for end in ends if end < index), default=HEAD)
        if behind == HEAD and not self._in.frontier.head_inertial:
            return None
        since, until = self._ends(candidate, behind)[1], candidate.clusters[index].stamp
        low, high = np.searchsorted(self._in.series.stamps, (since, until), side='left')
        near = until - since <= round(config.preintegration.max_gap * NANOSECONDS)
        return behind if near and low == high else None

    def _chain_starts(self, candidate: Candidate, links: Sequence[Connection]) -> Sequence[Factor]:
        """What holds velocity and bias where one of ``links`` does not go on from an older one.

        A bias that all spans share is held elsewhere.
        """
        ends = {link.end for link in candidate.connections}
        starts = sorted({link.start for link in links} - ends)
        made: list[Factor] = []
        for start in starts:
            if start == HEAD and self._in.frontier.head_inertial:
                continue
            own = self._ends(candidate, start)
            before = max((end for end in ends if end < start), default=HEAD)
            earlier = self._last_inertial() if before == HEAD else self._ends(candidate, before)
            key = ('chain', own, earlier)
            if key not in self._cache:
                self._cache[key] = self._chain_start(own, earlier)
            made.extend(self._cache[key])
        return made

    def _last_inertial(self) -> tuple[int, int] | None:
        """The last cluster of G(t-1) with velocity and bias, and its stamp."""
        frontier = self._in.frontier
        return None if frontier.inertial is None else (frontier.inertial, frontier.inertial_stamp)

    def _chain_start(
        self, own: tuple[int, int], earlier: tuple[int, int] | None
    ) -> tuple[Factor, ...]:
        """Holds velocity and bias of a cluster by those of an earlier one, if there is one.

        Both are given by number and stamp. Without this, a chain that starts anew because two
        clusters have no sample between them would forget what is known of velocity and bias.
        """
        id_, stamp = own
        graph, imu = self._in.config.graph, self._in.config.preintegration
        before = None if earlier is None else earlier[1]
        kinds = chain_start(before, stamp, round(imu.max_gap * NANOSECONDS))
        made: list[Factor] = []
        if FactorKind.PRIOR_VELOCITY in kinds:
            sigma = graph.prior_sigma_velocity if earlier is None else graph.weak_sigma_velocity
            state = self._in.states.get(stamp, self._in.head_state)
            made.append(velocity_prior(velocity_key(id_), state.velocity, sigma, stamp))
        shared = self._in.bias.shared
        if earlier is None:
            if shared:
                return tuple(made)
            return (*made, bias_prior(bias_key(id_), self._in.head_state.bias, graph, stamp))
        passed = max(stamp - earlier[1], SHORTEST) / NANOSECONDS
        stamps = (earlier[1], stamp)
        if FactorKind.CONSTANT_VELOCITY in kinds:
            keys = (velocity_key(earlier[0]), velocity_key(id_))
            begin = max(earlier[1], self._in.head_state.stamp)
            change = (
                self._compensation.dead_reckon(stamp).velocity
                - self._compensation.dead_reckon(begin).velocity
            )
            made.append(constant_velocity_prior(keys, change, UNSEEN_ACCELERATION * passed, stamps))
        if not shared:
            made.append(self._walk(earlier, own))
        return tuple(made)

    def _new_bias(self, home: int, stamp: int) -> Factor:
        """Hold a bias that serves the spans from ``stamp`` (ns) on by the one before it."""
        frontier = self._in.frontier
        if frontier.bias is None:
            bias = self._in.head_state.bias
            return bias_prior(bias_key(home), bias, self._in.config.graph, stamp)
        key = ('bias', home, stamp)
        if key not in self._cache:
            earlier = frontier.bias, frontier.bias_stamp
            self._cache[key] = (self._walk(earlier, (home, stamp)),)
        return self._cache[key][0]

    def _walk(self, first: tuple[int, int], second: tuple[int, int]) -> Factor:
        """The random walk between two biases, each given by its cluster's number and a stamp."""
        imu = self._in.config.preintegration
        passed = max(second[1] - first[1], SHORTEST) / NANOSECONDS
        walks = [imu.accelerometer_bias_walk] * 3 + [imu.gyroscope_bias_walk] * 3
        keys = (bias_key(first[0]), bias_key(second[0]))
        sigmas = np.sqrt(passed) * np.array(walks)
        return bias_random_walk(keys, sigmas, (first[1], second[1]))

    def _first_prior(self, cluster: Cluster) -> Factor:
        """Prior that holds the map's first pose: level well, yaw loosely."""
        graph = self._in.config.graph
        sigmas = np.array(
            [graph.prior_sigma_level] * 2
            + [graph.prior_sigma_yaw]
            + [graph.prior_sigma_position] * 3
        )
        pose = self._in.states[cluster.stamp].pose
        return pose_prior(pose_key(self._partitions.number(cluster)), pose, sigmas, cluster.stamp)
