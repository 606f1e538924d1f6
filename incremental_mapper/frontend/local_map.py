"""What gicp matches a scan to: the scan before, or a sliding map of several.

The map keeps the frame of the scan it was built at, and serves several scans before it is built
anew: covariances and search tree of so many points cost more than a match.
"""

from dataclasses import dataclass, replace
from typing import Self

import gtsam
import numpy as np
import small_gicp
from numpy.typing import NDArray

from incremental_mapper.config import OdometrySettings
from incremental_mapper.frontend.gap_matching import ScanCloud
from incremental_mapper.geometry import transform_points
from incremental_mapper.voxels import thin

NEIGHBOURS = 10
"""Points of which gicp takes the covariance; 8 or 14 give worse motions on two tilted VLP-16."""
RENEWAL, FAR, TURNED = 5, 4.0, 0.35
"""Scans after which a map is built anew, and metres and radians from where it was. Over a second
motions are as good with 3 to 5 scans as with a map for each scan, from one scan to the next some
are a quarter worse; with 6 and more, fast cars leave the map behind. A LiDAR that sees to one side
turns away from it."""


@dataclass(frozen=True, slots=True, eq=False)
class LocalMap:
    """The target of the next matches.

    ``target`` is in the frame of the map, that of one of its scans. ``newest`` is the last scan, in
    a frame of its own, which lies at ``T_map_newest``. ``scans`` are the points (N, 3) of the last
    scans in the frame of the map, metres; ``fresh`` says how many have come since the target was
    built, and ``whole`` that it had as many then as it may have.
    """

    target: ScanCloud
    newest: ScanCloud
    T_map_newest: gtsam.Pose3
    scans: tuple[NDArray[np.float64], ...]
    whole: bool = False
    fresh: int = 0

    @classmethod
    def of_scan(cls, scan: ScanCloud) -> Self:
        """The map of a single scan, in its frame."""
        return cls(scan, scan, gtsam.Pose3(), (scan.points,))

    def with_scan(
        self, scan: ScanCloud, T_newest_scan: gtsam.Pose3, settings: OdometrySettings
    ) -> 'LocalMap':
        """The map with one more scan, and without those that are too old for it."""
        most = settings.local_map_scans
        if most == 1:
            return LocalMap.of_scan(scan)
        T_map_scan = self.T_map_newest * T_newest_scan
        older = self.scans[1 - most :]
        if self.whole and self.fresh + 1 < RENEWAL and _near_by(T_map_scan):
            points = transform_points(T_map_scan.matrix(), scan.points)
            return replace(
                self,
                newest=scan,
                T_map_newest=T_map_scan,
                scans=(*older, points),
                fresh=self.fresh + 1,
            )
        back = T_map_scan.inverse().matrix()
        scans = (*(transform_points(back, points) for points in older), scan.points)
        target = scan_cloud(np.vstack(scans), settings)
        return LocalMap(target, scan, gtsam.Pose3(), scans, whole=len(scans) == most)


def _near_by(T_map_scan: gtsam.Pose3) -> bool:
    step = gtsam.Rot3.Logmap(T_map_scan.rotation())
    shift = T_map_scan.translation()
    return float(shift @ shift) < FAR**2 and float(step @ step) < TURNED**2


def scan_cloud(points: NDArray[np.float64], settings: OdometrySettings) -> ScanCloud:
    """Points (N, 3), metres, thinned and with the covariances that gicp needs."""
    cloud = small_gicp.PointCloud(thin(points, settings.voxel_size))
    tree = small_gicp.KdTree(cloud)
    small_gicp.estimate_covariances(cloud, tree, num_neighbors=NEIGHBOURS)
    return ScanCloud(cloud, tree)


def near(points: NDArray[np.float64], settings: OdometrySettings) -> NDArray[np.float64]:
    """The points (N, 3) that are near enough to match; all of them where those are too few."""
    within = np.flatnonzero(points[:, 0] ** 2 + points[:, 1] ** 2 < settings.match_range**2)
    if len(within) < settings.min_points:
        return points
    return points.T.take(within, axis=1).T  # along the rows, as clouds are kept
