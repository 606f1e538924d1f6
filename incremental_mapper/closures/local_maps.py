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


def cut_local_maps(
    clusters: Sequence[PlacedCluster],
    scans: Sequence[PlacedScan],
    values: gtsam.Values,
    settings: ClosureSettings,
    run: int = 0,
    wanted: Collection[int] | None = None,
) -> list[LocalMap]:
    """Cut the scans of a drive into local maps along its way.

    Args:
        clusters: All clusters, each at the place of its number.
        scans: All scans, in the order in which they came.
        values: The poses of the clusters.
        settings: Length and voxel size of a local map.
        run: The number that the local maps get.
        wanted: Clusters whose local maps get points, the others none; None is all of them.

    Returns:
        They, in the order of the way; a stretch without scans has none.

    Raises:
        OutputError: A scan cannot be read back.
    """
    if not clusters:
        return []
    poses = [values.atPose3(pose_key(placed.id)) for placed in clusters]
    positions = np.array([pose.translation() for pose in poses])
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    travelled = np.append(0.0, np.cumsum(steps))
    stretches = (travelled / settings.map_length).astype(np.int64)
    middles = {}
    for stretch in np.unique(stretches).tolist():
        centre = (stretch + 0.5) * settings.map_length
        middles[stretch] = int(np.abs(travelled - centre).argmin())
    made: list[LocalMap] = []
    for stretch, parts in _by_stretch(scans, stretches, travelled):
        middle = middles[stretch]
        own = poses[middle]
        clouds = [np.zeros((0, 3))]
        for scan in parts if wanted is None or middle in wanted else ():
            T_own_scan = own.between(poses[scan.cluster].compose(scan.T_cluster_scan))
            points = scan.points.astype(np.float64)
            near = np.einsum('ij,ij->i', points, points) < settings.max_range**2
            clouds.append(thin(transform_points(T_own_scan.matrix(), points[near]), 0.2))
        points = thin(np.vstack(clouds), settings.voxel_size)
        stamp = clusters[middle].cluster.stamp
        far = float(travelled[middle])
        made.append(LocalMap(middle, stamp, own, far, points.astype(np.float32), run))
    return made


def _by_stretch(
    scans: Sequence[PlacedScan], stretches: NDArray[np.int64], travelled: NDArray[np.float64]
) -> Iterator[tuple[int, list[PlacedScan]]]:
    """The scans of each stretch of way, without those of a LiDAR that has hardly moved."""
    parts: list[PlacedScan] = []
    latest: dict[str, float] = {}
    for scan in scans:
        here = float(travelled[scan.cluster])
        if here - latest.get(scan.sensor, -np.inf) < STRIDE:
            continue
        latest[scan.sensor] = here
        if parts and stretches[parts[0].cluster] != stretches[scan.cluster]:
            yield int(stretches[parts[0].cluster]), parts
            parts = []
        parts.append(scan)
    if parts:
        yield int(stretches[parts[0].cluster]), parts
