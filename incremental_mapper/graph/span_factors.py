"""The factors of IMU spans: the spans, what they pass over, and how a chain of them starts."""

from collections.abc import Iterator, Sequence

import gtsam
import numpy as np

from incremental_mapper.candidates.model import HEAD, Candidate, Connection
from incremental_mapper.config import Strategy
from incremental_mapper.frontend.imu_preintegration import integrate, preintegrate
from incremental_mapper.graph.connectivity import Partitions
from incremental_mapper.graph.factors import (
    Factor,
    FactorKind,
    bias_prior,
    bias_random_walk,
    constant_velocity_prior,
    imu_factor,
    velocity_prior,
)
from incremental_mapper.graph.frontier import chain_start
from incremental_mapper.graph.motion_compensation import MotionCompensation
from incremental_mapper.graph.passed_clusters import close_factor, passed_factor
from incremental_mapper.graph.window_inputs import WindowInputs
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.variables import bias_key, velocity_key

UNSEEN_ACCELERATION = 2.0
"""m/s^2 by which a car's acceleration may differ from what the nearest IMU sample says."""
SHORTEST = NANOSECONDS // 1000
"""Nanoseconds for which velocity and bias may change at the least, so that no sigma is zero."""


class SpanFactors:
    """Builds what connections bring; candidates that share a span share its factors."""

    def __init__(
        self, inputs: WindowInputs, partitions: Partitions, compensation: MotionCompensation
    ) -> None:
        """Nothing is built before it is asked for.

        Args:
            inputs: Everything that the factors of the window are made of.
            partitions: The numbers of the window's clusters.
            compensation: Dead reckoning through the window.
        """
        self._in = inputs
        self._partitions = partitions
        self._compensation = compensation
        self._cache: dict[tuple[object, ...], tuple[Factor, ...]] = {}

    def factors(self, candidate: Candidate, since: int) -> Iterator[Factor]:
        """What a candidate's connections bring.

        Args:
            candidate: A candidate of the window.
            since: Index of the first cluster whose factors are wanted; 0 gives all of them.

        Yields:
            IMU factors of the connections with the clusters that they pass over, then what holds
            clusters close behind others, velocity and bias where a chain starts, and a new bias.
        """
        links = [link for link in candidate.connections if link.end >= since]
        home = self._in.bias.home(candidate, self._partitions.number)
        for link in links:
            yield from self._imu(candidate, link.start, link.end, home)
            yield from self._passed(candidate, link, home)
        yield from self._close(candidate, since)
        yield from self._chain_starts(candidate, links)
        new = self._in.bias.new_home(candidate, self._partitions.number)
        if new is not None and candidate.connections[0] in links:
            yield self._new_bias(new, candidate.connections[0].start_stamp)

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
            low, high = series.stamps.searchsorted(between).tolist()
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
        low, high = self._in.series.stamps.searchsorted((since, until)).tolist()
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
