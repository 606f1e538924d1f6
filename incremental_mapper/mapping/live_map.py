"""Map, path and graph as they stand now, at a cost that does not grow with every window.

What has left the mapper's lag is final: it is placed once and kept. Only the lag is placed anew.
When the map is turned into ENU, once in a drive, everything is placed again; so it is, a part with
each window, when closed loops have moved the map by more than a voxel.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.compiled import waiting
from incremental_mapper.config import Config
from incremental_mapper.geometry import matrix_numbers, transform_points
from incremental_mapper.graph.factors import Factor, FactorKind, pose_numbers
from incremental_mapper.map.cloud import joined, with_known_light
from incremental_mapper.map.voxel_grid import ROOM, VoxelGrid, warm_up
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.mapping.result import MapResult
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.smoothing.graph_state import GraphState, PlacedScan
from incremental_mapper.variables import cluster_of, kind_of

_FULLEST = 65_536.0
"""Points after which a voxel takes no more; its sums stay exact to a fraction of a millimetre."""
EARLIER = -1
"""Stands for a cluster of the map before."""
AGAIN_SCANS, AGAIN_POSES = 8, 200
"""Scans, and poses of the path, that are placed again with each window: 5 ms. What comes in
meanwhile waits, and with it the next pose."""


@dataclass(frozen=True, slots=True, eq=False)
class GraphView:
    """The newest part of the graph, metres in the map.

    ``poses`` (N, 3); ``merged`` (M, 3) are those of them that hold several measurements;
    ``edges`` (E, 2, 3) by kind of factor; ``priors`` (P, 3).
    """

    stamp: int
    poses: NDArray[np.float64]
    merged: NDArray[np.float64]
    edges: dict[str, NDArray[np.float64]]
    priors: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class PathView:
    """Stamps (N,) in ns and poses (N, 7): x, y, z, qx, qy, qz, qw."""

    stamps: list[int]
    poses: list[list[float]]


class LiveMap:
    """Follows a mapper; ``follow`` is to be called after every window."""

    def __init__(self, mapper: Mapper, earlier: MapResult | None = None) -> None:
        """Begin.

        Args:
            mapper: The mapper.
            earlier: The map before, in the frame that the mapper's has once it is ENU; it is shown
                from then on.
        """
        with waiting():
            warm_up()  # no window need wait for the compiler
        self._mapper = mapper
        self._earlier = earlier
        self._bright = False  # whether any scan has intensities
        self._path: list[tuple[int, list[float], int]] = []  # stamp, pose and cluster
        self._stride = 1
        self._again: VoxelGrid | None = None
        self._placed_again = self._old_path = 0
        self._again_at = 0.0
        self._again_earlier: Iterator[tuple[NDArray[np.float32], NDArray[np.float64]]] = iter(())
        self._restart()

    def follow(self) -> None:
        """Take over what has become final since the last call."""
        state = self._mapper.state
        if state.georeferenced != self._georeferenced:
            self._restart()
        self._correct()
        while self._scans < len(state.scans):
            scan = state.scans[self._scans]
            if state.in_lag(scan.cluster):
                break
            self._add(self._cloud, scan)
            self._scans += 1
        while self._clusters < len(state.clusters):
            placed = state.clusters[self._clusters]
            if state.in_lag(placed.id):
                break
            if self._clusters % self._stride == 0:
                row = (placed.cluster.stamp, pose_numbers(state.pose(placed.id)), placed.id)
                self._path.append(row)
            self._clusters += 1
        while len(self._path) > self._config.path.max_poses // 2:
            self._path = self._path[::2]
            self._stride *= 2
            self._old_path = len(self._path) if self._old_path else 0

    @property
    def nbytes(self) -> int:
        """Memory that the final voxels take."""
        return self._cloud.nbytes

    def points(self) -> NDArray[np.float32]:
        """The map (N, 3) in metres, a mean point a voxel; what is final comes before the lag.

        It is (N, 4), intensity last, where a LiDAR measures it.

        It is bounded by ``map.display_points`` and ``map.display_radius``; what is in the lag is
        near the newest pose and comes first where not all have room.
        """
        state, settings = self._mapper.state, self._config.map
        moving = self._empty_grid(lasting=False)
        for scan in state.scans[self._scans :]:
            self._add(moving, scan)
        new = moving.points(without=self._cloud)
        most, radius = settings.display_points, settings.display_radius
        if (most == 0 and radius == 0.0) or not state.clusters:
            return with_known_light(joined([self._cloud.points(), new]))
        most = most or len(self._cloud) + len(new)
        if len(new) > most:
            new = new[:: -(-len(new) // most)]
        newest: NDArray[np.float64] = state.pose(state.clusters[-1].id).translation()
        old = self._cloud.near(newest, radius or np.inf, most - len(new))
        return with_known_light(joined([old, new]))

    def placed(self, scans: Iterable[PlacedScan]) -> NDArray[np.float64]:
        """Points (N, 3) of scans in the map, metres; (N, 4) once any scan had intensities."""
        clouds = [self._placed(scan) for scan in scans]
        self._bright = self._bright or any(cloud.shape[1] == 4 for cloud in clouds)
        return with_known_light(joined([np.zeros((0, 4 if self._bright else 3)), *clouds]))

    def path(self) -> PathView:
        """At most ``path.max_poses`` poses, the newest among them."""
        state = self._mapper.state
        moving = state.clusters[self._clusters :]
        room = max(self._config.path.max_poses - len(self._path), 1)
        stride = max(self._stride, -(-len(moving) // room))
        # Counted from the newest one, which is always shown.
        shown = moving[::-1][::stride][::-1]
        stamps = [stamp for stamp, _, _ in self._path]
        poses = [pose for _, pose, _ in self._path]
        return PathView(
            [*stamps, *(item.cluster.stamp for item in shown)],
            [*poses, *(pose_numbers(state.pose(item.id)) for item in shown)],
        )

    def graph(self, span: float) -> GraphView:
        """Poses and factors of the newest ``span`` seconds."""
        return graph_view(self._mapper.state, span)

    @property
    def _config(self) -> Config:
        return self._mapper.config

    def _restart(self) -> None:
        self._georeferenced = self._mapper.state.georeferenced
        self._cloud = self._empty_grid()
        self._scans = 0
        self._clusters = 0
        self._path = []
        self._stride = 1
        self._corrections = self._mapper.state.corrections
        self._placed_at = self._mapper.state.shifted
        self._again, self._old_path = None, 0
        if self._earlier is not None and self._georeferenced:
            self._show(self._earlier)

    def _correct(self) -> None:
        """After closed loops have moved the map: place what is final again, a part at a time."""
        state = self._mapper.state
        if state.corrections != self._corrections:
            self._corrections = state.corrections
            self._old_path = len(self._path)
        for place in range(max(self._old_path - AGAIN_POSES, 0), self._old_path):
            stamp, _, cluster = self._path[place]
            if cluster != EARLIER:
                self._path[place] = (stamp, pose_numbers(state.pose(cluster)), cluster)
        self._old_path = max(self._old_path - AGAIN_POSES, 0)
        if self._again is None and state.shifted - self._placed_at > self._size:
            # To grow would take a tenth of a second at a time, with a million voxels.
            self._again, self._placed_again = self._empty_grid(len(self._cloud)), 0
            self._again_at = state.shifted
            self._again_earlier = self._of_earlier()
        if self._again is None:
            return
        before = list(islice(self._again_earlier, AGAIN_SCANS))
        for points, pose in before:
            self._again.add(points, pose)
        if before:
            return
        end = min(self._placed_again + AGAIN_SCANS, self._scans)
        for scan in state.scans[self._placed_again : end]:
            self._add(self._again, scan)
        self._placed_again = end
        if end == self._scans:
            self._cloud, self._again = self._again, None
            self._placed_at = self._again_at

    def _of_earlier(self) -> Iterator[tuple[NDArray[np.float32], NDArray[np.float64]]]:
        """Points of the map before, as far as it is shown, and what places them."""
        shown = self._earlier if self._georeferenced else None
        return iter(()) if shown is None else iter(shown.placed_scans([]))

    def _show(self, earlier: MapResult) -> None:
        for points, pose in self._of_earlier():
            self._cloud.add(points, pose)
        way = earlier.trajectory
        stride = max(-(-4 * len(way) // self._config.path.max_poses), 1)
        poses = [matrix_numbers(matrix) for matrix in way.matrices()[::stride]]
        stamps = way.stamps[::stride].tolist()
        self._path = [(stamp, pose, EARLIER) for stamp, pose in zip(stamps, poses, strict=True)]

    @property
    def _size(self) -> float:
        settings = self._config.map
        return settings.display_voxel_size or settings.voxel_size

    def _empty_grid(self, room: int = ROOM, lasting: bool = True) -> VoxelGrid:
        most = self._config.map.max_range
        return VoxelGrid(
            self._size, max_range=most, fullest=_FULLEST, room=max(room, ROOM), shared=lasting
        )

    def _add(self, grid: VoxelGrid, scan: PlacedScan) -> None:
        grid.add(scan.cloud, self._pose(scan))

    def _placed(self, scan: PlacedScan) -> NDArray[np.float64]:
        cloud = scan.cloud
        points = cloud[:, :3]
        near = np.einsum('ij,ij->i', points, points) <= self._config.map.max_range**2
        kept = cloud[near].astype(np.float64)
        return np.hstack([transform_points(self._pose(scan), kept[:, :3]), kept[:, 3:]])

    def _pose(self, scan: PlacedScan) -> NDArray[np.float64]:
        """T_map_base (4, 4) of a scan as it is estimated now."""
        pose = self._mapper.state.pose(scan.cluster).compose(scan.T_cluster_scan)
        matrix: NDArray[np.float64] = pose.matrix()
        return matrix


def graph_view(state: GraphState, span: float) -> GraphView:
    """The newest part of a graph.

    Args:
        state: G(t).
        span: Seconds of it.

    Returns:
        Its poses and factors.
    """
    newest = state.frontier.newest_stamp
    oldest = newest - round(span * NANOSECONDS)
    first = len(state.clusters)
    while first > 0 and state.clusters[first - 1].cluster.stamp >= oldest:
        first -= 1
    shown = state.clusters[first:]
    place = {item.id: state.pose(item.id).translation() for item in shown}
    edges: dict[str, list[NDArray[np.float64]]] = {}
    priors: list[NDArray[np.float64]] = []
    for factor in _recent_factors(state, first):
        points = [place[end] for end in drawn_ends(factor.keys) if end in place]
        if factor.kind is FactorKind.GNSS:
            points.append(np.array(factor.data['position']))
        if len(points) == 2:
            edges.setdefault(str(factor.kind), []).append(np.stack(points))
        elif factor.kind is FactorKind.PRIOR_POSE:
            priors += points
    return GraphView(
        stamp=newest,
        poses=_table(list(place.values())),
        merged=_table([place[item.id] for item in shown if len(item.cluster.members) > 1]),
        edges={kind: np.stack(pairs) for kind, pairs in edges.items()},
        priors=_table(priors),
    )


def _recent_factors(state: GraphState, first: int) -> Iterable[Factor]:
    """Factors of clusters from number ``first`` on, newest first."""
    for factor in reversed(state.factors):
        # Factors are appended with their newest cluster, window by window.
        if max(cluster_of(key) for key in factor.keys) < first:
            return
        yield factor


def drawn_ends(keys: Iterable[int]) -> list[int]:
    """Numbers of the clusters that a drawn factor leads to, ascending.

    A bias has no place: it may be that of a cluster whose spans were long ago.
    """
    return sorted({cluster_of(key) for key in keys if kind_of(key) != 'b'})


def _table(points: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    return np.array(points, dtype=np.float64).reshape(-1, 3)
