"""Rigid transforms. ``T_a_b`` maps a point given in frame b to frame a."""

from collections.abc import Sequence

import gtsam
import numpy as np
from numpy.typing import NDArray


def pose_matrix(numbers: Sequence[float]) -> NDArray[np.float64]:
    """Homogeneous matrix of x, y, z, qx, qy, qz, qw, or of a row-major 3x4 matrix.

    Raises ValueError where the numbers are no rigid transform.
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


def nearest_rotation(matrix: NDArray[np.float64], tolerance: float = 1e-2) -> NDArray[np.float64]:
    """The rotation nearest to a (3, 3) matrix that is one up to rounding.

    Raises ValueError where M Mᵀ differs from the identity by more than ``tolerance`` or where M
    is a reflection.
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
    left, _, right = np.linalg.svd(matrix)
    rotation: NDArray[np.float64] = left @ right
    return rotation


def transform_points(
    matrix: NDArray[np.float64], points: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Points (N, 3) moved by a (4, 4) matrix ``T_target_source``."""
    moved: NDArray[np.float64] = points @ matrix[:3, :3].T + matrix[:3, 3]
    return moved
