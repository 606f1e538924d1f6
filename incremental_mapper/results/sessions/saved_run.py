"""A finished run as the mapper had it: graph, scans and counts, read from its folder."""

import csv
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.errors import InputError
from incremental_mapper.frontend.gnss import Datum
from incremental_mapper.graph.factors import FactorKind
from incremental_mapper.map.ply import MapFile
from incremental_mapper.map.store import PointStore
from incremental_mapper.mapping.result import MapResult, Session, trajectory_of
from incremental_mapper.mapping.statistics import KEYS, MapStatistics
from incremental_mapper.results.file_names import MAP, WINDOWS
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.results.manifest import require_whole
from incremental_mapper.results.plain_graph import findings_of
from incremental_mapper.results.sessions.session_file import SavedGraph, read_session
from incremental_mapper.smoothing.graph_state import PlacedScan
from incremental_mapper.variables import pose_key


@dataclass(frozen=True, slots=True, eq=False)
class SavedRun:
    """A finished run.

    Attributes:
        folder: Where it is.
        result: Graph, scans and counts; what was wrong with it are its findings.
        datum: Origin of its map on the earth; None where the map is not east-north-up.
        wall: Seconds that it took.
        counts: Measurements of its input, by sensor.
    """

    folder: Path
    result: MapResult
    datum: Datum | None
    wall: float
    counts: Mapping[str, int]


def read_saved_run(folder: Path, store: PointStore) -> SavedRun:
    """Read a finished run.

    Args:
        folder: What ``map``, ``save_map``, ``recover`` or ``merge`` wrote.
        store: Keeps its points.

    Returns:
        The run.

    Raises:
        InputError: There is none, it is damaged, or of a version that cannot be gone on with.
    """
    run = FinishedRun(folder)
    run.check()
    require_whole(folder)
    saved, stats = read_session(folder), run.stats
    try:
        return _made(run, saved, stats, store)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise InputError(
            f'{folder}: cannot be gone on with (its files do not belong together: {error!r})'
        ) from error


def _made(
    run: FinishedRun, saved: SavedGraph, stats: Mapping[str, Any], store: PointStore
) -> SavedRun:
    names = [KEYS.get(item.name, item.name) for item in fields(MapStatistics)]
    statistics = MapStatistics.from_tree({name: stats[name] for name in names if name in stats})
    rows = _rows(run.folder / WINDOWS)
    facts = stats['input']
    alone = Session(facts['path'], len(rows), len(saved.clusters), statistics.drive_s)
    fixes = [f.data['position'] for f in saved.factors if f.kind is FactorKind.GNSS]
    result = MapResult(
        clusters=saved.clusters,
        factors=saved.factors,
        values=saved.values,
        trajectory=trajectory_of(saved.clusters, saved.values),
        scans=tuple(_scans(run.folder / MAP, saved, store)),
        fixes=np.array(fixes, dtype=np.float64).reshape(-1, 3),
        rows=rows,
        statistics=statistics,
        findings=findings_of(stats['warnings']),
        sessions=tuple(Session(**tree) for tree in stats.get('sessions', ())) or (alone,),
    )
    known = statistics.georeferenced and statistics.datum is not None
    datum = Datum(*statistics.datum) if known and statistics.datum else None
    return SavedRun(run.folder, result, datum, stats['wall_s'], facts['counts'])


def _scans(path: Path, saved: SavedGraph, store: PointStore) -> Iterator[PlacedScan]:
    """The scans, each with the points of the map that it saw first, in its base_link."""
    file = MapFile(path)
    first = file.first()
    if first is None or not saved.scans:
        points, edges = np.zeros((0, 3), dtype=np.float32), np.zeros(len(saved.scans) + 1, np.intp)
    else:
        names = tuple(file.dtype.names or ())[: 4 if 'intensity' in (file.dtype.names or ()) else 3]
        order = np.argsort(first, kind='stable')
        points = file.columns(names, np.float32)[order]
        edges = np.searchsorted(first[order], np.arange(len(saved.scans) + 1))
    for scan, low, high in zip(saved.scans, edges[:-1], edges[1:], strict=True):
        pose = saved.values.atPose3(pose_key(scan.cluster)).compose(scan.T_cluster_scan)
        own = _moved(points[low:high], pose.inverse())
        stored = store.put(own)
        yield PlacedScan(
            scan.cluster, scan.stamp, scan.sensor, stored, scan.T_cluster_scan, thinned=True
        )


def _moved(points: NDArray[np.float32], T_scan_map: gtsam.Pose3) -> NDArray[np.float32]:
    """Points (N, 3 or 4) of the map in the frame of a scan."""
    matrix = T_scan_map.matrix()
    moved = points.copy()
    moved[:, :3] = points[:, :3].astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    return moved


def _rows(path: Path) -> tuple[dict[str, Any], ...]:
    """The rows of ``windows.csv``, numbers as numbers."""
    with path.open(encoding='utf-8', newline='') as file:
        return tuple(
            {name: _number(text) for name, text in row.items()} for row in csv.DictReader(file)
        )


def _number(text: str) -> Any:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text or None
