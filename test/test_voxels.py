"""Voxel means: which points stand for which, in which order."""

import numpy as np
import pytest
import small_gicp
from driven_room import room
from scipy.spatial.transform import Rotation

from incremental_mapper.voxels import ROOM, means_within, thin, voxel_means


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


def test_more_voxels_than_there_is_room_for_at_first_are_all_kept():
    side = np.arange(-20.0, 20.0)
    points = np.stack(np.meshgrid(side, side, side), axis=-1).reshape(-1, 3) + 0.5
    points = np.random.default_rng(2).permutation(np.vstack([points, points]))
    assert len(points) // 2 > 4 * ROOM
    _, last = np.unique(points[::-1], axis=0, return_index=True)
    expected = points[np.sort(len(points) - 1 - last)]
    assert np.array_equal(thin(points, 1.0), expected)


def test_points_within_range_are_moved_before_they_are_thinned():
    rng = np.random.default_rng(4)
    points = np.vstack([room(3000), [[np.nan, 0.0, 0.0], [0.0, 0.0, np.inf]]]).astype(np.float32)
    further = rng.uniform(0.0, 1.0, (2, len(points))).astype(np.float32)
    turn = Rotation.from_rotvec([0.1, -0.4, 1.2]).as_matrix()
    matrix = np.eye(4, dtype=np.float32)
    matrix[:3] = np.column_stack([turn, [3.0, -1.0, 0.5]])
    distance = np.linalg.norm(points, axis=1)
    near, far = np.nanquantile(distance[np.isfinite(distance)], [0.2, 0.8])
    kept = (distance >= near) & (distance <= far)
    moved = points[kept].astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    expected = voxel_means(np.vstack([moved.T, further[:, kept]]), 0.7)
    found = means_within(points, further, matrix, (near, far), 0.7)
    assert found.shape == expected.shape
    assert found == pytest.approx(expected, abs=1e-5)
