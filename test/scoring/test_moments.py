"""Moments of points, and the covariances that they stand for."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from point_moments import moments

from incremental_mapper.scoring.eigen import full_matrices
from incremental_mapper.scoring.moments import covariances, sum_products


@given(st.integers(1, 30), st.integers(0, 1000))
def test_covariance_of_moments_is_that_of_the_points(count, seed):
    points = np.random.default_rng(seed).normal(size=(count, 3)) + np.array([5.0, -3.0, 1.0])
    found = full_matrices(covariances(moments(points)))[0]
    assert found == pytest.approx(np.cov(points.T, bias=True).reshape(3, 3), abs=1e-12)


def test_covariance_of_no_point_is_zero():
    assert covariances(np.zeros((10, 1))).tolist() == np.zeros((6, 1)).tolist()


def test_moment_of_one_point_is_its_products():
    points = np.random.default_rng(0).normal(size=(5001, 3))
    every = np.arange(len(points))
    tilde = np.append(points, np.ones((len(points), 1)), axis=1)
    outer = tilde[:, :, None] * tilde[:, None, :]
    rows, columns = np.triu_indices(4)
    numbers = sum_products(every, every, points.T, len(points))
    assert numbers.T.tolist() == outer[:, rows, columns].tolist()
    nothing = every[:0]
    assert sum_products(nothing, nothing, np.zeros((3, 0)), 0).shape == (10, 0)


def test_sums_are_split_and_points_count_as_often_as_they_are_named():
    points = np.arange(9.0).reshape(3, 3)
    sums = sum_products(np.array([1, 1, 0, 1]), np.array([0, 2, 2, 0]), points.T, 3)
    first, last = moments(points[:1]), moments(points[2:])
    assert sums.tolist() == np.hstack([last, 2 * first + last, np.zeros((10, 1))]).tolist()
