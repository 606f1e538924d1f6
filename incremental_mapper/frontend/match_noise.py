"""How far a match may be off, direction by direction, by the registration's own least squares.

GICP takes every point for a piece of a plane, and minimises half the sum of rᵀ M r over its pairs.
The Hessian of that tells in which directions the scene holds the match, and the mean of rᵀ M r how
well the scans fit: it is 0.5 on simulated streets and on real VLP-16s of KAIST, 1 on KITTI. Points
are not independent, and consecutive matches repeat each other's errors, so that the least-squares
covariance alone is too small: its scale and floor are held against drives with truth
(``benchmarks/match_noise.py``).

How well a direction is held is what a pair holds of it on the average, beside a pair that held it
from all sides with 1/m^2: a turn and a shift are compared by how far they move the points, and no
count of the points comes in. This *hold* is 5 to 500 in streets. Along a bare field it is 0.1 to 6,
and noise in the planes' normals makes all of it: matches are 0.11 to 0.14 m off however large it
is, 0.02 to 0.03 m in every one of them to the same side, towards standing still.
"""

import gtsam
import numpy as np
import small_gicp
from numpy.typing import NDArray

from incremental_mapper.config import MatchNoise, OdometrySettings

WEAK_TRANSLATION, WEAK_ROTATION = 0.13, 0.026
"""Standard deviations of a match, metres and radians, from which on a direction is weak."""
WEAK = 'held weakly in some direction'
"""The note under which such matches are counted."""
IN_PLANE = 0.5
"""1/m^2; what M says of a pair even along its planes, each of which is given a variance of 1 m^2
there. It says nothing of the scene: without it a bare field holds no match along the ground."""
FALSE_HOLD = 10.0
"""1/m^2; how much of a hold normals that are off may make, where there is a true one beside. Errors
over a second are likeliest with 3, over four seconds with 14. KITTI's matches need it, too."""
NO_HOLD, SLIP = 3.0, 0.15
"""1/m^2, a hold that normals which are off may make by themselves, and the metres of the points by
which such a match slips. The covariance must not follow a hold that is noise: matches that happen
to have more of it would be believed, and are no better. With 0.1 m some headings in fields still
drift and are too sure; with 0.25 m and more they are as good, and less sure than they could be."""
SKEW = 0.02
"""Radians by which directions themselves are off, as the normals are that tell them: by so much of
it an error along the ground lifts and tilts a match. 0.01 is likeliest from one scan to the next,
and with 0.02 no five seconds of ten chains in bare fields are 2 deviations off or more."""
LEAST = 1e-3
"""1/m^2, a hold that is none."""
LOOSEST = 1.0
"""Metres of the points, root mean square, that a match is never further off in any direction: a
registration does not step so far."""
SMALLEST = 0.1
"""Metres; points on one line are taken to be as thick, so that a turn about it moves them."""


def match_covariance(
    result: small_gicp.RegistrationResult, source: small_gicp.PointCloud, settings: OdometrySettings
) -> NDArray[np.float64] | None:
    """Covariance of a match.

    small_gicp moves the source by T_target_source · Exp(d) with the rotation first, as GTSAM does:
    its Hessian is in the frame of the source, and in GTSAM's order.

    Args:
        result: Of GICP.
        source: The cloud that was matched.
        settings: Those of odometry.

    Returns:
        Covariance (6, 6) in the frame of the source, rad^2 and m^2; None where the settings want
        the same for all matches, or the Hessian tells nothing.
    """
    if settings.noise is MatchNoise.CONSTANT or result.num_inliers == 0:
        return None
    hessian = np.asarray(result.H)
    if not np.isfinite(hessian).all():
        return None
    pairs = result.num_inliers * _of_points(source.points()[:, :3])
    told = 0.5 * (hessian + hessian.T) - IN_PLANE * pairs
    # In these units every direction moves the points alike.
    unit = np.linalg.inv(np.linalg.cholesky(pairs))
    holds, directions = np.linalg.eigh(unit @ told @ unit.T)
    holds = np.maximum(holds, LEAST)
    residual = 2.0 * float(result.error) / result.num_inliers
    # What is left of a hold without its false part, to the first order: that is never negative.
    variances = settings.covariance_scale * residual / holds * (1.0 + FALSE_HOLD / holds)
    variances += result.num_inliers * SLIP**2 / (1.0 + (holds / NO_HOLD) ** 6)
    variances = np.minimum(variances, result.num_inliers * LOOSEST**2)
    variances += SKEW**2 * variances.max()
    axes = unit.T @ directions
    own = (axes * variances) @ axes.T
    floor = [settings.floor_rotation] * 3 + [settings.floor_translation] * 3
    covariance: NDArray[np.float64] = own + np.diag(np.square(floor))
    return covariance


def _of_points(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean Hessian (6, 6) of pairs that are held alike in all directions; points (N, 3)."""
    lever = gtsam.Rot3.Hat(points.mean(axis=0))
    squares = points.T @ points / len(points)
    mean = np.eye(6)
    mean[:3, :3] = (np.trace(squares) + SMALLEST**2) * np.eye(3) - squares
    mean[:3, 3:], mean[3:, :3] = lever, -lever
    return mean


def carried(covariance: NDArray[np.float64], T_frame_scan: gtsam.Pose3) -> NDArray[np.float64]:
    """The covariance (6, 6) of a motion to a scan, as that of the motion to another frame on it.

    Args:
        covariance: In the frame of the scan, rotation before translation.
        T_frame_scan: The scan seen from the other frame, which moves with it.
    """
    adjoint = T_frame_scan.AdjointMap()
    moved: NDArray[np.float64] = adjoint @ covariance @ adjoint.T
    return moved


def loosest_shift(covariance: NDArray[np.float64]) -> float:
    """Variance of a match along the direction in which it is shifted most easily, m^2.

    Args:
        covariance: (6, 6), rotation before translation.
    """
    return float(np.linalg.eigvalsh(covariance[3:, 3:])[-1])


def weak_directions(covariance: NDArray[np.float64]) -> int:
    """In how many directions (of six at the most) a match is hardly held.

    Args:
        covariance: (6, 6), rotation before translation.
    """
    weak = 0
    own: list[float] = covariance.diagonal().tolist()
    for place, limit in ((0, WEAK_ROTATION), (3, WEAK_TRANSLATION)):
        # No eigenvalue is larger than their sum, which nearly always tells.
        if not sum(own[place : place + 3]) <= limit**2:
            part = covariance[place : place + 3, place : place + 3]
            weak += int((np.linalg.eigvalsh(part) > limit**2).sum())
    return weak
