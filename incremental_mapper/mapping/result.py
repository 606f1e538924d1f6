"""What a window and a run give back."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.candidates.model import Candidate
from incremental_mapper.graph.factors import Factor
from incremental_mapper.graph.values import pose_key
from incremental_mapper.selection.choice import Tried
from incremental_mapper.smoothing.graph_state import PlacedCluster, PlacedScan
from incremental_mapper.trajectory import Trajectory


@dataclass(frozen=True, slots=True, eq=False)
class WindowResult:
    """One window: the winner and the numbers that windows.csv shows.

    ``row`` holds the columns of windows.csv. ``clusters`` are the new clusters and ``poses``
    their T_map_base right after the window. ``winner`` is None where nothing was appended;
    ``tried`` are all candidates that it was chosen from.
    """

    index: int
    start: int
    end: int
    winner: Candidate | None
    clusters: tuple[PlacedCluster, ...]
    poses: tuple[gtsam.Pose3, ...]
    row: dict[str, Any]
    tried: tuple[Tried, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class NewestState:
    """Pose T_map_base and velocity (3,) m/s in the map at ``stamp`` (ns).

    ``covariance`` (6, 6) is in base_link and in GTSAM's order, rotation before translation; None
    where the graph does not determine it.
    """

    stamp: int
    pose: gtsam.Pose3
    covariance: NDArray[np.float64] | None
    velocity: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class MapResult:
    """A finished run.

    ``fixes`` (K, 3) are the used antenna positions in the map; ``stats`` the keys of stats.json.
    """

    clusters: tuple[PlacedCluster, ...]
    factors: tuple[Factor, ...]
    values: gtsam.Values
    trajectory: Trajectory
    scans: tuple[PlacedScan, ...]
    fixes: NDArray[np.float64]
    rows: tuple[dict[str, Any], ...]
    stats: dict[str, Any] = field(default_factory=dict)

    def placed_scans(self) -> Iterator[tuple[NDArray[np.float32], NDArray[np.float64]]]:
        """Points (N, 3) in base_link and T_map_base (4, 4) of every scan."""
        for scan in self.scans:
            pose = self.values.atPose3(pose_key(scan.cluster)).compose(scan.T_cluster_scan)
            yield scan.points, pose.matrix()
