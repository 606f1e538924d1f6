"""Is it the same place? Registration of two local maps, and what the result must withstand."""

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
import small_gicp
from numpy.typing import NDArray

from incremental_mapper.closures.candidate_pairs import Candidate, Known
from incremental_mapper.closures.local_maps import LocalMap
from incremental_mapper.config import ClosureSettings, OdometrySettings
from incremental_mapper.frontend.gap_matching import LEVEL, ScanCloud
from incremental_mapper.frontend.match_noise import loosest_shift, match_covariance
from incremental_mapper.geometry import transform_points

NEIGHBOURS = 15
"""Points that tell a surface."""
REACHES = (4.0, 1.5)
"""Largest distances of a correspondence, metres, one registration after the other."""
FINE = (0.5, 0.3)
"""The same of the last ones, by the distance of each point to the plane that it is matched to."""
SURE, LEAST_REACH = 3.0, 0.5
"""Standard deviations of what is known that are looked through, and metres at the least."""
SAME_TRANSLATION, SAME_ROTATION = 0.3, 0.01
"""Metres and radians within which registering the other way round must lead back."""
NEAR = 0.3
"""Metres to the nearest point within which a point is explained."""
FEWEST = 200
"""Points off the ground that both local maps must show of a place."""
UNCERTAIN = 4.0
"""Factor on the covariance of what is known: after minutes without fixes published variances are a
quarter of the squared error (``benchmarks/published_covariance.py``)."""
MOST_DISTANCE = 22.5
"""Squared Mahalanobis distance that one in a thousand exceeds, with six degrees of freedom."""
IMPROBABLE = 'improbable'
"""Why a candidate is none that what is known speaks against."""
GUESS = np.diag(np.square([0.1, 0.1, 0.1, 3.0, 3.0, 3.0]))
"""Covariance of where a candidate lies: registration takes it from there."""
KEPT = 20
"""Prepared local maps that are kept, 6 MB each; pairs come in the order of the way."""


@dataclass(frozen=True, slots=True, eq=False)
class Closure:
    """Two local maps of one place.

    Attributes:
        first: Place of the earlier local map in the list.
        second: Place of the later one.
        T_first_second: Its pose in the earlier one's frame.
        covariance: (6, 6), in the frame of the second, rotation first.
        overlap: Share of what stands on the ground that both show, of what both could see.
    """

    first: int
    second: int
    T_first_second: gtsam.Pose3
    covariance: NDArray[np.float64]
    overlap: float


@dataclass(frozen=True, slots=True, eq=False)
class _Prepared:
    """A local map ready to be registered, and its points (N, 3) that stand on the ground."""

    scan: ScanCloud
    upright: NDArray[np.float64]
    upright_tree: small_gicp.KdTree


class Verifier:
    """Verifies candidates among local maps."""

    def __init__(
        self, maps: Sequence[LocalMap], settings: ClosureSettings, odometry: OdometrySettings
    ) -> None:
        self._maps, self._settings, self._odometry = maps, settings, odometry
        self._prepared: OrderedDict[int, _Prepared] = OrderedDict()

    def verify(
        self, candidate: Candidate, known: Known | None, once: bool = False
    ) -> Closure | str:
        """The closure that a candidate proves to be, or in a word why it is none.

        Args:
            candidate: Two local maps.
            known: What is known of their relative pose. It must allow the candidate
                (``conceivable``), and may still speak against what comes of it (``probable``).
            once: Whether what is improbable by now may be left at that.
        """
        pose = candidate.T_first_second
        first, second = self._ready(candidate.first), self._ready(candidate.second)
        reaches = _reaches(known)
        matched = _matched(first.scan, second.scan, pose, reaches)
        if matched is None:
            return 'no_match'
        pose = matched
        overlap = _overlap(first, second, pose)
        if overlap < self._settings.min_overlap:
            return 'no_overlap'
        result = _align(first.scan, second.scan, pose, reaches[-1], iterations=1)
        covariance = match_covariance(result, second.scan.cloud, self._odometry)
        floor = np.diag(
            np.square([self._settings.floor_rotation] * 3 + [self._settings.floor_translation] * 3)
        )
        covariance = floor if covariance is None else covariance + floor
        found = Closure(candidate.first, candidate.second, pose, covariance, overlap)
        if once and not probable(found, known):
            return IMPROBABLE
        back = _matched(second.scan, first.scan, pose.inverse(), reaches[-1:])
        if back is None or not _same(back.inverse(), pose):
            return 'one_way'
        return found

    def _ready(self, place: int) -> _Prepared:
        if place in self._prepared:
            self._prepared.move_to_end(place)
            return self._prepared[place]
        cloud = small_gicp.PointCloud(self._maps[place].points.astype(np.float64))
        tree = small_gicp.KdTree(cloud)
        small_gicp.estimate_normals_covariances(cloud, tree, num_neighbors=NEIGHBOURS)
        upright = np.abs(np.asarray(cloud.normals())[:, 2]) < LEVEL
        standing = np.ascontiguousarray(cloud.points()[upright, :3])
        made = _Prepared(ScanCloud(cloud, tree), standing, small_gicp.KdTree(standing))
        self._prepared[place] = made
        if len(self._prepared) > KEPT:
            self._prepared.popitem(last=False)
        return made


