"""What a window's candidates are judged on: its new scans among the recent ones."""

from collections.abc import Callable, Sequence

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.candidates.model import Candidate
from incremental_mapper.frontend.front_end import Prepared
from incremental_mapper.frontend.prepared_scan import PreparedScan
from incremental_mapper.geometry import transform_points
from incremental_mapper.graph.connectivity import Partition, Partitions
from incremental_mapper.graph.motion_compensation import MotionCompensation
from incremental_mapper.graph.window_inputs import WindowInputs
from incremental_mapper.scoring.mom import LocalMap
from incremental_mapper.smoothing.graph_state import GraphState, PlacedScan
from incremental_mapper.variables import cluster_of, pose_key
from incremental_mapper.voxels import thin


class LocalMapBuilder:
    """Places a window's scans among the recent ones of G(t-1).

    Recent scans inside the lag move with the candidates: what a candidate says of the frontier
    also corrects the poses before it. Scans beyond the lag stay where they are.
    """

    def __init__(
        self,
        items: Sequence[Prepared],
        inputs: WindowInputs,
        partitions: Partitions,
        compensation: MotionCompensation,
        state: GraphState,
        recent: int,
    ) -> None:
        last = list(state.recent)[-recent:]
        self._state = state
        self._inputs = inputs
        self._partitions = partitions
        self._compensation = compensation
        self._new = [item for item in items if isinstance(item, PreparedScan)]
        self._touched = [scan for scan in last if state.in_lag(scan[0].cluster)]
        self._touched_keys = [pose_key(scan.cluster) for scan, _ in self._touched]
        self._touched_offsets = [scan.T_cluster_scan.matrix() for scan, _ in self._touched]
        self._placings: dict[Partition, tuple[list[int], NDArray[np.float64]]] = {}
        self._fixed = [scan for scan in last if not state.in_lag(scan[0].cluster)]

    def local_map(self, poses: Sequence[NDArray[np.float64]]) -> LocalMap:
        """The local map for candidates with these ``poses`` (S, 4, 4) of the moving scans.

        The first candidate is the reference.
        """
        states = self._inputs.states
        voxel = self._inputs.config.mom.voxel_size
        fixed = [
            transform_points(self._pose(scan).matrix(), points) for scan, points in self._fixed
        ]
        moving = [item.sparse for item in self._new]
        moving += [points for _, points in self._touched]
        return LocalMap(
            fixed=thin(np.vstack([np.zeros((0, 3)), *fixed]), voxel),
            moving=moving,
            poses=np.array(poses),
            fresh=len(self._new),
            origin=states[max(states)].pose.translation(),
        )

    def poses(
        self, candidate: Candidate, pose_of: Callable[[int], gtsam.Pose3 | None]
    ) -> NDArray[np.float64]:
        """Poses T_map_base (S, 4, 4) of the local map's moving scans under a candidate.

        ``pose_of`` gives the solved poses by their keys, and those of the lag that move along;
        None where a pose is not among them.
        """
        keys, offsets = self._placing(candidate)
        poses = {}
        for key in keys:
            if key not in poses:
                pose = pose_of(key) or self._state.pose(cluster_of(key))
                poses[key] = pose.matrix()
        placed = np.array([poses[key] for key in keys]).reshape(-1, 4, 4)
        moved: NDArray[np.float64] = placed @ offsets
        return moved

    def _placing(self, candidate: Candidate) -> tuple[list[int], NDArray[np.float64]]:
        """Pose keys of the local map's moving scans, and T_cluster_scan (S, 4, 4) of each."""
        partition = self._partitions.of(candidate)
        known = self._placings.get(partition)
        if known is None:
            owner = {core: cluster for cluster in candidate.clusters for core in cluster.members}
            clusters = [owner[item.core] for item in self._new]
            keys = [pose_key(self._partitions.number(cluster)) for cluster in clusters]
            offsets = [
                self._compensation.offset(cluster, item.core.stamp).matrix()
                for item, cluster in zip(self._new, clusters, strict=True)
            ]
            stacked = np.array([*offsets, *self._touched_offsets]).reshape(-1, 4, 4)
            known = self._placings[partition] = [*keys, *self._touched_keys], stacked
        return known

    def _pose(self, scan: PlacedScan) -> gtsam.Pose3:
        return self._state.pose(scan.cluster).compose(scan.T_cluster_scan)
