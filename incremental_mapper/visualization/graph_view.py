"""What there is to draw of a graph, found before anything is drawn.

``graph`` always has the layout of ``graph.json``.
"""

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array

from incremental_mapper.measurements import NANOSECONDS

Record: TypeAlias = Mapping[str, Any]

GRAPH_SECONDS = 1.5
"""Length of the stretch of graph that is drawn unless another is asked for: more is a blur."""
FEWEST_CLUSTERS = 6
"""Of a stretch that nobody chose: keyframes are seconds apart."""


def first_stamp(graph: Record, default: int) -> int:
    """Stamp (ns) of the first cluster, or ``default`` where there is none."""
    return min((int(item['stamp_ns']) for item in graph['clusters']), default=default)


def typical_stretch(graph: Record, seconds: float) -> tuple[int, int]:
    """A stretch around a fix in the middle of the drive: all kinds of factors are in it.

    Args:
        graph: The layout of ``graph.json``, with at least one cluster.
        seconds: How long the stretch is; longer where hardly any clusters are in it.

    Returns:
        Its start and end in nanoseconds.
    """
    stamps = np.sort([int(item['stamp_ns']) for item in graph['clusters']])
    fixes = [
        member['stamp_ns']
        for item in graph['clusters']
        for member in item['members']
        if member['kind'] == 'gnss'
    ]
    first, last, length = int(stamps[0]), int(stamps[-1]), round(seconds * NANOSECONDS)
    middle = (first + last) // 2
    centre = min(fixes, key=lambda stamp: abs(stamp - middle), default=middle)
    start = max(min(centre - length // 2, last - length), first)
    inside = int(np.sum((stamps >= start) & (stamps <= start + length)))
    if inside >= min(FEWEST_CLUSTERS, len(stamps)):
        return start, start + length
    # As many as there should be, where they are the nearest to each other.
    more = min(FEWEST_CLUSTERS, len(stamps)) - 1
    spans = stamps[more:] - stamps[: len(stamps) - more]
    begin = int(np.argmin(spans))
    margin = max(int(spans[begin]) // 10, (length - int(spans[begin])) // 2)
    return int(stamps[begin]) - margin, int(stamps[begin + more]) + margin


def sensor_names(graph: Record) -> tuple[list[str], list[str]]:
    """Names of the LiDARs and of the other sensors, sorted."""
    kinds = {
        member['sensor']: member['kind'] for item in graph['clusters'] for member in item['members']
    }
    lidars = sorted(name for name, kind in kinds.items() if kind == 'lidar')
    return lidars, sorted(kinds.keys() - set(lidars))


def unconnected_variables(graph: Record) -> set[str]:
    """Keys of the variables that no path of factors joins to the largest part of the graph."""
    from scipy.sparse.csgraph import connected_components  # 25 ms, and for pictures alone

    keys = [item['key'] for item in graph['variables']]
    number = {key: index for index, key in enumerate(keys)}
    edges = [
        (number[factor['variables'][0]], number[key])
        for factor in graph['factors']
        for key in factor['variables'][1:]
    ]
    if not keys:
        return set()
    ends = np.array(edges, dtype=np.int64).reshape(-1, 2)
    links = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(len(keys),) * 2)
    part = connected_components(links, directed=False)[1]
    largest = int(np.bincount(part).argmax())
    return {key for key, own in zip(keys, part, strict=True) if own != largest}


def closure_ends(graph: Record) -> NDArray[np.float64]:
    """Positions (K, 2, 3) of the pairs of poses that closures hold together, metres in the map."""
    places = {item['key']: item['value'][:3] for item in graph['variables']}
    ends = [
        [places[key] for key in factor['variables']]
        for factor in graph['factors']
        if factor['kind'] == 'closure'
    ]
    return np.array(ends, dtype=np.float64).reshape(-1, 2, 3)


def spread_clusters(clusters: Sequence[Record], origin: int, gap: float) -> dict[int, float]:
    """Where the clusters' variables are drawn: at their stamps, but so far apart that all show.

    Groups of close clusters are spread about their common centre.

    Args:
        clusters: Those of ``graph.json``, in any order.
        origin: Stamp (ns) of second 0.
        gap: Seconds between two clusters at least.

    Returns:
        Seconds since the origin by the id of the cluster.
    """
    from scipy.optimize import isotonic_regression  # 45 ms, and for pictures alone

    ordered = sorted(clusters, key=lambda item: int(item['stamp_ns']))
    # Less the gaps before it, a cluster may stand where the next one does: what is left is to
    # find the ascending sequence nearest to the wanted one, which isotonic regression does.
    room = gap * np.arange(len(ordered))
    wanted = np.array([(item['stamp_ns'] - origin) / NANOSECONDS for item in ordered]) - room
    placed = isotonic_regression(wanted).x + room if len(ordered) > 0 else wanted
    return {item['id']: float(x) for item, x in zip(ordered, placed, strict=True)}
