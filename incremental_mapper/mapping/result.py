"""What a window and a run give back."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.candidates.model import Candidate
from incremental_mapper.checks.finding import Finding
from incremental_mapper.config import MapSettings
from incremental_mapper.errors import OutputError
from incremental_mapper.graph.factors import Factor
from incremental_mapper.map.cloud import Placed, accumulate
from incremental_mapper.map.ply import MapCloud, ScanTable
from incremental_mapper.mapping.statistics import MapStatistics
from incremental_mapper.selection.choice import Tried
from incremental_mapper.selection.window_record import WindowRecord
from incremental_mapper.smoothing.graph_state import GraphState, PlacedCluster, PlacedScan
from incremental_mapper.trajectory import Trajectory, from_matrices
from incremental_mapper.variables import pose_key


@dataclass(frozen=True, slots=True, eq=False)
class WindowResult:
    """One window: the winner and the numbers that windows.csv shows.

    ``row`` holds the columns of windows.csv. ``clusters`` are the new clusters and ``poses``
    their T_map_base right after the window. ``winner`` is None where nothing was appended;
    ``joined`` counts the measurements that joined the newest cluster, since the vehicle stood;
    ``tried`` are all candidates that it was chosen from.
    """

    index: int
    start: int
    end: int
    winner: Candidate | None
    clusters: tuple[PlacedCluster, ...]
    poses: tuple[gtsam.Pose3, ...]
    row: dict[str, Any]
    joined: int = 0
    tried: tuple[Tried, ...] = ()


@dataclass(frozen=True, slots=True)
class Session:
    """A part of a map that was driven by itself: its input, and how much of the map it is.

    ``windows``, ``clusters`` and ``drive_s`` (seconds) are counts; sessions follow each other in
    the map. ``joined_by`` says what relates it to those before: ``fixes``, or '' of the first one.
    """

    input: str
    windows: int
    clusters: int
    drive_s: float
    joined_by: str = ''


@dataclass(frozen=True, slots=True, eq=False)
class MapResult:
    """A finished run.

    Attributes:
        clusters: All clusters of G(t), each at the place of its number.
        factors: All its factors.
        values: Newest estimate of all its variables.
        trajectory: T_map_base at the cluster stamps, and where the vehicle stood also at the end
            of each window.
        scans: The scans of the map with the clusters that hold them.
        fixes: Antenna positions (K, 3) of the used fixes, metres in the map.
        rows: The rows of ``windows.csv``.
        statistics: What the mapper counted.
        findings: What is wrong with the measurements or the map, the worst first.
        failed: The inputs of windows that failed; the first few of them.
        sessions: The sessions that it was made in, the oldest first; none where it is one.
    """

    clusters: tuple[PlacedCluster, ...]
    factors: tuple[Factor, ...]
    values: gtsam.Values
    trajectory: Trajectory
    scans: tuple[PlacedScan, ...]
    fixes: NDArray[np.float64]
    rows: tuple[dict[str, Any], ...]
    statistics: MapStatistics
    findings: tuple[Finding, ...] = ()
    failed: tuple[WindowRecord, ...] = ()
    sessions: tuple['Session', ...] = ()

    def placed_scans(
        self, unreadable: list[str] | None = None
    ) -> Iterator[tuple[NDArray[np.float32], NDArray[np.float64]]]:
        """Go through the scans.

        Args:
            unreadable: Takes why scans cannot be read back; they are left out. Where it is None,
                the first one raises.

        Yields:
            Points (N, 3) in base_link, (N, 4) with intensity where the LiDAR measures it, and
            T_map_base (4, 4) of every scan, metres.

        Raises:
            OutputError: A scan cannot be read back.
        """
        for points, pose, _ in self._placed(unreadable):
            yield points, pose

    def _placed(self, unreadable: list[str] | None) -> Iterator[Placed]:
        for number, scan in enumerate(self.scans):
            try:
                points = scan.cloud
            except OutputError as error:
                if unreadable is None:
                    raise
                unreadable.append(str(error))
                continue
            pose = self.values.atPose3(pose_key(scan.cluster)).compose(scan.T_cluster_scan)
            yield points, pose.matrix(), number

    def _in_range(self, unreadable: list[str] | None, settings: MapSettings) -> Iterator[Placed]:
        for points, pose, number in self._placed(unreadable):
            near = np.linalg.norm(points[:, :3], axis=1) <= settings.max_range
            yield (points if self.scans[number].thinned else points[near]), pose, number

    @property
    def stats(self) -> dict[str, Any]:
        """``statistics`` as the keys of ``stats.json``."""
        return self.statistics.to_tree()

    def cloud(self, settings: MapSettings, unreadable: list[str] | None = None) -> MapCloud:
        """The map, thinned to one mean point a voxel.

        Args:
            settings: Voxel size and range.
            unreadable: See ``placed_scans``.

        Returns:
            Points (N, 3) in the map, metres; (N, 4) with intensity where a LiDAR measures it, 0
            for those that only other LiDARs saw. Each knows the scan that saw its voxel first.
        """
        # A voxel of a saved map may lie a little beyond the range of the scan that saw it first.
        saved = any(scan.thinned for scan in self.scans)
        placed = self._in_range(unreadable, settings) if saved else self._placed(unreadable)
        limit = np.inf if saved else settings.max_range
        points, first = accumulate(placed, settings.voxel_size, limit)
        names = tuple(sorted({scan.sensor for scan in self.scans}))
        scans = ScanTable(
            stamps=np.array([scan.stamp for scan in self.scans], dtype=np.int64),
            lidars=np.array([names.index(scan.sensor) for scan in self.scans], dtype=np.uint8),
            windows=np.array(
                [self.clusters[scan.cluster].window for scan in self.scans], dtype=np.int32
            ),
            names=names,
        )
        return MapCloud(points, first, scans)


def trajectory_of(clusters: Sequence[PlacedCluster], values: gtsam.Values) -> Trajectory:
    """T_map_base at the stamps of clusters, and at those at which the vehicle stood there.

    Args:
        clusters: Clusters of G(t), in the order of their numbers.
        values: Their poses.
    """
    stamps: list[int] = []
    poses: list[NDArray[np.float64]] = []
    for placed in clusters:
        here = [placed.cluster.stamp, *placed.stood]
        stamps += here
        poses += [values.atPose3(pose_key(placed.id)).matrix()] * len(here)
    return from_matrices(np.array(stamps, dtype=np.int64), np.array(poses).reshape(-1, 4, 4))


def fixes_in_map(state: GraphState) -> NDArray[np.float64]:
    """Antenna positions (K, 3) of the fixes of G(t), metres in the map."""
    if state.enu_offset is None:
        return np.zeros((0, 3))
    fixes: NDArray[np.float64] = np.array([fix.enu for fix in state.fixes])
    return fixes.reshape(-1, 3) + state.enu_offset
