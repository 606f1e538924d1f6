"""Smallest eigenvalues against LAPACK's."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from point_moments import six, with_eigenvalues

from incremental_mapper.scoring.eigen import full_matrices, smallest_eigen

ACCURACY = 1e-14
"""Of an eigenvalue, in parts of the largest one."""


def check(matrices):
    found = smallest_eigen(six(matrices))
    expected, _ = np.linalg.eigh(matrices)
    scale = np.abs(expected).max(axis=1)
    error = np.abs(found.values - np.maximum(expected[:, 0], 0.0))
    assert (error <= ACCURACY * scale).all()
    assert (np.abs(found.middle - np.maximum(expected[:, 1], 0.0)) <= 1e-7 * scale).all()
    assert (found.values >= 0).all()
    assert np.linalg.norm(found.vectors, axis=0) == pytest.approx(np.ones(len(matrices)))
    # A vector may be any of an eigenspace; it is one if the matrix only scales it.
    turned = np.einsum('nij,jn->in', matrices, found.vectors)
    rest = np.linalg.norm(turned - expected[:, 0] * found.vectors, axis=0)
    assert (rest <= 1e-10 * scale).all()


sizes = st.floats(0, 1) | st.sampled_from([0.0, 1e-12, 1e-8, 1e-6, 1e-4, 1e-3, 0.5, 1.0])


@settings(deadline=None, max_examples=300)
@given(
    st.lists(st.tuples(sizes, sizes, sizes), min_size=1, max_size=8),
    st.floats(-6, 4),
    st.integers(0, 10_000),
)
def test_smallest_eigenvalue_is_lapacks_for_planes_lines_points_and_balls(shapes, scale, seed):
    check(np.stack([with_eigenvalues(10.0**scale * np.array(one), seed) for one in shapes]))


@settings(deadline=None, max_examples=300)
@given(
    st.floats(0, 1),
    st.floats(-14, 0),
    st.floats(-14, 0),
    st.integers(0, 10_000),
)
def test_smallest_eigenvalue_is_lapacks_where_two_or_three_nearly_agree(first, one, other, seed):
    second = first + 10.0**one
    check(with_eigenvalues([first, second, second + 10.0**other], seed)[None])


@pytest.mark.parametrize(
    'matrix',
    [
        np.zeros((3, 3)),
        np.eye(3),
        np.ones((3, 3)),
        np.diag([1.0, 1.0, 0.0]),
        np.diag([0.0, 0.0, 1.0]),
        np.diag([-1e-18, 1, 1]),
        np.diag([2.0, 3.0, 1.0]),
    ],
)
def test_degenerate_matrices_beside_others(matrix):
    check(np.stack([matrix, np.diag([3.0, 2.0, 1.0]), with_eigenvalues([0.1, 0.2, 0.3], 1)]))


def test_smallest_eigenvalue_of_points_on_a_plane_a_line_and_a_spot():
    rng = np.random.default_rng(0)
    clouds = rng.normal(size=(40, 30, 3)) + 5.0
    clouds[:10, :, 0] = 2.0
    clouds[10:20, :, :2] = 1.0
    clouds[20:30] = 3.0
    covariance = np.stack([np.cov(cloud.T, bias=True) for cloud in clouds])
    check(covariance)
    assert smallest_eigen(six(covariance)).values[:30] == pytest.approx(np.zeros(30), abs=1e-14)


@pytest.mark.parametrize('bad', [np.nan, np.inf, 1e200])
def test_matrix_that_is_no_number_does_no_harm_to_others(bad):
    broken = np.stack([np.diag([1.0, 2.0, 3.0]), np.full((3, 3), bad), np.diag([3.0, 2.0, 1.0])])
    broken[1, 0, 0] = 1.0
    found = smallest_eigen(six(broken))
    assert found.values[[0, 2]] == pytest.approx([1.0, 1.0])
    assert np.isfinite(bad) or np.isnan(found.values[1])


def test_no_matrix_has_no_eigenvalue():
    assert smallest_eigen(np.zeros((6, 0))).values.tolist() == []


def test_six_numbers_make_the_matrix():
    matrices = np.stack([with_eigenvalues([1, 2, 3], 0), with_eigenvalues([0, 0, 7], 1)])
    assert full_matrices(six(matrices)).tolist() == matrices.tolist()
