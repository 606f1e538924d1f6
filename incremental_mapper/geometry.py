"""Rigid transforms. ``T_a_b`` maps a point given in frame b to frame a."""

from collections.abc import Sequence

import gtsam
import numpy as np
from numpy.typing import NDArray


def pose_matrix(numbers: Sequence[float]) -> NDArray[np.float64]:
    """Make a homogeneous matrix of the numbers of a pose.

    Args:
        numbers: x, y, z in metres and the quaternion qx, qy, qz, qw, or the twelve numbers of a
            row-major 3x4 matrix.

    Returns:
        T_a_b (4, 4), whose rotation is one to rounding.

    Raises:
        ValueError: the numbers are no rigid transform.
    """
    values = np.asarray(numbers, dtype=np.float64)
    matrix = np.eye(4)
    if not np.isfinite(values).all():
        raise ValueError('a transform must be finite')
    if len(values) == 7:
        norm = float(np.linalg.norm(values[3:]))
        if abs(norm - 1.0) > 1e-3:
            raise ValueError(f'the quaternion has norm {norm:.6g}, expected 1')
        x, y, z, w = values[3:] / norm
        matrix[:3, :3] = gtsam.Rot3.Quaternion(w, x, y, z).matrix()
        matrix[:3, 3] = values[:3]
    elif len(values) == 12:
        table = values.reshape(3, 4)
        matrix[:3, :3] = nearest_rotation(table[:, :3])
        matrix[:3, 3] = table[:, 3]
    else:
        raise ValueError(
            f'{len(values)} numbers; expected 7 (x y z qx qy qz qw) or 12 (row-major 3x4)'
        )
    return matrix


def matrix_numbers(transform: NDArray[np.float64]) -> list[float]:
    """The numbers of a pose, as ``pose_matrix`` takes them.

    Args:
        transform: T_a_b (4, 4).

    Returns:
        x, y, z in metres and the quaternion qx, qy, qz, qw.
    """
    # Imported where it is used: a process for each LiDAR starts a quarter of a second sooner.
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_matrix(transform[:3, :3]).as_quat()
    return [float(value) for value in (*transform[:3, 3], *turn)]


def written_numbers(transform: NDArray[np.float64]) -> list[float]:
    """The same, rounded as one would write them into settings: micrometres, no negative zero.

    Args:
        transform: T_a_b (4, 4).
    """
    return [round(value, 6) + 0.0 for value in matrix_numbers(transform)]


def nearest_rotation(matrix: NDArray[np.float64], tolerance: float = 1e-2) -> NDArray[np.float64]:
    """Find the rotation nearest to a matrix that is one up to rounding.

    Args:
        matrix: M (3, 3), such as a calibration file with few decimals holds.
        tolerance: largest difference between M Mᵀ and the identity, element by element.

    Returns:
        The rotation (3, 3) with the least sum of squared differences from M.

    Raises:
        ValueError: M is further from a rotation than that, a reflection, or not finite.
    """
    if not np.isfinite(matrix).all():
        raise ValueError('a rotation must be finite')
    error = float(np.abs(matrix @ matrix.T - np.eye(3)).max())
    determinant = float(np.linalg.det(matrix))
    if error > tolerance or determinant < 0:
        raise ValueError(
            f'the matrix is no rotation: determinant {determinant:.4g}, '
            f'largest error of M Mᵀ {error:.3g}'
        )
    # gtsam.Rot3.ClosestTo is as exact, but takes whatever it is given for a rotation.
    left, _, right = np.linalg.svd(matrix)
    rotation: NDArray[np.float64] = left @ right
    return rotation


def transform_points(
    matrix: NDArray[np.float64], points: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Move points to another frame.

    Args:
        matrix: T_target_source (4, 4).
        points: (N, 3) in the source frame, metres.

    Returns:
        The points (N, 3) in the target frame, metres.
    """
    moved: NDArray[np.float64] = points @ matrix[:3, :3].T + matrix[:3, 3]
    return moved
