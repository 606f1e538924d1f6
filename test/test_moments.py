"""Moments under motions, smallest eigenvalues, and the search for neighbours."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from incremental_mapper.criteria.eigen import full_matrices, smallest_eigen
from incremental_mapper.criteria.moments import covariances, sum_products, transfers
from incremental_mapper.criteria.neighbourhoods import BLOCK, RowIndex
from incremental_mapper.criteria.shell import drifts, squared_lengths

ACCURACY = 1e-14
"""Of an eigenvalue, in parts of the largest one."""


def six(matrices):
    return np.asarray(matrices)[..., [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]].T


def with_eigenvalues(eigenvalues, seed):
    turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    matrix = turn @ np.diag(eigenvalues) @ turn.T
    return (matrix + matrix.T) / 2


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


def test_no_matrix_has_no_eigenvalue():
    assert smallest_eigen(np.zeros((6, 0))).values.tolist() == []


def test_six_numbers_make_the_matrix():
    matrices = np.stack([with_eigenvalues([1, 2, 3], 0), with_eigenvalues([0, 0, 7], 1)])
    assert full_matrices(six(matrices)).tolist() == matrices.tolist()


def moments(points):
    """Moments (10, 1) of all the points (N, 3) together."""
    every = np.arange(len(points))
    return sum_products(np.zeros_like(every), every, points.T, 1)


def motion(seed):
    rng = np.random.default_rng(seed)
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.random(rng=rng).as_matrix()
    matrix[:3, 3] = rng.normal(scale=10, size=3)
    return matrix


@given(st.integers(1, 30), st.integers(0, 1000))
def test_covariance_of_moments_is_that_of_the_points(count, seed):
    points = np.random.default_rng(seed).normal(size=(count, 3)) + np.array([5.0, -3.0, 1.0])
    found = full_matrices(covariances(moments(points)))[0]
    assert found == pytest.approx(np.cov(points.T, bias=True).reshape(3, 3), abs=1e-12)


def test_covariance_of_no_point_is_zero():
    assert covariances(np.zeros((10, 1))).tolist() == np.zeros((6, 1)).tolist()


@given(st.integers(1, 30), st.integers(0, 1000))
def test_moments_move_as_their_points_do(count, seed):
    points = np.random.default_rng(seed).normal(size=(count, 3))
    move = motion(seed)
    placed = points @ move[:3, :3].T + move[:3, 3]
    moved = transfers(move) @ moments(points)
    assert moved == pytest.approx(moments(placed), rel=1e-9, abs=1e-9)


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


def found_pairs(points, queries, radii, radius):
    index = RowIndex(points, radius)
    found = []
    for pairs in index.search(queries, radii):
        asked = np.arange(queries.shape[1])[pairs.queries][pairs.rows]
        apart = index.points[:, pairs.columns] - queries[:, asked]
        assert pairs.squares == pytest.approx(np.square(apart).sum(axis=0))
        found += list(zip(asked.tolist(), index.order[pairs.columns].tolist(), strict=True))
    assert len(found) == len(set(found))
    return set(found)


@settings(deadline=None, max_examples=60)
@given(
    st.integers(0, 400),
    st.integers(0, BLOCK + 20),
    st.floats(0.2, 5.0),
    st.tuples(*[st.sampled_from([0.0, 1.0, 30.0])] * 3),
    st.integers(0, 10_000),
)
def test_search_finds_the_pairs_that_are_near_enough(count, asked, radius, extent, seed):
    rng = np.random.default_rng(seed)
    extent = np.array(extent)[:, None]
    points = rng.uniform(-1, 1, size=(3, count)) * extent - 7.0
    queries = rng.uniform(-1.5, 1.5, size=(3, asked)) * extent - 7.0
    radii = radius * rng.uniform(0.8, 2.5, size=asked)
    apart = np.linalg.norm(queries[:, :, None] - points[:, None, :], axis=0)
    expected = set(
        zip(*(side.tolist() for side in np.nonzero(apart <= radii[:, None])), strict=True)
    )
    assert found_pairs(points, queries, radii, radius) == expected


def test_search_finds_the_same_pairs_where_the_points_spread_too_far_for_short_keys():
    rng = np.random.default_rng(0)
    near, far = rng.uniform(-3, 3, size=(3, 300)), np.array([[1e5, -1e5]] * 3)
    queries = near[:, :40] + 0.1
    apart = np.linalg.norm(queries[:, :, None] - near[:, None, :], axis=0)
    expected = set(zip(*(side.tolist() for side in np.nonzero(apart <= 1.5)), strict=True))
    radii = np.full(40, 1.5)
    assert found_pairs(near, queries, radii, 1.5) == expected
    assert found_pairs(np.hstack([near, far]), queries, radii, 1.5) == expected


@settings(deadline=None)
@given(st.integers(0, 10_000))
def test_no_pair_changes_its_distance_by_more_than_the_drift(seed):
    rng = np.random.default_rng(seed)
    motions = np.stack([[np.eye(4), motion(seed), motion(seed + 1)]])
    scan = np.array([0, 0, 1, 2, 2])
    queries = rng.normal(size=(3, 5))
    found = drifts(motions, queries, scan)
    lengths = np.sqrt(squared_lengths(found))
    assert found.shape == (3, 1, 3, 5)
    for place, own in enumerate(scan):
        assert lengths[0, own, place] == 0.0
        query = motions[0, own] @ np.append(queries[:, place], 1.0)
        for other in range(3):
            point = rng.normal(size=3)
            moved = motions[0, other] @ np.append(point, 1.0)
            after = np.linalg.norm((moved - query)[:3])
            before = np.linalg.norm(point - queries[:, place])
            assert abs(after - before) <= lengths[0, other, place] + 1e-9
            step = point - queries[:, place] + found[:, 0, other, place]
            assert np.linalg.norm(step) == pytest.approx(after, abs=1e-9)
