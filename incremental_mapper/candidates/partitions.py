"""Merging adjacent core measurements into clusters (paper, Algorithm 1, steps 2 and 3)."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import combinations, groupby

from incremental_mapper.candidates.model import Cluster, CoreKind, CoreMeasurement

Element = tuple[CoreMeasurement, ...]
"""Core measurements with the same stamp: they are never split."""


def group_elements(core: Iterable[CoreMeasurement]) -> tuple[Element, ...]:
    """Group core measurements by stamp, in time order."""
    return tuple(tuple(group) for _, group in groupby(sorted(core), key=lambda core: core.stamp))


def compositions(length: int) -> Iterator[tuple[tuple[int, int], ...]]:
    """All 2^(length-1) ways of cutting 0..length-1 into runs, as (first, last) positions.

    The finest composition, every element by itself, comes first.
    """
    for cuts in range(length - 1, -1, -1):
        for inner in combinations(range(1, length), cuts):
            edges = (0, *inner, length)
            yield tuple((edges[i], edges[i + 1] - 1) for i in range(len(edges) - 1))


def make_cluster(elements: Sequence[Element], first: int, last: int) -> Cluster | None:
    """Cluster of the elements first..last, or None where two scans of one LiDAR would meet.

    Their odometry would connect the pose variable with itself, a loop.
    """
    members = tuple(core for part in elements[first : last + 1] for core in part)
    lidars = [core.sensor for core in members if core.kind is CoreKind.LIDAR]
    if len(set(lidars)) < len(lidars):
        return None
    return Cluster(members=members, first=first, last=last)


def partitions(elements: Sequence[Element]) -> Iterator[tuple[Cluster, ...]]:
    """All loop-free partitions of a window's elements; at most 2^(N-1)."""
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
