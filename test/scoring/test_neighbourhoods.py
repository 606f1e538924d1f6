"""The search for neighbours, against distances in NumPy."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from point_moments import moments

from incremental_mapper.scoring.eigen import full_matrices
from incremental_mapper.scoring.moments import COUNT
from incremental_mapper.scoring.neighbourhoods import (
    find_boundary_pairs,
    make_grid,
    moments_around,
    scan_moments,
    shared_neighbourhoods,
)

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
def test_boundary_pairs_are_those_near_the_radius_in_order(count, asked, reach, extent, seed):
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
    by_scan = np.zeros((4, 2, 10))
    by_scan[0, 0] = moments(clouds[0])[:, 0]  # all its own
    by_scan[1, 1] = moments(clouds[1])[:, 0]  # none of its own
    by_scan[2] = moments(clouds[2][:3])[:, 0], moments(clouds[2][3:])[:, 0]
    by_scan[3] = moments(clouds[3][:1])[:, 0], moments(clouds[3][1:4])[:, 0]  # too few
    chosen, spread = shared_neighbourhoods(by_scan, np.zeros(4, dtype=np.int64), 5)
    assert chosen.tolist() == [1, 2]
    expected = np.stack([np.cov(clouds[i].T, bias=True) for i in (1, 2)])
    assert full_matrices(spread) == pytest.approx(expected, abs=1e-12)
    assert shared_neighbourhoods(by_scan[:0], chosen[:0], 5)[1].shape == (6, 0)


@pytest.mark.parametrize(('count', 'taken'), [(4, False), (5, True), (6, True)])
def test_neighbourhood_of_exactly_as_many_points_as_are_asked_for_counts(count, taken):
    points = np.random.default_rng(1).normal(size=(count, 3))
    by_scan = np.zeros((1, 2, 10))
    by_scan[0] = moments(points[:2])[:, 0], moments(points[2:])[:, 0]
    chosen, _ = shared_neighbourhoods(by_scan, np.zeros(1, dtype=np.int64), 5)
    assert chosen.tolist() == [0] * taken


def test_one_point_is_the_least_that_makes_a_neighbourhood():
    by_scan = np.zeros((2, 2, 10))
    by_scan[1, 1] = moments(np.ones((1, 3)))[:, 0]
    chosen, spread = shared_neighbourhoods(by_scan, np.zeros(2, dtype=np.int64), 0)
    assert chosen.tolist() == [1]
    assert spread == pytest.approx(np.zeros((6, 1)), abs=1e-15)
