"""Moments under motions, against the definitions, written in NumPy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from incremental_mapper.scoring.eigen import full_matrices
from incremental_mapper.scoring.moment_update import ROUNDING, largest_drifts, moved_covariances
from incremental_mapper.scoring.neighbourhoods import (
    find_boundary_pairs,
    make_grid,
    scan_moments,
)


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
    moments = scan_moments(grid, queries, 1.0, 3)
    boundary = find_boundary_pairs(grid, queries, 1.0, reach + ROUNDING)
    found, near = moved_covariances(motions, queries, scan, moments, boundary, reach, 1.0)
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
    tight, far = moved_covariances(motions, queries, scan, moments, boundary, 0.0 * reach, 1.0)
    assert far.tolist() == [True] + 4 * [size == 0.0]
    assert tight[:, 0] == pytest.approx(found[:, 0])
    motions[2, 1] = np.nan
    assert not moved_covariances(motions, queries, scan, moments, boundary, reach, 1.0)[1][2]
