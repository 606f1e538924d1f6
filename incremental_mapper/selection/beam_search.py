"""Search for windows with more candidates than can be enumerated: a beam over prefixes.

A prefix is a candidate of the window's first elements, in time order. The best few prefixes of
every length are extended by one more cluster, connected or not; G(t-1) and a prefix together are
a prior over a handful of variables, so an extension costs the same wherever in the window it is
made. A prefix is judged by the same criterion as a candidate, with the scans that it has not
placed yet where dead reckoning from its last cluster puts them.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import TypeAlias

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.candidates.model import HEAD, Candidate, Cluster, Connection
from incremental_mapper.candidates.partitions import make_cluster
from incremental_mapper.scoring.criteria import Criterion, Proposal
from incremental_mapper.selection.window_problem import WindowProblem
from incremental_mapper.smoothing.marginal_prior import MarginalPrior, marginalise
from incremental_mapper.smoothing.smoother import smoother_update
from incremental_mapper.variables import bias_key, copy_value, pose_key, velocity_key

MakeCriterion: TypeAlias = Callable[[WindowProblem, Sequence[Proposal], bool], Criterion]
"""Makes a window's criterion for some candidates; the last argument asks for exact values."""

SHAKE = 0.04
"""Metres that scans are expected to move against each other between the prefixes of a window."""
FINALISTS = 240
"""Elements in the complete candidates that are handed on, to be solved and scored together:
the longer a window, the more each of them costs."""


@dataclass(frozen=True, slots=True, eq=False)
class Prefix:
    """A candidate of the first ``position`` elements.

    ``node`` is the index of the cluster that the chain of connections goes on from (HEAD for
    G(t-1), None before there is one). ``cost`` is Σ‖h(x)−z‖² so far, with what the prefix moves
    in G(t-1).
    """

    position: int
    candidate: Candidate
    node: int | None
    prior: MarginalPrior
    cost: float


def beam_search(
    problem: WindowProblem, make_criterion: MakeCriterion, width: int, seconds: float
) -> list[Candidate]:
    """The most promising complete candidates.

    Args:
        problem: The window.
        make_criterion: Makes the criterion that judges prefixes and candidates alike.
        width: Prefixes of every length that are kept.
        seconds: Fewer are kept as soon as the search would else take longer.

    Returns:
        Complete candidates, best first; empty where no prefix got through.
    """
    return _Search(problem, make_criterion, width, seconds).run()


