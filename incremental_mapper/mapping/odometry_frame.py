"""The pose in a frame that does not jump when the map is corrected (REP-105's ``odom``)."""

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.config import OdometrySettings
from incremental_mapper.graph.factors import pose_sigmas
from incremental_mapper.mapping.newest_state import NewestState
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.smoothing.graph_state import GraphState

STEP = 0.1
"""Seconds of a step that is as uncertain as a match; over a longer one the car is seen less."""


@dataclass(frozen=True, slots=True, eq=False)
class OdometryPose:
    """Where the car is in the continuous frame at the newest cluster.

    Attributes:
        pose: T_odom_base.
        covariance: Of all that was added up since the frame began (6, 6), in base_link and in
            GTSAM's order, rotation before translation. It grows without bound.
        T_map_odom: Where the frame lies in the map now; this one jumps.
    """

    pose: gtsam.Pose3
    covariance: NDArray[np.float64]
    T_map_odom: gtsam.Pose3


class OdometryFrame:
    """Adds up the steps of the newest cluster, each as one estimate of both its ends has it.

    A correction of the map moves both ends, so the pose does not jump with it. A fix that
    disagrees with scan matching moves the newest step by no more than its robust loss lets it:
    three standard deviations of the fix pull as much as a match gives way, a few centimetres.
    """

    def __init__(self, settings: OdometrySettings) -> None:
        """Begin a frame; ``settings`` tell how far a match may be off."""
        self._variances = pose_sigmas(settings.sigma_translation, settings.sigma_rotation) ** 2
        self._last: tuple[int, int] | None = None  # number and stamp
        self._pose = gtsam.Pose3()
        self._covariance: NDArray[np.float64] = np.zeros((6, 6))

    def follow(self, state: GraphState, newest: NewestState) -> OdometryPose:
        """Take the next step.

        Args:
            state: G(t).
            newest: Its newest state.

        Returns:
            The pose at the newest state.
        """
        cluster = state.frontier.newest
        assert cluster is not None
        if self._last is None:
            self._pose = newest.pose
        else:
            before, stamp = self._last
            step = state.pose(before).between(newest.pose)
            steps = max((newest.stamp - stamp) / (STEP * NANOSECONDS), 0.0)
            back = step.inverse().AdjointMap()
            # What is unseen for twice as long is twice as uncertain; short steps are matches too.
            added = np.diag(self._variances) * max(steps, 1.0) ** 2 * (steps > 0.0)
            self._covariance = back @ self._covariance @ back.T + added
            self._pose = self._pose.compose(step)
        self._last = cluster, newest.stamp
        T_map_odom = newest.pose.compose(self._pose.inverse())
        return OdometryPose(self._pose, self._covariance, T_map_odom)
