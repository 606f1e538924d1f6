"""Moments and covariance matrices, written in NumPy as the definitions are."""

import numpy as np
from scipy.spatial.transform import Rotation

from incremental_mapper.scoring.moments import sum_products


def six(matrices):
    return np.asarray(matrices)[..., [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]].T


def with_eigenvalues(eigenvalues, seed):
    turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    matrix = turn @ np.diag(eigenvalues) @ turn.T
    return (matrix + matrix.T) / 2


def moments(points):
    """Moments (10, 1) of all the points (N, 3) together."""
    every = np.arange(len(points))
    return sum_products(np.zeros_like(every), every, points.T, 1)
