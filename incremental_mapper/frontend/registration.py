"""Scan matching between consecutive scans of one LiDAR, behind one protocol."""

from collections import deque
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import gtsam
import numpy as np
import small_gicp
from numpy.typing import NDArray

from incremental_mapper.config import OdometryMethod, OdometrySettings
from incremental_mapper.frontend.gap_matching import ScanCloud, match_over_gap
from incremental_mapper.frontend.match_noise import match_covariance
from incremental_mapper.geometry import transform_points
from incremental_mapper.voxels import thin

NEIGHBOURS = 10
"""Points of which gicp takes the covariance; 8 or 14 give worse motions on two tilted VLP-16."""
ROTATION_STEP, TRANSLATION_STEP = 0.01, 0.03
"""Gicp stops after a step that is smaller, in rad and m. Steps shrink several times from one to
the next, so what is left is far below the noise of a match. Where the motion is steady, the first
step is the last; bounds a third as large take half as many steps again and
match no better."""


Clouds: TypeAlias = list[NDArray[np.float64]]


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """Motion between two scans, ``T_previous_current``, and how much of the scan it explains.

    ``overlap`` is the share of points that found a partner, 1 where the matcher does not tell;
    ``covariance`` (6, 6) is that of the motion, in the current scan's frame and in GTSAM's order,
    rotation before translation; None where the matcher does not tell.
    """

    T_previous_current: gtsam.Pose3
    overlap: float = 1.0
    covariance: NDArray[np.float64] | None = None


class ScanMatcher(Protocol):
    """Matches the scans of one LiDAR one after the other."""

    def match(self, points: NDArray[np.float64], guess: gtsam.Pose3) -> Match | None:
        """Match a scan, points (N, 3) in base_link, to the previous one.

        ``guess`` is T_previous_current as far as it is known. The first scan gives None.
        """

    def undo(self) -> bool:
        """Forget the last scan, to match it again from elsewhere; false where that cannot be."""

    def match_over_gap(self, points: NDArray[np.float64], guess: gtsam.Pose3) -> Match | None:
        """As ``match`` with a scan seconds later; None where no match is certain."""


class KissMatcher:
    """KISS-ICP: point-to-point against its own local map, the paper's front end.

    It predicts by constant velocity itself, so the guess is not used.
    """

    def __init__(self, settings: OdometrySettings) -> None:
        # Imported where it is used: a process for each LiDAR starts the sooner without it.
        from kiss_icp.config import load_config
        from kiss_icp.kiss_icp import KissICP

        config = load_config(None)
        config.data.deskew = False  # done before, where the cloud has usable point times
        config.data.min_range = 0.0  # gated before, in the LiDAR's frame
        config.data.max_range = settings.max_range + 10.0
        config.mapping.voxel_size = settings.voxel_size
        self._icp = KissICP(config)
        self._started = False

    def match(self, points: NDArray[np.float64], guess: gtsam.Pose3) -> Match | None:
        """See ScanMatcher."""
        before = self._icp.last_pose
        self._icp.register_frame(points, np.array([]))
        if not self._started:
            self._started = True
            return None
        motion = np.linalg.inv(before) @ self._icp.last_pose
        if not np.isfinite(motion).all():
            return Match(guess, overlap=0.0)
        return Match(gtsam.Pose3(motion))

    def undo(self) -> bool:
        """See ScanMatcher: KISS-ICP guesses by itself, and would from the same place."""
        return False

    def match_over_gap(self, points: NDArray[np.float64], guess: gtsam.Pose3) -> Match | None:
        """See ScanMatcher: KISS-ICP does not tell how certain it is."""
        return None


class GicpMatcher:
    """small_gicp: generalised ICP to the previous scan, or to a sliding map of several."""

    def __init__(self, settings: OdometrySettings) -> None:
        self._settings = settings
        self._recent: deque[tuple[small_gicp.PointCloud, small_gicp.KdTree]] = deque(maxlen=1)
        # Points of the last scans, each in the newest scan's frame.
        self._window: deque[NDArray[np.float64]] = deque(maxlen=settings.local_map_scans)
        self._before: tuple[list[tuple[small_gicp.PointCloud, small_gicp.KdTree]], Clouds] = (
            [],
            [],
        )

    def match(self, points: NDArray[np.float64], guess: gtsam.Pose3) -> Match | None:
        """See ScanMatcher."""
        settings = self._settings
        self._before = [*self._recent], [*self._window]
        cloud, tree = self._with_covariances(self._near(points))
        match: Match | None = None
        if self._recent:
            target, target_tree = self._target()
            result = small_gicp.align(
                target,
                cloud,
                target_tree,
                init_T_target_source=guess.matrix(),
                registration_type='GICP',
                max_correspondence_distance=settings.max_correspondence,
                max_iterations=30,
                rotation_epsilon=ROTATION_STEP,
                translation_epsilon=TRANSLATION_STEP,
            )
            motion = np.asarray(result.T_target_source)
            finite = bool(np.isfinite(motion).all())
            pose = gtsam.Pose3(motion) if finite else guess
            overlap = result.num_inliers / max(cloud.size(), 1) if finite else 0.0
            match = Match(
                pose, overlap, match_covariance(result, cloud, settings) if finite else None
            )
            back = pose.inverse().matrix()
            for i, older in enumerate(self._window):
                self._window[i] = transform_points(back, older)
        self._recent.append((cloud, tree))
        if settings.local_map_scans > 1:
            self._window.append(cloud.points()[:, :3])
        return match

    def undo(self) -> bool:
        """See ScanMatcher."""
        recent, window = self._before
        self._recent.clear()
        self._recent.extend(recent)
        self._window.clear()
        self._window.extend(window)
        return True

    def match_over_gap(self, points: NDArray[np.float64], guess: gtsam.Pose3) -> Match | None:
        """See ScanMatcher."""
        cloud, tree = self._with_covariances(self._near(points))
        before = ScanCloud(*self._recent[0])
        found = match_over_gap(before, ScanCloud(cloud, tree), guess, self._settings)
        if found is None:
            return None
        self._recent.append((cloud, tree))
        # What was near seconds ago is hardly seen any more.
        self._window.clear()
        if self._settings.local_map_scans > 1:
            self._window.append(cloud.points()[:, :3])
        return Match(*found)

    def _near(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """The points (N, 3) that are near enough; all of them where those are too few."""
        settings = self._settings
        near = np.flatnonzero(points[:, 0] ** 2 + points[:, 1] ** 2 < settings.match_range**2)
        if len(near) < settings.min_points:
            return points
        return points.T.take(near, axis=1).T  # along the rows, as clouds are kept

    def _target(self) -> tuple[small_gicp.PointCloud, small_gicp.KdTree]:
        if self._settings.local_map_scans == 1:
            return self._recent[0]
        return self._with_covariances(np.vstack(self._window))

    def _with_covariances(
        self, points: NDArray[np.float64]
    ) -> tuple[small_gicp.PointCloud, small_gicp.KdTree]:
        cloud = small_gicp.PointCloud(thin(points, self._settings.voxel_size))
        tree = small_gicp.KdTree(cloud)
        small_gicp.estimate_covariances(cloud, tree, num_neighbors=NEIGHBOURS)
        return cloud, tree


def make_matcher(settings: OdometrySettings) -> ScanMatcher:
    """The scan matcher that the settings name."""
    if settings.method is OdometryMethod.KISS_ICP:
        return KissMatcher(settings)
    return GicpMatcher(settings)
