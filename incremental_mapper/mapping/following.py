"""What is told of a mapper's windows, whoever is told: the newest state, and the new scans."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.mapping.live_map import LiveMap
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.mapping.newest_state import NewestState
from incremental_mapper.mapping.odometry_frame import OdometryFrame, OdometryPose
from incremental_mapper.mapping.result import MapResult, WindowResult
from incremental_mapper.smoothing.graph_state import PlacedScan


@dataclass(frozen=True, slots=True, eq=False)
class PoseUpdate:
    """Where the car is, as soon as a window is solved."""

    newest: NewestState
    odometry: OdometryPose

    @property
    def numbers(self) -> dict[str, NDArray[np.float64] | None]:
        """All numbers that messages of it are made of, by name; None where one is not known."""
        newest, odometry = self.newest, self.odometry
        return {
            'pose': newest.pose.matrix(),
            'covariance': newest.covariance,
            'velocity': newest.velocity,
            'velocity_covariance': newest.velocity_covariance,
            'rate': newest.rate,
            'rate_covariance': newest.rate_covariance,
            'pose_in_odom': odometry.pose.matrix(),
            'covariance_in_odom': odometry.covariance,
        }


class Follower:
    """Follows a mapper; every window is to be told of once, in their order."""

    def __init__(self, mapper: Mapper, earlier: MapResult | None = None) -> None:
        """Begin; ``earlier`` is the map before, see ``LiveMap``."""
        self.live = LiveMap(mapper, earlier)
        self._mapper = mapper
        self._odometry = OdometryFrame(mapper.config.odometry)
        self._scans = 0

    def pose(self, result: WindowResult) -> PoseUpdate | None:
        """The newest state; None where a window appended nothing."""
        newest = self._mapper.newest() if result.clusters or result.joined else None
        if newest is None:
            return None
        return PoseUpdate(newest, self._odometry.follow(self._mapper.state, newest))

    def new_scans(self) -> Sequence[PlacedScan]:
        """Let the live map follow; returns the scans that came since the last call."""
        self.live.follow()
        scans = self._mapper.state.scans
        before, self._scans = self._scans, len(scans)
        return scans[before:]
