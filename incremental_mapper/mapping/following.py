"""What is told of a mapper's windows, whoever is told: the newest state, and the new scans."""

from collections.abc import Sequence
from dataclasses import dataclass

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