class _Search:
    def __init__(
        self, problem: WindowProblem, make_criterion: MakeCriterion, width: int, seconds: float
    ) -> None:
        self._problem = problem
        self._frontier = problem.inputs.frontier
        self._most = width
        self._seconds = seconds
        self._initial = gtsam.Values()  # of every variable that any prefix has
        self._clusters: dict[tuple[int, int], Cluster | None] = {}
        # The last element with a scan that is matched to an earlier one, by that one.
        self._continued = {
            scan: index
            for index, element in enumerate(problem.elements)
            for scan in problem.factors.continued_scans(element)
        }
        self._criterion = self._make(make_criterion)

    def run(self) -> list[Candidate]:
        problem, count = self._problem, len(self._problem.elements)
        start = Candidate((), ())
        node = None if problem.head is None else HEAD
        layers: list[list[Prefix]] = [[] for _ in range(count + 1)]
        layers[0].append(Prefix(0, start, node, problem.prior, 0.0))
        began, extended = time.perf_counter(), 0
        for position in range(count):
            layer, layers[position] = layers[position], []
            for prefix in self._best(layer, self._width(position, began, extended)):
                for longer in self._extensions(prefix):
                    layers[longer.position].append(longer)
                    extended += 1
        return [
            prefix.candidate for prefix in self._best(layers[count], max(FINALISTS // count, 8))
        ]

    def _best(self, layer: list[Prefix], count: int) -> list[Prefix]:
        """The best ``count`` of prefixes of the same length, best first."""
        if not layer:
            return []
        proposals = [
            Proposal(prefix.candidate, prefix.cost, partial(self._poses, prefix))
            for prefix in layer
        ]
        scores = self._criterion.scores(proposals)
        order = sorted(range(len(layer)), key=lambda i: (scores[i], layer[i].candidate.vertices))
        return [layer[i] for i in order[:count]]

    def _width(self, position: int, began: float, extended: int) -> int:
        """How many prefixes of this length to extend, at the pace so far."""
        width = self._most
        if extended == 0:
            return width
        spent = time.perf_counter() - began
        left = max(self._seconds - spent, 0.0)
        layers = len(self._problem.elements) - position
        # One prefix has had so many extensions on average, each of them so long.
        branching = extended / max(position, 1) / width
        affordable = left / layers / (spent / extended) / max(branching, 1.0)
        return int(np.clip(affordable, 1, width))

    def _extensions(self, prefix: Prefix) -> Iterator[Prefix]:
        """The prefix with one more cluster, in every way that may still come out connected."""
        count = len(self._problem.elements)
        for last in range(prefix.position, count):
            cluster = self._cluster(prefix.position, last)
            if cluster is None:
                return
            if cluster.time_range and not self._problem.may_merge:
                return
            # The chain of connections visits the cluster, or goes on from the node before it;
            # the window's last cluster is always visited.
            index = len(prefix.candidate.clusters)
            yield from self._extended(prefix, cluster, self._link(prefix, cluster), index)
            if last + 1 < count and self._goes_on(prefix, last + 1):
                yield from self._extended(prefix, cluster, None, prefix.node)

    def _goes_on(self, prefix: Prefix, position: int) -> bool:
        """Whether a cluster from ``position`` on can be connected to the prefix's node."""
        stamp = self._node_stamp(prefix)
        later = (part[0].stamp for part in self._problem.elements[position:])
        return stamp is not None and any(
            self._problem.imu.first_sample(stamp, other) is not None for other in later
        )

    def _node_stamp(self, prefix: Prefix) -> int | None:
        if prefix.node is None:
            return None
        if prefix.node == HEAD:
            return self._problem.head
        return prefix.candidate.clusters[prefix.node].stamp

    def _link(self, prefix: Prefix, cluster: Cluster) -> Connection | None:
        stamp = self._node_stamp(prefix)
        if stamp is None or prefix.node is None:
            return None
        first = self._problem.imu.first_sample(stamp, cluster.stamp)
        if first is None:
            return None
        end = len(prefix.candidate.clusters)
        return Connection(prefix.node, end, stamp, cluster.stamp, first)

    def _extended(
        self, prefix: Prefix, cluster: Cluster, link: Connection | None, node: int | None
    ) -> Iterator[Prefix]:
        candidate = Candidate(
            (*prefix.candidate.clusters, cluster),
            prefix.candidate.connections if link is None else (*prefix.candidate.connections, link),
            self._problem.imu.bias,
        )
        if link is None and not self._can_connect(candidate, cluster, node):
            return
        factors, number = self._problem.factors, self._problem.partitions.number
        made = [
            factor.factor
            for factor in factors.factors(candidate, since=len(prefix.candidate.clusters))
        ]
        self._problem.guess.add(candidate, self._initial)
        fresh = gtsam.Values()
        local = number(cluster)
        own = {pose_key(local)}
        for key in own.union(*(factor.keys() for factor in made)):
            if not prefix.prior.base.exists(key):
                copy_value(self._initial, key, fresh)
        grown, cost = smoother_update(
            prefix.prior,
            made,
            fresh,
            {local: cluster.stamp},
            self._problem.config.graph.max_iterations,
        )
        if not grown.healthy:
            return
        prior, _ = marginalise(grown, self._needed(candidate, node), np.iinfo(np.int64).min)
        yield Prefix(cluster.last + 1, candidate, node, prior, prefix.cost + cost)

    def _can_connect(self, candidate: Candidate, cluster: Cluster, node: int | None) -> bool:
        """Whether an unlinked cluster hangs, or may come to hang, on something else."""
        if node == len(candidate.clusters) - 1:
            return True  # the chain goes on from here
        if len(candidate.clusters) == 1 and self._problem.head is None:
            return True
        return any(
            self._problem.factors.has_odometry(core) or (core.sensor, core.stamp) in self._continued
            for core in cluster.members
        )

    def _needed(self, candidate: Candidate, node: int | None) -> set[int]:
        """Variables that later factors may touch."""
        number = self._problem.partitions.number
        homes = self._problem.partitions.of(candidate).homes
        newest: dict[str, int] = {}
        for sensor, stamp in homes:
            newest[sensor] = max(stamp, newest.get(sensor, stamp))
        needed = {pose_key(homes[sensor, stamp]) for sensor, stamp in newest.items()}
        # A scan with too few points is the newest one, and the next is matched to the one before.
        placed = candidate.clusters[-1].last
        needed |= {
            pose_key(homes[scan])
            for scan, element in self._continued.items()
            if element > placed and scan in homes
        }
        # A chain that starts anew goes on from the last velocity and bias.
        inertial = set[int]()
        if candidate.connections:
            last = number(candidate.clusters[candidate.connections[-1].end])
            inertial.add(last)
            needed.add(pose_key(last))  # a cluster close behind it hangs on it
        elif self._frontier.inertial is not None:
            inertial.add(self._frontier.inertial)
            if self._frontier.head is not None and self._frontier.head_inertial:
                needed.add(pose_key(self._frontier.head))
        if node is not None:
            if node == HEAD:
                assert self._frontier.head is not None
                own = self._frontier.head
            else:
                own = number(candidate.clusters[node])
            needed.add(pose_key(own))
            inertial.add(own)
            if self._problem.config.graph.dead_reckoning:
                # The span that will pass over these says where they are.
                passed = candidate.clusters[node + 1 :]
                needed |= {pose_key(number(cluster)) for cluster in passed}
        needed |= {velocity_key(cluster) for cluster in inertial}
        sharing = self._problem.inputs.bias
        if sharing.shared:
            home = sharing.home(candidate, number)
            biased = {self._frontier.bias if home is None else home}
        else:
            biased = set(inertial)
        return needed | {bias_key(cluster) for cluster in biased if cluster is not None}

    def _cluster(self, first: int, last: int) -> Cluster | None:
        if (first, last) not in self._clusters:
            self._clusters[first, last] = make_cluster(self._problem.elements, first, last)
        return self._clusters[first, last]

    def _poses(self, prefix: Prefix) -> NDArray[np.float64]:
        """Poses of all moving scans, those of the rest of the window by dead reckoning."""
        states, number = self._problem.inputs.states, self._problem.partitions.number
        values = prefix.prior.values
        clusters = list(prefix.candidate.clusters)
        correction = gtsam.Pose3()
        if clusters:
            last = clusters[-1]
            before = states[last.stamp].pose
            correction = values.atPose3(pose_key(number(last))).compose(before.inverse())
        for index in range(prefix.position, len(self._problem.elements)):
            single = self._cluster(index, index)
            assert single is not None
            pose = correction.compose(states[single.stamp].pose)
            values.insert(pose_key(number(single)), pose)
            clusters.append(single)

        def pose_of(key: int) -> gtsam.Pose3 | None:
            return values.atPose3(key) if values.exists(key) else None

        return self._problem.local_maps.poses(Candidate(tuple(clusters), ()), pose_of)

    def _make(self, make_criterion: MakeCriterion) -> Criterion:
        """The criterion for prefixes, which nobody knows yet where they will put the scans.

        It foresees them near dead reckoning; the finalists are judged exactly, elsewhere.
        """
        start = Prefix(0, Candidate((), ()), None, self._problem.prior, 0.0)

        @cache
        def foreseen() -> list[NDArray[np.float64]]:
            poses = self._poses(start)
            return [poses, *_shaken(poses)]

        proposals = [
            Proposal(start.candidate, None, lambda which=which: foreseen()[which])  # type: ignore[misc]
            for which in range(3)
        ]
        return make_criterion(self._problem, proposals, False)


def _shaken(poses: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Poses (S, 4, 4) moved by SHAKE metres to either side, every other scan the other way."""
    steps = np.zeros((len(poses), 3))
    steps[:, 2] = steps[:, 0] = SHAKE * np.where(np.arange(len(poses)) % 2, 0.5, -0.5)
    shaken = []
    for sign in (-1.0, 1.0):
        moved = poses.copy()
        moved[:, :3, 3] += sign * steps
        shaken.append(moved)
    return shaken
