"""``session.bin``: the whole graph of a run, from which another session can go on.

``graph.json`` is for readers: it has no covariance of an IMU span. This file has the factors and
the values as GTSAM writes them itself, in parts, so that a long drive takes no more memory than
its graph. The points are not in it: ``map.ply`` has them.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.errors import InputError
from incremental_mapper.graph.factors import Factor
from incremental_mapper.mapping.result import MapResult
from incremental_mapper.results.plain_graph import (
    cluster_of_tree,
    cluster_tree,
    factor_tree,
    factors_of,
    packed,
    unpacked,
    values_of,
)
from incremental_mapper.smoothing.graph_state import PlacedCluster

FILE = 'session.bin'
FORMAT = 1
TITLE = b'incremental_mapper session '
SIZE = struct.Struct('<Q')
FACTORS_A_PART = 5000


@dataclass(frozen=True, slots=True, eq=False)
class SavedScan:
    """A scan of a saved graph: its cluster, stamp (ns), LiDAR, and place (4, 4) in the cluster."""

    cluster: int
    stamp: int
    sensor: str
    T_cluster_scan: gtsam.Pose3


@dataclass(frozen=True, slots=True, eq=False)
class SavedGraph:
    """What ``session.bin`` holds; the scans are in the order of ``map_scans.ply``."""

    clusters: tuple[PlacedCluster, ...]
    factors: tuple[Factor, ...]
    values: gtsam.Values
    scans: tuple[SavedScan, ...]


def write_session(path: Path, result: MapResult) -> None:
    """Write the graph of a run.

    Args:
        path: The file.
        result: The run.

    Raises:
        OSError: It cannot be written.
        RuntimeError: GTSAM cannot write a factor, as one of a user's own strategy.
    """
    tree = {
        'clusters': [cluster_tree(placed) for placed in result.clusters],
        'scans': [
            [scan.cluster, scan.stamp, scan.sensor, _place_tree(scan.T_cluster_scan)]
            for scan in result.scans
        ],
    }
    with path.open('wb') as file:
        file.write(TITLE + b'%d\n' % FORMAT)
        _append(file, packed(tree, result.values.serialize()))
        for first in range(0, len(result.factors), FACTORS_A_PART):
            some = result.factors[first : first + FACTORS_A_PART]
            graph = gtsam.NonlinearFactorGraph()
            for factor in some:
                graph.push_back(factor.factor)
            trees = [factor_tree(factor) for factor in some]
            _append(file, packed({'factors': trees}, graph.serialize()))


def read_session(folder: Path) -> SavedGraph:
    """Read the graph of a run whose files are known to be whole.

    Args:
        folder: The folder of the run.

    Returns:
        The graph.

    Raises:
        InputError: There is none, or this version cannot read it.
    """
    path = folder / FILE
    if not path.is_file():
        raise InputError(
            f'{folder}: has no {FILE}: an older version wrote it; map the drive again to go on '
            'from it'
        )
    try:
        with path.open('rb') as file:
            parts = _parts(path, file)
            first = next(parts)
            factors: list[Factor] = []
            for tree in parts:
                factors += factors_of(tree['factors'], *tree['texts'])
        return SavedGraph(
            clusters=tuple(map(cluster_of_tree, first['clusters'])),
            factors=tuple(factors),
            values=values_of(*first['texts']),
            scans=tuple(
                SavedScan(cluster, stamp, sensor, _place(turned))
                for cluster, stamp, sensor, turned in first['scans']
            ),
        )
    except OSError as error:
        raise InputError(f'{path}: cannot be read ({error.strerror})') from error
    # GTSAM says so of what another version of it has written.
    except (KeyError, TypeError, ValueError, RuntimeError, IndexError, StopIteration) as error:
        reason = ' '.join(str(error).split())[:200]
        raise InputError(
            f'{path}: cannot be read by this version of the program ({reason}); '
            'go on with the version that wrote it'
        ) from error


def _append(file: BinaryIO, data: bytes) -> None:
    file.write(SIZE.pack(len(data)))
    file.write(data)


def _parts(path: Path, file: BinaryIO) -> Iterator[dict[str, Any]]:
    line = file.readline(len(TITLE) + 12)
    if line != TITLE + b'%d\n' % FORMAT:
        found = (
            line[len(TITLE) :].strip().decode(errors='replace') if line.startswith(TITLE) else ''
        )
        raise InputError(
            f'{path}: has format {found or "unknown"}, this version of the program reads {FORMAT}; '
            'use the version that wrote it, or map the drive again'
        )
    while head := file.read(SIZE.size):
        yield unpacked(file.read(SIZE.unpack(head)[0]))


def _place_tree(pose: gtsam.Pose3) -> NDArray[np.float64] | None:
    still: bool = pose.equals(gtsam.Pose3(), 0.0)
    return None if still else pose.matrix()


def _place(matrix: list[list[float]] | None) -> gtsam.Pose3:
    return gtsam.Pose3() if matrix is None else gtsam.Pose3(np.array(matrix))