def conceivable(candidate: Candidate, known: Known | None) -> bool:
    """Whether what is known of the relative pose allows a closure near where a candidate lies.

    Args:
        candidate: It.
        known: What is known; None is nothing.
    """
    return known is None or _distance(known, candidate.T_first_second, GUESS) <= MOST_DISTANCE


def probable(closure: Closure, known: Known | None) -> bool:
    """Whether what is known of the relative pose allows a closure.

    Args:
        closure: It.
        known: What is known; None is nothing.
    """
    if known is None:
        return True
    return _distance(known, closure.T_first_second, closure.covariance) <= MOST_DISTANCE


def _reaches(known: Known | None) -> tuple[float, ...]:
    """Where to look for correspondences: no further than what is known may be off.

    Two local maps that share little are else drawn over each other, since GICP holds points along
    their planes, too, if weakly.
    """
    if known is None:
        return REACHES
    off = SURE * float(np.sqrt(UNCERTAIN * loosest_shift(known.covariance)))
    # Twice the same would lead nowhere else.
    return tuple(dict.fromkeys(min(reach, max(off, LEAST_REACH)) for reach in REACHES))


def _matched(
    target: ScanCloud, source: ScanCloud, guess: gtsam.Pose3, reaches: Sequence[float]
) -> gtsam.Pose3 | None:
    """T_target_source by GICP, and then by distances to planes alone; None where they fail."""
    stages = [('GICP', reach) for reach in reaches] + [('PLANE_ICP', reach) for reach in FINE]
    for kind, reach in stages:
        found = np.asarray(_align(target, source, guess, reach, kind).T_target_source)
        if not np.isfinite(found).all():
            return None
        guess = gtsam.Pose3(found)
    return guess


def _align(
    target: ScanCloud,
    source: ScanCloud,
    guess: gtsam.Pose3,
    reach: float,
    kind: str = 'GICP',
    iterations: int = 30,
) -> small_gicp.RegistrationResult:
    return small_gicp.align(
        target.cloud,
        source.cloud,
        target.tree,
        init_T_target_source=guess.matrix(),
        registration_type=kind,
        max_correspondence_distance=reach,
        max_iterations=iterations,
        rotation_epsilon=0.001,
        translation_epsilon=0.005,
    )


def _overlap(first: _Prepared, second: _Prepared, T_first_second: gtsam.Pose3) -> float:
    """Share of what stands on the ground that both show, where both have seen anything."""
    moved = transform_points(T_first_second.matrix(), second.upright)
    shares = []
    for own, tree, others in (
        (moved, first.upright_tree, first.upright),
        (first.upright, small_gicp.KdTree(moved), moved),
    ):
        if len(own) < FEWEST or len(others) < FEWEST:
            return 0.0
        low, high = np.percentile(others, [5.0, 95.0], axis=0)
        inside = ((own > low) & (own < high)).all(axis=1)
        if inside.sum() < FEWEST:
            return 0.0
        _, squares = tree.batch_nearest_neighbor_search(np.ascontiguousarray(own[inside]))
        shares.append(float(np.mean(np.asarray(squares) < NEAR**2)))
    return min(shares)


def _distance(known: Known, found: gtsam.Pose3, covariance: NDArray[np.float64]) -> float:
    """Squared Mahalanobis distance of a closure from what was known."""
    apart = gtsam.Pose3.Logmap(known.T_first_second.between(found))
    return float(apart @ np.linalg.solve(UNCERTAIN * known.covariance + covariance, apart))


def _same(one: gtsam.Pose3, other: gtsam.Pose3) -> bool:
    apart = gtsam.Pose3.Logmap(one.between(other))
    return bool(
        np.linalg.norm(apart[3:]) < SAME_TRANSLATION and np.linalg.norm(apart[:3]) < SAME_ROTATION
    )
