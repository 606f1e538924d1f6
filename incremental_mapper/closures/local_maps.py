"""Local maps: the scans of a stretch of way together, which look alike whenever it is passed."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.config import ClosureSettings
from incremental_mapper.geometry import transform_points
from incremental_mapper.smoothing.graph_state import PlacedCluster, PlacedScan
from incremental_mapper.variables import pose_key
from incremental_mapper.voxels import thin

STRIDE = 1.0
"""Metres of way between two scans of one LiDAR that enter a local map."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """A piece of way: clusters up to ``end``, from where the one before ends, seen from ``middle``.

    The numbers stay while poses move, and so does what was found out of two of them.
    """

    middle: int
    end: int


@dataclass(frozen=True, slots=True, eq=False)
class LocalMap:
    """The points of a stretch of way, seen from a pose in its middle.

    Attributes:
        cluster: The cluster of that pose.
        stamp: Its stamp, ns.
        T_map_base: Its pose, as far as it is known.
        travelled: Metres of way from the start of the drive to it.
        points: Points (N, 3) in base_link at that pose, metres.
        run: Tells drives apart, where local maps of several are compared.
    """

    cluster: int
    stamp: int
    T_map_base: gtsam.Pose3
    travelled: float
    points: NDArray[np.float32]
    run: int = 0


def cut_way(
    clusters: Sequence[PlacedCluster],
    values: gtsam.Values,
    length: float,
    before: Sequence[Stretch] = (),
) -> list[Stretch]:
    """Cut the way of a drive into stretches.

    Args:
        clusters: All clusters, each at the place of its number.
        values: Their poses.
        length: Of a stretch, metres.
        before: Stretches that were cut already, from the start on; they stay as they are.

    Returns:
        They, and those that follow; the last one may be shorter.
    """
    stretches, begin = list(before), before[-1].end if before else 0
    if begin >= len(clusters):
        return stretches
    travelled = _travelled(clusters, values)
    travelled -= travelled[begin]
    numbers = (travelled[begin:] / length).astype(np.int64)
    for number in np.unique(numbers).tolist():
        middle = int(np.abs(travelled - (number + 0.5) * length).argmin())
        end = begin + int(np.searchsorted(numbers, number, side='right'))
        stretches.append(Stretch(middle, end))
    return stretches


def cut_local_maps(
    stretches: Sequence[Stretch],
    clusters: Sequence[PlacedCluster],
    scans: Sequence[PlacedScan],
    values: gtsam.Values,
    settings: ClosureSettings,
    wanted: Collection[int] | None = None,
) -> list[LocalMap]:
    """Make local maps of the scans of a drive, along its way.

    Args:
        stretches: The way, cut; see ``cut_way``.
        clusters: All clusters, each at the place of its number.
        scans: All scans, in the order in which they came.
        values: The poses of the clusters.
        settings: Range and voxel size of a local map.
        wanted: Clusters whose local maps get points, the others none; None is all of them.

    Returns:
        They, in the order of the way; a stretch without scans has none.

    Raises:
        OutputError: A scan cannot be read back.
    """
    if not stretches:
        return []
    travelled = _travelled(clusters, values)
    made: list[LocalMap] = []
    for stretch, parts in _by_stretch(scans, stretches, travelled):
        middle = stretch.middle
        own = values.atPose3(pose_key(middle))
        clouds = [np.zeros((0, 3))]
        for scan in parts if wanted is None or middle in wanted else ():
            there = values.atPose3(pose_key(scan.cluster)).compose(scan.T_cluster_scan)
            T_own_scan = own.between(there)
            points = scan.points.astype(np.float64)
            near = np.einsum('ij,ij->i', points, points) < settings.max_range**2
            clouds.append(thin(transform_points(T_own_scan.matrix(), points[near]), 0.2))
        points = thin(np.vstack(clouds), settings.voxel_size)
        stamp = clusters[middle].cluster.stamp
        far = float(travelled[middle])
        made.append(LocalMap(middle, stamp, own, far, points.astype(np.float32)))
    return made


def _travelled(clusters: Sequence[PlacedCluster], values: gtsam.Values) -> NDArray[np.float64]:
    """Metres of way from the start to each cluster (N,)."""
    places = [values.atPose3(pose_key(placed.id)).translation() for placed in clusters]
    steps = np.linalg.norm(np.diff(np.array(places), axis=0), axis=1)
    return np.append(0.0, np.cumsum(steps))


def _by_stretch(
    scans: Sequence[PlacedScan], stretches: Sequence[Stretch], travelled: NDArray[np.float64]
) -> Iterator[tuple[Stretch, list[PlacedScan]]]:
    """The scans of each stretch of way, without those of a LiDAR that has hardly moved."""
    ends = np.array([stretch.end for stretch in stretches])
    own = np.searchsorted(ends, np.arange(ends[-1]), side='right')
    parts: list[PlacedScan] = []
    latest: dict[str, float] = {}
    for scan in scans:
        if scan.cluster >= ends[-1]:
            continue
        here = float(travelled[scan.cluster])
        if here - latest.get(scan.sensor, -np.inf) < STRIDE:
            continue
        latest[scan.sensor] = here
        if parts and own[parts[0].cluster] != own[scan.cluster]:
            yield stretches[own[parts[0].cluster]], parts
            parts = []
        parts.append(scan)
    if parts:
        yield stretches[own[parts[0].cluster]], parts
