"""Errors of an estimated trajectory against the true one: RPE, RPE per second and ATE.

The estimate and the truth may live in different map frames: relative errors do not depend on
the frame, and the absolute one is taken after the best rigid fit.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.trajectory import Trajectory, fit_rigid, match_truth

MIN_POSES = 2


@dataclass(frozen=True, slots=True)
class TrajectoryErrors:
    """Root mean squared errors of the poses that the truth covers.

    Translations in metres, rotations in degrees. ``rpe`` is over consecutive poses, ``rpe_per
    second`` over poses that are about a second apart (None where the trajectory is too short),
    ``ate`` over positions after a rigid fit. ``pairs`` counts the consecutive pairs;
    ``poses_without_truth`` the poses outside the truth's time span, which were left out.
    """

    rpe_translation_rmse_m: float
    rpe_rotation_rmse_deg: float
    rpe_per_second_translation_rmse_m: float | None
    rpe_per_second_rotation_rmse_deg: float | None
    ate_rmse_m: float
    pairs: int
    poses_without_truth: int


def trajectory_errors(estimate: Trajectory, truth: Trajectory) -> TrajectoryErrors | None:
    """Compare an estimate with the truth, interpolated at the estimate's stamps.

    Args:
        estimate: T_map_base; its map frame may be another than that of the truth.
        truth: The true poses of base_link, with stamps of the same clock.

    Returns:
        The errors; None where the truth covers fewer than two poses.
    """
    covered, reference = match_truth(estimate, truth)
    if len(covered) < MIN_POSES:
        return None
    steps = consecutive_pairs(covered.stamps)
    step_translation, step_rotation = relative_pose_errors(covered, reference, steps)
    second_translation, second_rotation = relative_pose_errors(
        covered, reference, pairs_apart(covered.stamps, NANOSECONDS)
    )
    T_truth_estimate = fit_rigid(covered.positions, reference.positions)
    aligned = covered.positions @ T_truth_estimate[:3, :3].T + T_truth_estimate[:3, 3]
    has_seconds = len(second_translation) > 0
    return TrajectoryErrors(
        rpe_translation_rmse_m=_rms(step_translation),
        rpe_rotation_rmse_deg=_rms(step_rotation),
        rpe_per_second_translation_rmse_m=_rms(second_translation) if has_seconds else None,
        rpe_per_second_rotation_rmse_deg=_rms(second_rotation) if has_seconds else None,
        ate_rmse_m=_rms(np.linalg.norm(aligned - reference.positions, axis=1)),
        pairs=len(steps),
        poses_without_truth=len(estimate) - len(covered),
    )


def consecutive_pairs(stamps: NDArray[np.int64]) -> NDArray[np.int64]:
    """Indices (P, 2) of neighbouring poses; ``stamps`` is (M,) nanoseconds, P = M - 1."""
    first = np.arange(max(len(stamps) - 1, 0), dtype=np.int64)
    return np.stack([first, first + 1], axis=1)


def pairs_apart(stamps: NDArray[np.int64], span_ns: int) -> NDArray[np.int64]:
    """Each pose with the pose nearest to a span later.

    Args:
        stamps: Nanoseconds (M,), strictly increasing.
        span_ns: The span in nanoseconds; a pose has no partner where the nearest one is off by
            more than half of it.

    Returns:
        Indices (P, 2) of the earlier and the later pose.
    """
    first = np.arange(len(stamps), dtype=np.int64)
    wanted = stamps + span_ns
    after = np.minimum(np.searchsorted(stamps, wanted), len(stamps) - 1)
    before = np.maximum(after - 1, 0)
    second = np.where(wanted - stamps[before] <= np.abs(stamps[after] - wanted), before, after)
    keep = (np.abs(stamps[second] - wanted) <= span_ns // 2) & (second > first)
    pairs: NDArray[np.int64] = np.stack([first[keep], second[keep]], axis=1)
    return pairs


def relative_pose_errors(
    estimate: Trajectory, truth: Trajectory, pairs: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The relative pose error of every pair.

    That of the pair (i, j) is E = (T_truth_i^-1 T_truth_j)^-1 (T_estimate_i^-1 T_estimate_j).

    Args:
        estimate: M poses.
        truth: The true pose at each of their stamps, M too.
        pairs: Indices (P, 2) into both.

    Returns:
        Metres (P,) and degrees (P,).
    """
    if len(pairs) == 0:
        return np.zeros(0), np.zeros(0)
    true_shift, true_turn = _motions(truth, pairs)
    shift, turn = _motions(estimate, pairs)
    # The translation of E is true_turn^-1 (shift - true_shift); its length needs no rotation.
    metres: NDArray[np.float64] = np.linalg.norm(shift - true_shift, axis=1)
    degrees: NDArray[np.float64] = np.degrees((true_turn.inv() * turn).magnitude())
    return metres, degrees


def _motions(
    trajectory: Trajectory, pairs: NDArray[np.int64]
) -> tuple[NDArray[np.float64], Rotation]:
    """Translations (P, 3) and rotations of T_i^-1 T_j."""
    rotations = trajectory.rotations()
    back = rotations[pairs[:, 0]].inv()
    shift = trajectory.positions[pairs[:, 1]] - trajectory.positions[pairs[:, 0]]
    return back.apply(shift), back * rotations[pairs[:, 1]]


def _rms(errors: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))
