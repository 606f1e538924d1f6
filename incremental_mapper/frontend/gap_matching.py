"""Matching two scans that are seconds apart: the motion between them is hardly known.

A match counts where starts around the guess lead to it, so that the scene holds it from all sides,
where it explains the scan closely, and where matching the other way round leads back.
"""

from dataclasses import dataclass
from typing import TypeAlias

import gtsam
import numpy as np
import small_gicp
from numpy.typing import NDArray

from incremental_mapper.config import OdometrySettings
from incremental_mapper.frontend.match_noise import match_covariance
from incremental_mapper.geometry import transform_points

LONG = 1.0
"""Seconds from which on a match must prove itself so. For less, motion is steady enough to guess by
it."""
STARTS = ((0.0, 0.0), (2.0, 0.0), (-2.0, 0.0), (0.0, 0.15), (0.0, -0.15))
"""Where matching starts beside the steady motion: metres ahead, radians to the left. On bare
ground, and between walls along the way, each of them ends elsewhere."""
WITNESSES = 4
"""So many starts must lead to one result."""
LEVEL = 0.8
"""Upward part of a normal from which on a point counts as ground, which looks alike everywhere."""
EXPLAINED = {0.4: 0.65, 0.2: 0.3}
"""Metres to the nearest point, and what share of the points off the ground must have one within
them. Tilted VLP-16s see the same rings 9 m on, and all starts lead to 'standing': 0.43 and 0.13 of
the points are explained then. Standing cars have 0.99 and 0.91, 0.9 m of way 0.78 and 0.38."""
FEWEST = 50
"""Points off the ground without which nothing can be told."""
NEIGHBOURS = 10
"""Points that tell a normal."""
SAME_TRANSLATION, SAME_ROTATION = 0.2, 0.02
"""Metres and radians within which two results are one."""

GapMatch: TypeAlias = tuple[gtsam.Pose3, float, NDArray[np.float64] | None]


@dataclass(frozen=True, slots=True, eq=False)
class ScanCloud:
    """A thinned scan with its covariances, ready to be matched."""

    cloud: small_gicp.PointCloud
    tree: small_gicp.KdTree

    @property
    def points(self) -> NDArray[np.float64]:
        """Points (N, 3) in base_link, metres."""
        points: NDArray[np.float64] = self.cloud.points()[:, :3]
        return points


def match_over_gap(
    previous: ScanCloud, current: ScanCloud, guess: gtsam.Pose3, settings: OdometrySettings
) -> GapMatch | None:
    """Find the motion between two scans that are seconds apart.

    Args:
        previous: The earlier scan.
        current: The later one.
        guess: T_previous_current by the motion before the gap.
        settings: Those of odometry.

    Returns:
        T_previous_current, the share of points with a partner and the covariance of the motion, see
        ``match_covariance``; None where no match is certain.
    """
    found: list[GapMatch] = []
    for place, (ahead, turned) in enumerate(STARTS):
        off = gtsam.Pose3(gtsam.Rot3.Yaw(turned), np.array([ahead, 0.0, 0.0]))
        result = _align(previous, current, guess.compose(off), settings)
        if result is not None and result[1] >= settings.min_overlap:
            found.append(result)
        if len(found) < WITNESSES + place + 1 - len(STARTS):
            return None
    best = max(found, key=lambda one: sum(_same(one[0], other[0]) for other in found))
    if sum(_same(best[0], other[0]) for other in found) < WITNESSES:
        return None
    if not _explained(previous, current, best[0]):
        return None
    back = _align(current, previous, best[0].inverse(), settings)
    return best if back is not None and _same(back[0].inverse(), best[0]) else None


def _explained(previous: ScanCloud, current: ScanCloud, pose: gtsam.Pose3) -> bool:
    """Whether what stands on the ground is where it was."""
    small_gicp.estimate_normals(current.cloud, current.tree, num_neighbors=NEIGHBOURS)
    upright = np.abs(np.asarray(current.cloud.normals())[:, 2]) < LEVEL
    moved = transform_points(pose.matrix(), current.points[upright])
    if len(moved) < FEWEST:
        return False
    _, squares = previous.tree.batch_nearest_neighbor_search(moved)
    near = np.asarray(squares)
    return all(np.mean(near < metres**2) >= share for metres, share in EXPLAINED.items())


def _align(
    target: ScanCloud, source: ScanCloud, guess: gtsam.Pose3, settings: OdometrySettings
) -> GapMatch | None:
    """T_target_source, the share of points with a partner, and the covariance of the motion."""
    result = small_gicp.align(
        target.cloud,
        source.cloud,
        target.tree,
        init_T_target_source=guess.matrix(),
        registration_type='GICP',
        max_correspondence_distance=settings.max_correspondence,
        max_iterations=30,
        rotation_epsilon=0.005,
        translation_epsilon=0.02,
    )
    motion = np.asarray(result.T_target_source)
    if not np.isfinite(motion).all():
        return None
    overlap = result.num_inliers / max(source.cloud.size(), 1)
    return gtsam.Pose3(motion), overlap, match_covariance(result, source.cloud, settings)


def _same(one: gtsam.Pose3, other: gtsam.Pose3) -> bool:
    apart = gtsam.Pose3.Logmap(one.between(other))
    return bool(
        np.linalg.norm(apart[3:]) < SAME_TRANSLATION and np.linalg.norm(apart[:3]) < SAME_ROTATION
    )
