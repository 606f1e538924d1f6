"""A run in Rerun: while it is mapped, and from its folder afterwards."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.config import Config
from incremental_mapper.errors import InputError
from incremental_mapper.geometry import transform_points
from incremental_mapper.graph.factors import Factor, FactorKind
from incremental_mapper.map.ply import MapCloud
from incremental_mapper.mapping.live_map import graph_view
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.mapping.result import MapResult, WindowResult
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.results.candidate_table import members_text
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.selection.choice import Tried
from incremental_mapper.smoothing.graph_state import GraphState, PlacedScan
from incremental_mapper.trajectory import Trajectory
from incremental_mapper.visualization.rerun_scene import RerunScene
from incremental_mapper.visualization.shown_candidates import ShownCandidate

POINTS_OF_A_SCAN = 1200
"""So many points of a scan are shown at most while it is mapped."""
POINTS_OF_A_WINDOW = 8000
"""So many points of a window of a finished run."""
MOST_POSES = 1000
"""So many poses of the way are shown while a run is mapped."""
PERIOD = NANOSECONDS
"""Time of the drive between two graphs and ways that are shown."""
NUMBERS = ('solver_error', 'candidates_solved')
"""Columns of windows.csv that are shown over time."""


class RunView:
    """Shows a run while it is mapped; see ``RunWatcher``."""

    def __init__(self, scene: RerunScene) -> None:
        self.trouble = ''
        self._scene = scene
        self._scans = self._factors = 0
        self._turned = False
        self._last = 0
        self._first_pose: NDArray[np.float64] | None = None

    def window(self, mapper: Mapper, result: WindowResult) -> None:
        """Show a window; see ``RunWatcher``."""
        state, scene = mapper.state, self._scene
        if not state.clusters:
            return
        newest = state.clusters[-1]
        stamp = state.frontier.newest_stamp
        scene.at(stamp, result.index)
        self._turn(state)
        pose = state.pose(newest.id).matrix()
        self._show_points(state, float(pose[2, 3]), mapper.config.map.max_range)
        scene.car(pose)
        scene.candidates([_shown(item, result) for item in result.tried], result.row['score_name'])
        scene.numbers({name: float(result.row[name]) for name in NUMBERS})
        if state.georeferenced:
            fixes = state.factors[self._factors :]
            self._show_fixes(fixes)
            self._factors += len(fixes)
        if stamp - self._last >= PERIOD:
            self._last = stamp
            view = graph_view(state, mapper.config.graph.markers_span)
            scene.graph(view.poses, view.merged, view.edges, view.priors)
            scene.path(_way(state))

    def finish(self, result: MapResult, cloud: MapCloud) -> None:
        """Show the way after the final optimisation, all of it; see ``RunWatcher``."""
        self._scene.path(result.trajectory.positions)
        self._scene.overlook(result.trajectory.positions)

    def _turn(self, state: GraphState) -> None:
        """Follow the map where it becomes east, north, up."""
        pose = state.pose(state.clusters[0].id).matrix()
        if state.georeferenced and not self._turned and self._first_pose is not None:
            self._scene.turned(pose @ np.linalg.inv(self._first_pose))
        self._turned = state.georeferenced
        self._first_pose = pose

    def _show_points(self, state: GraphState, height: float, max_range: float) -> None:
        placed = []
        for scan in state.scans[self._scans :]:
            points = _thinned(scan, POINTS_OF_A_SCAN, max_range)
            pose = state.pose(scan.cluster).compose(scan.T_cluster_scan).matrix()
            placed.append(transform_points(pose, points.astype(np.float64)))
        if placed:
            self._scene.points(np.concatenate(placed), height)
        self._scans = len(state.scans)

    def _show_fixes(self, factors: Sequence[Factor]) -> None:
        found = [factor.data for factor in factors if factor.kind is FactorKind.GNSS]
        if found:
            positions = np.array([item['position'] for item in found])
            self._scene.fixes(positions, np.array([item['covariance'] for item in found]))


@contextmanager
def run_view(save: Path | None, config: Config) -> Iterator[RunView]:
    """Show a run while it is mapped.

    Args:
        save: A file to write it to; None opens a viewer.
        config: The settings of the run.

    Yields:
        What is to be told of the run.

    Raises:
        InputError: Rerun is not installed, or its viewer does not start.
        OutputError: The file cannot be written.
    """
    scene = RerunScene(save)
    try:
        yield RunView(scene)
    finally:
        scene.close()


def show_finished(run: FinishedRun, scene: RerunScene) -> None:
    """Show a finished run, all of it at its final poses.

    Args:
        run: The folder of a run.
        scene: Where it is shown.

    Raises:
        InputError: A file is missing or damaged.
    """
    graph = run.graph
    poses = {
        item['cluster']: np.array(item['value'])
        for item in graph['variables']
        if item['kind'] == 'pose'
    }
    clusters: dict[int, list[Mapping[str, Any]]] = {}
    for item in graph['clusters']:
        clusters.setdefault(item['window'], []).append(item)
    factors = _by_cluster(graph)
    points = _points_by_window(run)
    candidates = _candidates_by_window(run)
    way: list[NDArray[np.float64]] = []
    if poses:
        scene.overlook(np.stack(list(poses.values()))[:, :3])
    for row in run.windows:
        window = int(row['window'])
        new = clusters.get(window, [])
        scene.at(max([int(row['end_ns']), *(item['stamp_ns'] for item in new)]), window)
        way += [poses[item['id']] for item in new]
        if window in candidates:
            scene.candidates(*candidates[window])
        scene.numbers({name: float(row[name]) for name in NUMBERS if row.get(name)})
        if not way:
            continue
        if window in points:
            scene.points(points[window], float(way[-1][2]))
        _show_graph(scene, new, poses, factors)
        scene.path(np.array(way)[-2000:, :3])


def _show_graph(
    scene: RerunScene,
    new: list[Mapping[str, Any]],
    poses: Mapping[int, NDArray[np.float64]],
    factors: Mapping[int, list[Mapping[str, Any]]],
) -> None:
    """The clusters of a window and the factors that came with them."""
    edges: dict[str, list[NDArray[np.float64]]] = {}
    priors: list[NDArray[np.float64]] = []
    fixes: list[Mapping[str, Any]] = []
    for cluster in new:
        for factor in factors.get(cluster['id'], ()):
            ends = [poses[end][:3] for end in _ends(factor)]
            if factor['kind'] == str(FactorKind.GNSS):
                fixes.append(factor)
                ends.append(np.array(factor['position']))
            if len(ends) == 2:
                edges.setdefault(factor['kind'], []).append(np.stack(ends))
            elif factor['kind'] == str(FactorKind.PRIOR_POSE):
                priors += ends
    if new:
        last = poses[new[-1]['id']]
        scene.car(pose_matrix(last))
    merged = [poses[item['id']][:3] for item in new if len(item['members']) > 1]
    scene.graph(
        np.array([poses[item['id']][:3] for item in new]).reshape(-1, 3),
        np.array(merged).reshape(-1, 3),
        {kind: np.stack(pairs) for kind, pairs in edges.items()},
        np.array(priors).reshape(-1, 3),
        add=True,
    )
    if fixes:
        positions = np.array([item['position'] for item in fixes])
        scene.fixes(positions, np.array([item['covariance'] for item in fixes]))


def _by_cluster(graph: Mapping[str, Any]) -> dict[int, list[Mapping[str, Any]]]:
    """Factors by the newest of their clusters."""
    found: dict[int, list[Mapping[str, Any]]] = {}
    for factor in graph['factors']:
        newest = max(int(key[1:]) for key in factor['variables'])
        found.setdefault(newest, []).append(factor)
    return found


def _ends(factor: Mapping[str, Any]) -> list[int]:
    """Numbers of the clusters that a factor leads to, ascending; a bias has no place."""
    return sorted({int(key[1:]) for key in factor['variables'] if key[0] != 'b'})


def _points_by_window(run: FinishedRun) -> dict[int, NDArray[np.float32]]:
    """The map's points by the window that saw their voxel first, thinned."""
    columns = run.map.columns(('x', 'y', 'z', 'window'), np.float64)
    order = np.argsort(columns[:, 3], kind='stable')
    columns = columns[order]
    windows, starts = np.unique(columns[:, 3], return_index=True)
    parts = np.split(columns[:, :3].astype(np.float32), starts[1:])
    return {
        int(window): part[:: -(-len(part) // POINTS_OF_A_WINDOW)]
        for window, part in zip(windows, parts, strict=True)
    }


def _candidates_by_window(run: FinishedRun) -> dict[int, tuple[list[ShownCandidate], str]]:
    """What windows chose from, where ``candidates.parquet`` can be read."""
    found: dict[int, tuple[list[ShownCandidate], str]] = {}
    for row in run.windows:
        window = int(row['window'])
        try:
            rows = run.candidates(window)
        except InputError:
            return {}
        if rows:
            found[window] = (
                [
                    ShownCandidate(
                        item['members'],
                        item['vertices'],
                        item['score'],
                        item['time_shift_s'],
                        item['solver_error'],
                        item['winner'],
                        item['tied'],
                    )
                    for item in rows
                ],
                rows[0]['score_name'],
            )
    return found


def _shown(tried: Tried, result: WindowResult) -> ShownCandidate:
    candidate = tried.candidate
    return ShownCandidate(
        members_text(candidate),
        candidate.vertices,
        tried.score,
        candidate.time_shift / NANOSECONDS,
        tried.solver_error,
        candidate == result.winner,
        tried.tied,
    )


def _way(state: GraphState) -> NDArray[np.float64]:
    """The way so far (N, 3), thinned to ``MOST_POSES``; the newest pose is its end."""
    clusters = state.clusters
    shown = clusters[::-1][:: -(-len(clusters) // MOST_POSES)][::-1]
    return np.array([state.pose(item.id).translation() for item in shown])


def _thinned(scan: PlacedScan, most: int, max_range: float) -> NDArray[np.float32]:
    points = scan.cloud[:, :3]
    points = points[:: max(-(-len(points) // most), 1)]
    near: NDArray[np.float32] = points[np.einsum('ij,ij->i', points, points) <= max_range**2]
    return near


def pose_matrix(numbers: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4, 4) of x, y, z, qx, qy, qz, qw (7,)."""
    one = Trajectory(np.zeros(1, dtype=np.int64), numbers[None, :3], numbers[None, 3:])
    matrix: NDArray[np.float64] = one.matrices()[0]
    return matrix
