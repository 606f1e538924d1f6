"""Merging adjacent core measurements into clusters (paper, Algorithm 1, steps 2 and 3)."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import combinations, groupby

from incremental_mapper.candidates.model import Cluster, CoreKind, CoreMeasurement

Element = tuple[CoreMeasurement, ...]
"""Core measurements with the same stamp: they are never split."""


def group_elements(core: Iterable[CoreMeasurement]) -> tuple[Element, ...]:
    """Group core measurements by stamp ; the elements are never split.

    Args:
        core: Core measurements in any order.

    Returns:
        The elements in time order.
    """
    return tuple(tuple(group) for _, group in groupby(sorted(core), key=lambda core: core.stamp))


def compositions(length: int) -> Iterator[tuple[tuple[int, int], ...]]:
    """Cut a row of elements into runs, in all 2^(length-1) ways (paper, appendix).

    Args:
        length: Number of elements, at least one.

    Yields:
        The runs of one composition as (first, last) positions. The finest composition, every
        element by itself, comes first.
    """
    for cuts in range(length - 1, -1, -1):
        for inner in combinations(range(1, length), cuts):
            edges = (0, *inner, length)
            yield tuple((edges[i], edges[i + 1] - 1) for i in range(len(edges) - 1))


def make_cluster(elements: Sequence[Element], first: int, last: int) -> Cluster | None:
    """Merge neighbouring elements into one cluster (paper, Algorithm 1, step 3).

    Args:
        elements: The window's elements in time order.
        first: Position of the first element of the cluster.
        last: Position of its last one.

    Returns:
        The cluster; None where two scans of one LiDAR would meet: their odometry would connect the
        pose variable with itself, a loop.
    """
    members = tuple(core for part in elements[first : last + 1] for core in part)
    lidars = [core.sensor for core in members if core.kind is CoreKind.LIDAR]
    if len(set(lidars)) < len(lidars):
        return None
    return Cluster(members=members, first=first, last=last)


def partitions(elements: Sequence[Element]) -> Iterator[tuple[Cluster, ...]]:
    """All loop-free partitions of a window (paper, Algorithm 1, step 3).

    Args:
        elements: The window's elements in time order.

    Yields:
        The clusters of one partition in time order; at most 2^(N-1) partitions, the finest first.
    """
    if not elements:
        return
    cache: dict[tuple[int, int], Cluster | None] = {}
    for composition in compositions(len(elements)):
        clusters: list[Cluster] = []
        for run in composition:
            if run not in cache:
                cache[run] = make_cluster(elements, *run)
            cluster = cache[run]
            if cluster is None:
                break
            clusters.append(cluster)
        else:
            yield tuple(clusters)
