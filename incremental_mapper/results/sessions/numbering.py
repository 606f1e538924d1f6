"""The numbers that clusters and windows of a session have in a joint map."""

from dataclasses import dataclass, replace
from typing import Any

import gtsam

from incremental_mapper.graph.factors import Factor
from incremental_mapper.mapping.result import MapResult
from incremental_mapper.selection.window_record import WindowRecord
from incremental_mapper.smoothing.graph_state import PlacedCluster, PlacedScan
from incremental_mapper.variables import (
    bias_key,
    cluster_of,
    copy_value,
    kind_of,
    pose_key,
    velocity_key,
)

KEY = {'x': pose_key, 'v': velocity_key, 'b': bias_key}


@dataclass(frozen=True, slots=True, eq=False)
class Numbered:
    """A session under the numbers that its clusters and windows have in the joint map."""

    clusters: tuple[PlacedCluster, ...]
    factors: tuple[Factor, ...]
    values: gtsam.Values
    scans: tuple[PlacedScan, ...]
    rows: tuple[dict[str, Any], ...]
    failed: tuple[WindowRecord, ...]


def numbered(part: MapResult, clusters: int, windows: int) -> Numbered:
    """A session whose clusters and windows are counted on from others.

    Args:
        part: The session.
        clusters: How many clusters come before its own.
        windows: How many windows.
    """
    if clusters == windows == 0:
        return Numbered(
            part.clusters, part.factors, part.values, part.scans, part.rows, part.failed
        )
    values = gtsam.Values()
    for key in part.values.keys():  # noqa: SIM118 (no mapping)
        copy_value(part.values, key, values, _moved(key, clusters))
    return Numbered(
        clusters=tuple(
            replace(item, id=item.id + clusters, window=item.window + windows)
            for item in part.clusters
        ),
        factors=tuple(_renamed(factor, clusters) for factor in part.factors),
        values=values,
        scans=tuple(replace(scan, cluster=scan.cluster + clusters) for scan in part.scans),
        rows=tuple({**row, 'window': row['window'] + windows} for row in part.rows),
        failed=tuple(replace(record, window=record.window + windows) for record in part.failed),
    )


def _moved(key: int, clusters: int) -> int:
    return KEY[kind_of(key)](cluster_of(key) + clusters)


def _renamed(factor: Factor, clusters: int) -> Factor:
    keys = tuple(_moved(key, clusters) for key in factor.keys)
    return replace(factor, keys=keys, factor=factor.factor.rekey(list(keys)))
