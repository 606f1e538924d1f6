"""Scan matching between consecutive scans of one LiDAR, behind one protocol."""

from dataclasses import dataclass
from typing import Protocol

import gtsam
import numpy as np
import small_gicp
from numpy.typing import NDArray

from incremental_mapper.config import OdometryMethod, OdometrySettings
from incremental_mapper.frontend.gap_matching import match_over_gap
from incremental_mapper.frontend.local_map import LocalMap, near, scan_cloud
from incremental_mapper.frontend.match_noise import match_covariance

ROTATION_STEP, TRANSLATION_STEP = 0.01, 0.03
"""Gicp stops after a step that is smaller, in rad and m. Steps shrink several times from one to
the next, so what is left is far below the noise of a match. Where the motion is steady, the first
step is the last; bounds a third as large take half as many steps again and
match no better."""


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """Motion between two scans, ``T_previous_current``, and how much of the scan it explains.

    ``overlap`` is the share of points that found a partner, 1 where the matcher does not tell, and
    ``misfit`` how badly they fit: the matcher's error for each of them, to be compared between
    matches of one scan. ``covariance`` (6, 6) is that of the motion, in the current scan's frame
    and in GTSAM's order, rotation before translation; None where the matcher does not tell.
    """

    T_previous_current: gtsam.Pose3
    overlap: float = 1.0
    misfit: float = 0.0
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
        self._map: LocalMap | None = None
        self._before: LocalMap | None = None

    def match(self, points: NDArray[np.float64], guess: gtsam.Pose3) -> Match | None:
        """See ScanMatcher."""
        settings, local = self._settings, self._map
        self._before = local
        scan = scan_cloud(near(points, settings), settings)
        if local is None:
            self._map = LocalMap.of_scan(scan)
            return None
        result = small_gicp.align(
            local.target.cloud,
            scan.cloud,
            local.target.tree,
            init_T_target_source=(local.T_map_newest * guess).matrix(),
            registration_type='GICP',
            max_correspondence_distance=settings.max_correspondence,
            max_iterations=30,
            rotation_epsilon=ROTATION_STEP,
            translation_epsilon=TRANSLATION_STEP,
        )
        matrix = np.asarray(result.T_target_source)
        finite = bool(np.isfinite(matrix).all())
        pose = local.T_map_newest.between(gtsam.Pose3(matrix)) if finite else guess
        self._map = local.with_scan(scan, pose, settings)
        overlap = result.num_inliers / max(scan.cloud.size(), 1) if finite else 0.0
        noise = match_covariance(result, scan.cloud, settings) if finite else None
        misfit = float(result.error) / max(int(result.num_inliers), 1)
        return Match(pose, overlap, misfit, noise)

    def undo(self) -> bool:
        """See ScanMatcher."""
        self._map = self._before
        return True

    def match_over_gap(self, points: NDArray[np.float64], guess: gtsam.Pose3) -> Match | None:
        """See ScanMatcher."""
        scan = scan_cloud(near(points, self._settings), self._settings)
        assert self._map is not None
        found = match_over_gap(self._map.newest, scan, guess, self._settings)
        if found is None:
            return None
        # What was near seconds ago is hardly seen any more.
        self._map = LocalMap.of_scan(scan)
        return Match(found[0], found[1], covariance=found[2])


def make_matcher(settings: OdometrySettings) -> ScanMatcher:
    """The scan matcher that the settings name."""
    if settings.method is OdometryMethod.KISS_ICP:
        return KissMatcher(settings)
    return GicpMatcher(settings)
