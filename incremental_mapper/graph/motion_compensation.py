"""Motion compensation: where a measurement of a merged cluster stands in its cluster.

The paper uses every member as if it had been taken at the cluster's stamp. With
``graph.motion_compensation`` it is moved there by the motion that dead reckoning predicts.
"""

import gtsam

from incremental_mapper.candidates.model import Cluster
from incremental_mapper.frontend.dead_reckoning import State, propagate
from incremental_mapper.frontend.imu_preintegration import ImuSeries


class MotionCompensation:
    """Dead reckoning from one state, and the offsets of cluster members that follow from it."""

    def __init__(
        self,
        start: State,
        series: ImuSeries,
        parameters: gtsam.PreintegrationCombinedParams,
        max_gap: int,
        enabled: bool,
    ) -> None:
        """Nothing is computed before it is asked for.

        Args:
            start: State to start from, that of the cluster of G(t-1) to connect from.
            series: IMU samples of the window.
            parameters: Noise and gravity of the pre-integration.
            max_gap: Longest hole in the samples, ns, that the IMU may be used across.
            enabled: Whether members are moved; else every offset is the identity.
        """
        self._start = start
        self._series = series
        self._parameters = parameters
        self._max_gap = max_gap
        self._enabled = enabled
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

    def dead_reckon(self, stamp: int) -> State:
        """The state at ``stamp`` (ns), from the IMU alone."""
        if stamp not in self._states:
            self._states[stamp] = propagate(
                self._start, stamp, self._series, self._parameters, self._max_gap
            )
        return self._states[stamp]
