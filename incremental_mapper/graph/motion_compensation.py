"""Motion compensation: where a measurement of a merged cluster stands in its cluster.

The paper uses every member as if it had been taken at the cluster's stamp. With
``graph.motion_compensation`` it is moved there by the motion that dead reckoning predicts.
"""

import gtsam

from incremental_mapper.candidates.model import Cluster
from incremental_mapper.frontend.dead_reckoning import NO_TURNS, State, Turns, propagate
from incremental_mapper.frontend.imu_preintegration import ImuSeries
from incremental_mapper.measurements import NANOSECONDS


class MotionCompensation:
    """Dead reckoning from one state, and the offsets of cluster members that follow from it."""

    def __init__(
        self,
        start: State,
        series: ImuSeries,
        parameters: gtsam.PreintegrationCombinedParams,
        max_gap: int,
        enabled: bool,
        turns: Turns = NO_TURNS,
    ) -> None:
        """Nothing is computed before it is asked for.

        Args:
            start: State to start from, that of the cluster of G(t-1) to connect from.
            series: IMU samples of the window.
            parameters: Noise and gravity of the pre-integration.
            max_gap: Longest hole in the samples, ns, that the IMU may be used across.
            enabled: Whether members are moved; else every offset is the identity.
            turns: How the car turned, where the IMU has holes.
        """
        self._start = start
        self._series = series
        self._parameters = parameters
        self._max_gap = max_gap
        self._enabled = enabled
        self._turns = turns
        self._offsets: dict[tuple[int, int], gtsam.Pose3] = {}
        self._states: dict[int, State] = {}

    def offset(self, cluster: Cluster, stamp: int) -> gtsam.Pose3:
        """Where a member stands in its cluster.

        Args:
            cluster: The cluster; its pose is that of base_link at its stamp.
            stamp: Stamp of the member, ns.

        Returns:
            T_cluster_member: base_link at ``stamp`` seen from base_link at the cluster's stamp.
        """
        if not self._enabled or stamp == cluster.stamp:
            return gtsam.Pose3()
        key = (cluster.stamp, stamp)
        if key not in self._offsets:
            # Dead reckoning from one state keeps the noise of single matches out of this.
            at = [self.dead_reckon(moment) for moment in key]
            self._offsets[key] = at[0].pose.between(at[1].pose)
        return self._offsets[key]

    def unseen(self, cluster: Cluster, stamp: int) -> float:
        """Seconds of the way from a cluster to a member that no IMU covers.

        Args:
            cluster: The cluster.
            stamp: Stamp of the member, ns.
        """
        if not self._enabled or stamp == cluster.stamp:
            return 0.0
        ends = [self.dead_reckon(moment).unseen for moment in (cluster.stamp, stamp)]
        return min(abs(ends[1] - ends[0]), abs(stamp - cluster.stamp) / NANOSECONDS)

    def dead_reckon(self, stamp: int) -> State:
        """The state at ``stamp`` (ns), from the IMU, and across its holes from the matches."""
        if stamp not in self._states:
            self._states[stamp] = propagate(
                self._start, stamp, self._series, self._parameters, self._max_gap, self._turns
            )
        return self._states[stamp]
