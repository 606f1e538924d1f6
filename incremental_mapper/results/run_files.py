"""The files of a finished run (DESIGN: trajectory.tum, map.ply, graph.g2o, graph.json, ...)."""

import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.errors import OutputError
from incremental_mapper.graph.factors import Factor, pose_numbers
from incremental_mapper.graph.values import cluster_of, key_name, kind_of, pose_key
from incremental_mapper.map.cloud import write_ply
from incremental_mapper.mapping.result import MapResult
from incremental_mapper.smoothing.graph_state import PlacedCluster
from incremental_mapper.trajectory import write_tum

KINDS = {'x': 'pose', 'v': 'velocity', 'b': 'bias'}
FILES = ('trajectory.tum', 'map.ply', 'graph.g2o', 'graph.json', 'windows.csv', 'stats.json')


def prepare_folder(folder: Path, force: bool) -> None:
    """Make an output folder; raises OutputError where it holds something and is not forced."""
    try:
        if folder.exists() and not folder.is_dir():
            raise OutputError(f'{folder}: is a file, expected a folder for the output')
        if folder.is_dir() and any(folder.iterdir()) and not force:
            raise OutputError(f'{folder}: is not empty; name another folder or add --force')
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f'{folder}: cannot be made ({error.strerror})') from error


def write_result(
    folder: Path, result: MapResult, points: NDArray[np.float32], stats: Mapping[str, Any]
) -> None:
    """Write all data files of a run into an existing folder; pictures are not among them.

    ``points`` (N, 3) is the map in metres. Every file is written beside its name first and then
    renamed, so that an interrupted run leaves no torn file.
    """
    _write(folder / 'trajectory.tum', lambda path: write_tum(path, result.trajectory))
    _write(folder / 'map.ply', lambda path: write_ply(path, points))
    _write(folder / 'graph.g2o', lambda path: _write_g2o(path, result))
    graph = graph_tree(result.clusters, result.factors, result.values)
    _write(folder / 'graph.json', lambda path: _write_json(path, graph))
    _write(folder / 'windows.csv', lambda path: _write_rows(path, result.rows))
    _write(folder / 'stats.json', lambda path: _write_json(path, stats, indent=2))


def graph_tree(
    clusters: Sequence[PlacedCluster], factors: Sequence[Factor], values: gtsam.Values
) -> dict[str, Any]:
    """All of G(t) in plain values: variables, clusters with their members, factors."""
    stamps = {placed.id: placed.cluster.stamp for placed in clusters}
    keys = sorted(
        (int(key) for key in values.keys()),  # noqa: SIM118 (no mapping)
        key=lambda key: (cluster_of(key), kind_of(key) != 'x', key),
    )
    return {
        'format': 1,
        'frame': 'map',
        'units': 'metres, radians, seconds; stamps in nanoseconds',
        'variables': [
            {
                'key': key_name(key),
                'kind': KINDS[kind_of(key)],
                'cluster': cluster_of(key),
                'stamp_ns': stamps[cluster_of(key)],
                'value': _value(values, key),
            }
            for key in keys
        ],
        'clusters': [
            {
                'id': placed.id,
                'window': placed.window,
                'stamp_ns': placed.cluster.stamp,
                'first_ns': placed.cluster.members[0].stamp,
                'last_ns': placed.cluster.members[-1].stamp,
                'members': [
                    {'sensor': core.sensor, 'kind': str(core.kind), 'stamp_ns': core.stamp}
                    for core in placed.cluster.members
                ],
            }
            for placed in clusters
        ],
        'factors': [
            {
                'kind': str(factor.kind),
                'variables': [key_name(key) for key in factor.keys],
                'sensor': factor.sensor,
                'stamps_ns': list(factor.stamps),
                **factor.data,
            }
            for factor in factors
        ],
    }


def _value(values: gtsam.Values, key: int) -> list[float]:
    kind = key_name(key)[0]
    if kind == 'x':
        return pose_numbers(values.atPose3(key))
    vector = values.atVector(key) if kind == 'v' else values.atConstantBias(key).vector()
    return [float(number) for number in vector]


def _write_g2o(path: Path, result: MapResult) -> None:
    # GTSAM writes poses and relative poses only; g2o has no tags for the rest. Plain cluster
    # numbers replace the symbols, which other readers would show as 19-digit numbers.
    graph, poses = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for placed in result.clusters:
        poses.insert(placed.id, result.values.atPose3(pose_key(placed.id)))
    for factor in result.factors:
        if isinstance(factor.factor, gtsam.BetweenFactorPose3):
            graph.push_back(factor.factor.rekey([cluster_of(key) for key in factor.keys]))
    gtsam.writeG2o(graph, poses, str(path))


def _write_json(path: Path, tree: Mapping[str, Any], indent: int | None = None) -> None:
    with path.open('w', encoding='utf-8') as file:
        json.dump(tree, file, indent=indent, allow_nan=False)
        file.write('\n')


def _write_rows(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    with path.open('w', encoding='utf-8', newline='') as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]) if rows else ['window'])
        writer.writeheader()
        writer.writerows(rows)


def _write(path: Path, write: Any) -> None:
    partial = path.with_name(f'.{path.name}.partial')
    try:
        write(partial)
        partial.replace(path)
    except OSError as error:
        raise OutputError(f'{path}: cannot be written ({error.strerror})') from error
