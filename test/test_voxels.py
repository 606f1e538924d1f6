"""Voxel means: which points stand for which, in which order."""

import numpy as np
import pytest
import small_gicp
from driven_room import room

from incremental_mapper.voxels import thin, voxel_means


@pytest.mark.parametrize('scale', [1.0, 1e3, 1e7], ids=['few', 'many', 'too_many_to_number'])
def test_thinned_points_are_the_means_of_their_voxels(scale):
    points = np.vstack([room(3000), room(20, seed=1) * scale])
    found = {tuple(np.floor(point / 0.5)): point for point in thin(points, 0.5)}
    cells = np.floor(points / 0.5)
    assert set(found) == set(map(tuple, cells))
    for cell, point in found.items():
        assert point == pytest.approx(points[(cells == cell).all(axis=1)].mean(axis=0), rel=1e-12)


def test_thinning_agrees_with_the_sampler_of_small_gicp_and_takes_further_rows_along():
    points = room(3000)
    expected = small_gicp.voxelgrid_sampling(points, 0.7).points()[:, :3]
    means = voxel_means(np.vstack([points.T, points[:, 0] * 2.0]), 0.7)
    order, other = (np.lexsort(table.T) for table in (means[:3].T, expected))
    assert means[:3].T[order] == pytest.approx(expected[other], abs=1e-9)
    assert means[3] == pytest.approx(means[0] * 2.0)


@pytest.mark.parametrize('far', [0.0, 1e7], ids=['numbered_voxels', 'too_many_to_number'])
def test_voxels_come_in_the_order_of_their_last_points(far):
    points = np.vstack([room(3000), np.full((1, 3), far)])
    last = {tuple(np.floor(point / 0.5)): i for i, point in enumerate(points)}
    found = [last[tuple(np.floor(point / 0.5))] for point in thin(points, 0.5)]
    assert found == sorted(last.values())


def test_nothing_is_thinned_to_nothing():
    assert thin(np.zeros((0, 3)), 0.5).shape == (0, 3)
