"""Initial guesses: the values from which a window's candidates are solved."""

from collections.abc import Mapping

import gtsam

from incremental_mapper.candidates.model import HEAD, Candidate
from incremental_mapper.frontend.dead_reckoning import State, normalise
from incremental_mapper.graph.bias_sharing import BiasSharing
from incremental_mapper.graph.connectivity import Partitions
from incremental_mapper.graph.frontier import Frontier
from incremental_mapper.variables import bias_key, insert_bias, pose_key, velocity_key


class InitialGuess:
    """Values of a window's new variables, from the predicted states or from a solved candidate."""

    def __init__(
        self,
        states: Mapping[int, State],
        head_state: State,
        frontier: Frontier,
        partitions: Partitions,
        bias: BiasSharing,
    ) -> None:
        """Nothing is computed before it is asked for.

        Args:
            states: Predicted states by stamp (ns).
            head_state: State of the cluster of G(t-1) to connect from.
            frontier: What G(t-1) lets a factor touch.
            partitions: The numbers of the window's clusters.
            bias: Which bias the window's spans have.
        """
        self._states = states
        self._head_state = head_state
        self._frontier = frontier
        self._partitions = partitions
        self._bias = bias

    def values(self, candidate: Candidate) -> gtsam.Values:
        """Initial values of a candidate's new variables, from the predicted states.

        Args:
            candidate: A candidate of the window.

        Returns:
            Its poses, and velocity and bias where its connections need them.
        """
        values = gtsam.Values()
        self.add(candidate, values)
        return values

    def add(
        self,
        candidate: Candidate,
        values: gtsam.Values,
        states: Mapping[int, State] | None = None,
    ) -> None:
        """Insert those of a candidate's new variables that are not there yet.

        Args:
            candidate: A candidate of the window.
            values: Where they are inserted.
            states: States at the clusters' stamps (ns); by default the predicted ones.
        """
        states = self._states if states is None else states
        inertial = candidate.inertial_clusters
        for index, cluster in enumerate(candidate.clusters):
            own, state = self._partitions.number(cluster), states[cluster.stamp]
            if not values.exists(pose_key(own)):
                values.insert(pose_key(own), state.pose)
            if index in inertial:
                self._add_inertial(own, state, values)
        # A candidate may give velocity and bias to a cluster of G(t-1).
        if HEAD in inertial and not self._frontier.head_inertial:
            head = self._frontier.head
            assert head is not None
            self._add_inertial(head, self._head_state, values)
        new = self._bias.new_home(candidate, self._partitions.number)
        if new is not None and not values.exists(bias_key(new)):
            insert_bias(values, bias_key(new), self._head_state.bias)

    def _add_inertial(self, cluster: int, state: State, values: gtsam.Values) -> None:
        if not values.exists(velocity_key(cluster)):
            values.insert(velocity_key(cluster), state.velocity)
            if not self._bias.shared:
                insert_bias(values, bias_key(cluster), state.bias)

    def warm_start(self, candidate: Candidate, values: gtsam.Values) -> dict[int, State]:
        """States at the window's stamps, put right by a solved candidate.

        Where it has no cluster, a state differs from the predicted one as the nearest does.

        Args:
            candidate: The candidate that was solved.
            values: Its solution.

        Returns:
            States by stamp (ns), from which the next candidates are solved.
        """
        found: dict[int, State] = {}
        solved = {cluster.stamp: self._partitions.number(cluster) for cluster in candidate.clusters}
        inertial = {
            candidate.clusters[index].stamp
            for index in candidate.inertial_clusters
            if index != HEAD
        }
        home = self._bias.home(candidate, self._partitions.number)
        for stamp, predicted in self._states.items():
            near = min(solved, key=lambda other: abs(other - stamp))
            before = self._states[near]
            pose = values.atPose3(pose_key(solved[near]))
            velocity, bias = predicted.velocity, predicted.bias
            if near != stamp:
                pose = pose.compose(before.pose.between(predicted.pose))
            if inertial:
                near = min(inertial, key=lambda other: abs(other - stamp))
                own = solved[near]
                change = predicted.velocity - self._states[near].velocity
                velocity = values.atVector(velocity_key(own)) + change
                biased = own if home is None else home
                # A solution holds new variables alone: the bias of G(t-1) may not be among them.
                if values.exists(bias_key(biased)):
                    bias = values.atConstantBias(bias_key(biased))
            found[stamp] = State(stamp, normalise(pose), velocity, bias)
        return found
