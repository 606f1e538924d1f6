"""Moments under motions, smallest eigenvalues, and the search for neighbours.

The kernels are compared with the definitions, written in NumPy.
"""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from incremental_mapper.scoring.eigen import full_matrices, smallest_eigen
from incremental_mapper.scoring.moment_update import ROUNDING, largest_drifts, moved_covariances
from incremental_mapper.scoring.moments import COUNT, covariances, sum_products
from incremental_mapper.scoring.neighbourhoods import (
    find_boundary_pairs,
    make_grid,
    moments_around,
    scan_moments,
    shared_neighbourhoods,
)

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


def moments(points):
    """Moments (10, 1) of all the points (N, 3) together."""
    every = np.arange(len(points))
    return sum_products(np.zeros_like(every), every, points.T, 1)


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


def motion(seed):
    rng = np.random.default_rng(seed)
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.random(rng=rng).as_matrix()
    matrix[:3, 3] = rng.normal(scale=10, size=3)
    return matrix


def small_motion(rng, size):
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(rng.normal(scale=size, size=3)).as_matrix()
    matrix[:3, 3] = rng.normal(scale=size, size=3)
    return matrix


extents = st.tuples(*[st.sampled_from([0.0, 1.0, 30.0, 1e4])] * 3)


@settings(deadline=None, max_examples=80)
@given(
    st.integers(0, 400),
    st.integers(0, 60),
    st.floats(0.2, 5.0),
    st.floats(0.5, 2.0),
    extents,
    st.integers(0, 10_000),
)
def test_grid_finds_the_points_of_each_scan_around_a_place(
    count, asked, radius, width, extent, seed
):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, size=(count, 3)) * extent - 7.0
    queries = rng.uniform(-1.5, 1.5, size=(asked, 3)) * extent - 7.0
    queries[::2] = points[rng.integers(count, size=len(queries[::2]))] if count else -7.0
    bounds = np.array([0, count // 3, count // 3, count])
    grid = make_grid(points, bounds, width * radius)
    found = scan_moments(grid, queries, radius, 3)
    assert found.shape == (asked, 3, 10)
    for scan, (start, end) in enumerate(pairwise(bounds.tolist())):
        for query, own in zip(queries, found[:, scan], strict=True):
            steps = points[start:end] - query
            steps = steps[np.linalg.norm(steps, axis=1) <= radius]
            assert own == pytest.approx(moments(steps)[:, 0], rel=1e-9, abs=1e-9)
    whole = moments_around(points, queries, radius)
    assert whole == pytest.approx(found.sum(axis=1).T, rel=1e-9, abs=1e-9)


@settings(deadline=None, max_examples=80)
@given(
    st.integers(0, 300), st.integers(0, 40), st.floats(0.0, 1.5), extents, st.integers(0, 10_000)
)
def test_rim_has_the_pairs_near_it_sorted_by_query_and_scan(count, asked, reach, extent, seed):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, size=(count, 3)) * np.minimum(extent, 4.0)
    queries = rng.uniform(-1, 1, size=(asked, 3)) * np.minimum(extent, 4.0)
    bounds = np.array([0, count // 2, count])
    reaches = reach * rng.uniform(size=(asked, 2))
    reaches[::3] = 0.0
    boundary = find_boundary_pairs(make_grid(points, bounds, 1.0), queries, 1.0, reaches)
    assert boundary.starts.shape == (asked, 3)
    assert boundary.starts.ravel()[-1:].tolist() == [len(boundary.inside)][:asked]
    for query in range(asked):
        for scan, (start, end) in enumerate(pairwise(bounds.tolist())):
            steps = points[start:end] - queries[query]
            lengths = np.linalg.norm(steps, axis=1)
            expected = steps[np.abs(lengths - 1.0) <= reaches[query, scan]]
            some = slice(boundary.starts[query, scan], boundary.starts[query, scan + 1])
            assert sorted(boundary.apart[some].tolist()) == sorted(expected.tolist())
            inside = np.square(boundary.apart[some]).sum(axis=1) <= 1.0
            assert boundary.inside[some].tolist() == inside.tolist()


@pytest.mark.parametrize('bad', [np.nan, np.inf, -np.inf, 1e200])
def test_numbers_out_of_this_world_have_no_neighbours(bad):
    points = np.random.default_rng(0).uniform(-2, 2, size=(100, 3))
    broken = points.copy()
    broken[::4, 0] = bad
    broken[1::4, 2] = bad
    good = np.abs(broken).max(axis=1) < 1e9
    queries = np.vstack([points[:5], [[0.0, bad, 0.0]]])
    grid = make_grid(broken, np.array([0, 100]), 1.0)
    assert len(grid.points) == good.sum() == 50
    found = scan_moments(grid, queries, 1.0, 1)[:, 0]
    expected = moments_around(broken[good], queries, 1.0).T
    assert found == pytest.approx(expected)
    assert found[:5, COUNT].min() > 0
    assert found[5].tolist() == [0.0] * 10
    boundary = find_boundary_pairs(grid, queries, 1.0, np.full((6, 1), 0.5))
    assert boundary.starts[5].tolist() == [len(boundary.inside)] * 2
    nothing = make_grid(np.full((3, 3), bad), np.array([0, 3]), 1.0)
    assert scan_moments(nothing, queries, 1.0, 1).sum() == 0.0


def test_neighbourhoods_are_shared_by_scans_and_large_enough():
    clouds = np.random.default_rng(0).normal(size=(4, 6, 3))
    parts = np.zeros((4, 2, 10))
    parts[0, 0] = moments(clouds[0])[:, 0]  # all its own
    parts[1, 1] = moments(clouds[1])[:, 0]  # none of its own
    parts[2] = moments(clouds[2][:3])[:, 0], moments(clouds[2][3:])[:, 0]
    parts[3] = moments(clouds[3][:1])[:, 0], moments(clouds[3][1:4])[:, 0]  # too few
    chosen, spread = shared_neighbourhoods(parts, np.zeros(4, dtype=np.int64), 5)
    assert chosen.tolist() == [1, 2]
    expected = np.stack([np.cov(clouds[i].T, bias=True) for i in (1, 2)])
    assert full_matrices(spread) == pytest.approx(expected, abs=1e-12)
    assert shared_neighbourhoods(parts[:0], chosen[:0], 5)[1].shape == (6, 0)


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 10_000))
def test_drift_is_how_far_a_query_moves_against_a_scan(seed):
    rng = np.random.default_rng(seed)
    motions = np.stack(
        [[np.eye(4), small_motion(rng, 0.1), small_motion(rng, 0.1)] for _ in range(4)]
    )
    motions[3, 1, 0, 3] = 50.0  # too far to count
    scan = np.array([0, 0, 1, 2, 2])
    queries = rng.normal(size=(5, 3))
    found = largest_drifts(motions, queries, scan, 5.0)
    assert found.shape == (5, 3)
    for query, own, drifts in zip(queries, scan, found, strict=True):
        tilde = np.append(query, 1.0)
        steps = motions[:3] @ tilde - (motions[:3, own] @ tilde)[:, None]
        assert drifts == pytest.approx(np.linalg.norm(steps[..., :3], axis=2).max(axis=0))
        assert drifts[own] == 0.0
    # No pair changes its distance by more.
    for place, own in enumerate(scan):
        for other in range(3):
            point = rng.normal(size=3)
            moved = motions[0, other] @ np.append(point, 1.0)
            query = motions[0, own] @ np.append(queries[place], 1.0)
            after, before = np.linalg.norm(moved - query), np.linalg.norm(point - queries[place])
            assert abs(after - before) <= found[place, other] + 1e-9
    assert largest_drifts(motions[3:], queries, scan, 5.0).tolist() == [[0.0] * 3] * 5
    assert largest_drifts(motions[:0], queries, scan, 5.0).tolist() == [[0.0] * 3] * 5
    motions[1, 2, 0, 0] = np.nan
    one, two = largest_drifts(motions[[0, 2]], queries, scan, 5.0), motions[:3]
    assert largest_drifts(two, queries, scan, 5.0).tolist() == one.tolist()


@settings(deadline=None, max_examples=60)
@given(st.integers(1, 120), st.just(0.0) | st.floats(1e-3, 0.5), st.integers(0, 10_000))
def test_moved_covariances_are_those_of_the_moved_points(count, size, seed):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-2, 2, size=(3 * count, 3)) + np.array([50.0, -70.0, 3.0])
    bounds = np.array([0, count, 2 * count, 3 * count])
    scan = np.array([0, 1, 1, 2, 2])
    queries = points[[0, count, 2 * count - 1, 2 * count, 3 * count - 1]]
    motions = np.stack([[np.eye(4)] * 3, *[[np.eye(4)] * 3] * 4])
    centre = np.eye(4)
    centre[:3, 3] = 50.0, -70.0, 3.0
    common = motion(seed)  # of all scans alike
    for candidate in motions[1:]:
        for own in range(3):
            turn = centre @ small_motion(rng, size) @ np.linalg.inv(centre)
            candidate[own] = common @ turn
    reach = largest_drifts(motions, queries, scan, np.inf)
    grid = make_grid(points, bounds, 1.0)
    parts = scan_moments(grid, queries, 1.0, 3)
    boundary = find_boundary_pairs(grid, queries, 1.0, reach + ROUNDING)
    found, near = moved_covariances(motions, queries, scan, parts, boundary, reach, 1.0)
    assert found.shape == (6, 5, 5)
    assert near.all()
    owner = np.repeat(np.arange(3), count)
    for own, candidate in zip(found.transpose(1, 2, 0), motions, strict=True):
        placed = np.einsum('nij,nj->ni', candidate[owner, :3, :3], points)
        placed += candidate[owner, :3, 3]
        for spread, of, query in zip(own, scan, queries, strict=True):
            place = candidate[of, :3, :3] @ query + candidate[of, :3, 3]
            steps = placed[np.linalg.norm(placed - place, axis=1) <= 1.0]
            expected = np.linalg.eigvalsh(np.cov(steps.T, bias=True).reshape(3, 3))
            # The frame is another one, so that only the eigenvalues are alike.
            alike = np.linalg.eigvalsh(full_matrices(spread[:, None])[0])
            assert alike == pytest.approx(expected, abs=1e-10)
    tight, far = moved_covariances(motions, queries, scan, parts, boundary, 0.0 * reach, 1.0)
    assert far.tolist() == [True] + 4 * [size == 0.0]
    assert tight[:, 0] == pytest.approx(found[:, 0])
    motions[2, 1] = np.nan
    assert not moved_covariances(motions, queries, scan, parts, boundary, reach, 1.0)[1][2]
