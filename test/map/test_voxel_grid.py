"""Voxels with mean points: against NumPy, however they are filled, and beside each other."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from incremental_mapper.geometry import pose_matrix, transform_points
from incremental_mapper.map import voxel_grid
from incremental_mapper.map.voxel_grid import VoxelGrid, mean_points
from incremental_mapper.voxels import thin

SIZE = 0.5
TURNED = pose_matrix([20.0, -30.0, 1.0, 0.0, 0.0, np.sin(0.4), np.cos(0.4)])


def scattered(count, seed, spread=20.0):
    """Points that keep clear of the borders of their voxels, several in most of them."""
    rng = np.random.default_rng(seed)
    cells = rng.integers(-round(spread), round(spread), size=(count, 3)) // 4
    return ((cells + rng.uniform(0.05, 0.95, size=(count, 3))) * SIZE).astype(np.float32)


def cells(points):
    return np.floor(np.asarray(points, dtype=np.float64) / SIZE).astype(int)


def by_cell(points):
    return {tuple(cell): point for cell, point in zip(cells(points), points, strict=True)}


@settings(deadline=None, max_examples=60)
@given(
    st.integers(0, 3000),
    st.integers(0, 10_000),
    st.integers(1, 12),
    st.sampled_from([1, 50]),
    st.booleans(),
)
def test_grid_that_grows_is_the_one_that_had_room(count, seed, pieces, room, shared):
    points = scattered(count, seed)
    grid = VoxelGrid(SIZE, room=room, shared=shared)
    for piece in np.array_split(points, pieces):
        grid.add(piece, np.eye(4))
        grid.points()  # does not disturb it
    marks = np.arange(count, dtype=np.int32)
    at_once, _ = mean_points([(points, np.eye(4), marks)], count, np.zeros(3), SIZE)
    assert grid.points().tobytes() == at_once.tobytes()


def test_grid_that_grows_does_a_part_of_the_work_at_a_time(monkeypatch):
    points = (np.arange(60_000, dtype=np.float32).reshape(-1, 3) * SIZE).astype(np.float32)
    grid, moved = VoxelGrid(SIZE), []
    enter = voxel_grid._enter
    monkeypatch.setattr(
        voxel_grid, '_enter', lambda some, *rest: (moved.append(len(some)), enter(some, *rest))
    )
    for piece in np.array_split(points, 200):
        grid.add(piece, np.eye(4))
    assert sum(moved) > len(points)
    assert max(moved) <= voxel_grid.PARTS * len(piece)
    assert len(grid) == len(points)


@pytest.mark.parametrize('shared', [False, True])
def test_more_points_than_the_next_table_has_room_for(shared):
    points = scattered(40_000, 3, spread=400.0)
    grid = VoxelGrid(SIZE, room=600, shared=shared)
    for piece in (points[:500], points[500:620], points[620:]):
        grid.add(piece, np.eye(4))
    assert np.array_equal(np.sort(grid.points(), 0), np.sort(thin_all(points), 0))


def thin_all(points):
    marks = np.arange(len(points), dtype=np.int32)
    return mean_points([(points, np.eye(4), marks)], len(points), np.zeros(3), SIZE)[0]


def test_grid_that_grows_keeps_the_marks_of_first_points():
    points = scattered(2000, 5)
    grid = VoxelGrid(SIZE, room=1, marked=True)
    for part in np.split(np.arange(2000, dtype=np.int32), 8):
        grid.add(points[part], np.eye(4), part)
    firsts = np.sort(np.unique(cells(points), axis=0, return_index=True)[1])
    assert np.array_equal(grid.marks(), firsts)
    assert len(VoxelGrid(SIZE).marks()) == 0


@settings(deadline=None, max_examples=30)
@given(st.integers(1, 3000), st.integers(0, 10_000))
def test_points_are_the_means_of_their_voxels_in_the_order_of_the_first(count, seed):
    points = scattered(count, seed)
    grid = VoxelGrid(SIZE)
    for piece in np.array_split(points, 5):
        grid.add(piece, np.eye(4))
    made, wanted = by_cell(grid.points()), by_cell(thin(points.astype(np.float64), SIZE))
    assert list(made) == list(dict.fromkeys(map(tuple, cells(points))))
    assert made.keys() == wanted.keys()
    for cell, point in made.items():
        assert point == pytest.approx(wanted[cell], abs=1e-5)


@settings(deadline=None, max_examples=30)
@given(st.integers(1, 3000), st.integers(0, 10_000), st.sampled_from([0.0, 0.5, 1.0]))
def test_intensities_are_the_means_of_the_points_that_have_one(count, seed, known):
    points = scattered(count, seed)
    rng = np.random.default_rng(seed)
    light = rng.uniform(0.0, 255.0, count).astype(np.float32)
    light[rng.uniform(size=count) >= known] = np.nan
    grid, plain = VoxelGrid(SIZE, room=50), VoxelGrid(SIZE, room=50)
    for piece in np.array_split(np.column_stack([points, light]), 5):
        grid.add(piece, np.eye(4))
        plain.add(piece[:, :3], np.eye(4))
    made = grid.points()
    assert made.shape[1] == 4 and plain.points().shape[1] == 3
    assert np.ascontiguousarray(made[:, :3]).tobytes() == plain.points().tobytes()
    own = {}
    for cell, value in zip(map(tuple, cells(points)), light.tolist(), strict=True):
        own.setdefault(cell, []).append(value)
    for cell, found in zip(map(tuple, cells(made[:, :3])), made[:, 3], strict=True):
        values = np.array(own[cell])
        if np.isnan(values).all():
            assert np.isnan(found)
        elif np.isnan(values).any():  # those that have none may weigh as others do
            assert np.nanmin(values) - 1e-3 <= found <= np.nanmax(values) + 1e-3
        else:
            assert found == pytest.approx(values.mean(), rel=1e-5)
    near = grid.near(np.zeros(2), np.inf, 10**6)
    assert near.tobytes() == made.tobytes()


def test_points_without_intensity_leave_that_of_the_others():
    dark, bright = np.full((3, 3), 0.2), np.full((2, 4), 0.4)
    bright[:, 3] = 100.0, 50.0
    for order in ([dark, bright], [bright, dark], [bright[:1], dark, bright[:1]]):
        grid = VoxelGrid(1.0)
        for piece in order:
            grid.add(piece, np.eye(4))
        wanted = 100.0 if len(order) == 3 else None
        (point,) = grid.points()
        assert 50.0 <= point[3] <= 100.0 and (wanted is None or point[3] == wanted)


def test_points_are_placed_before_they_are_sorted_into_voxels():
    points = scattered(2000, 1)
    grid = VoxelGrid(0.01, corner=np.array([20.0, -30.0, 0.0]))
    grid.add(points, TURNED)
    placed = transform_points(TURNED, points.astype(np.float64))
    assert grid.points() == pytest.approx(placed, abs=1e-5)


def test_range_is_measured_in_the_frame_of_the_points():
    points = np.array([[3.0, 4.0, 0.0], [30.0, 40.0, 0.0], [np.nan, 1.0, 1.0]], dtype=np.float32)
    grid = VoxelGrid(SIZE, max_range=49.9)
    far = pose_matrix([500.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    grid.add(points, far)
    assert grid.points() == pytest.approx(np.array([[503.0, 4.0, 0.0]]))


def test_points_that_can_only_be_read_are_taken():
    points = scattered(100, 2)
    kept = np.frombuffer(points.tobytes(), dtype=np.float32).reshape(-1, 3)
    assert not kept.flags.writeable
    grids = [VoxelGrid(SIZE), VoxelGrid(SIZE)]
    for grid, given_points in zip(grids, (points, kept), strict=True):
        grid.add(given_points, np.eye(4))
    assert np.array_equal(grids[0].points(), grids[1].points())


@pytest.mark.parametrize('room', [1, 5000])
def test_voxels_of_another_grid_are_left_out(room):
    first, second = scattered(1500, 3), scattered(1500, 4, spread=30.0)
    grid, other = VoxelGrid(SIZE, room=room), VoxelGrid(SIZE)
    grid.add(second, TURNED)
    other.add(first, TURNED)
    found, taken = by_cell(grid.points(without=other)), by_cell(other.points())
    everything = by_cell(grid.points())
    assert 0 < len(found) < len(everything)
    assert found.keys() == everything.keys() - taken.keys()
    assert all(np.array_equal(found[cell], everything[cell]) for cell in found)
    assert len(grid.points(without=grid)) == 0
    assert np.array_equal(grid.points(without=VoxelGrid(SIZE)), grid.points())


def test_full_voxel_takes_no_more_and_the_others_do():
    grid = VoxelGrid(1.0, fullest=4.0)
    early, late = np.full((4, 3), 0.2), np.full((3, 3), 0.8)
    beside = np.array([[1.4, 0.5, 0.5], [1.6, 0.5, 0.5]])
    grid.add(np.concatenate([early, late, beside]), np.eye(4))
    wanted = np.array([[0.2, 0.2, 0.2], [1.5, 0.5, 0.5]])
    assert grid.points() == pytest.approx(wanted, abs=1e-6)


def test_empty_grid_has_no_points():
    grid = VoxelGrid(SIZE)
    assert grid.points().shape == (0, 3)
    grid.add(np.zeros((0, 3), dtype=np.float32), np.eye(4))
    assert grid.points(without=grid).shape == (0, 3)


def test_memory_is_that_of_the_voxels():
    grid = VoxelGrid(SIZE, room=1)
    empty = grid.nbytes
    points = np.arange(30_000, dtype=np.float32).reshape(-1, 3)
    for piece in np.array_split(points, 20):
        grid.add(piece, np.eye(4))
        grid.add(piece, np.eye(4))
    assert empty < 100
    assert 36 * len(points) <= grid.nbytes <= 64 * len(points)


@pytest.mark.parametrize('most', [10**6, 3000, 0])
@pytest.mark.parametrize('radius', [np.inf, 25.0])
def test_near_has_the_nearest_within_the_radius(most, radius):
    rng = np.random.default_rng(4)
    grid = VoxelGrid(SIZE)
    for step in range(30):  # a drive: what comes late is far from what came early
        points = rng.uniform([-8, -8, 0], [8, 8, 3], (1000, 3)) + [4.0 * step, 0.0, 0.0]
        grid.add(points.astype(np.float32), np.eye(4))
    centre = np.array([60.0, 2.0, 0.0])
    everything = grid.points()
    found = grid.near(centre, radius, most)
    assert len(found) <= most
    rows = {tuple(row) for row in everything.tolist()}
    assert {tuple(row) for row in found.tolist()} <= rows and len(found) == len(
        {tuple(row) for row in found.tolist()}
    )
    distance = np.linalg.norm(everything[:, :2] - centre[:2], axis=1)
    within = np.sort(distance[distance <= radius])
    # A voxel counts by its middle, whole rings at a time.
    slack = SIZE
    wanted = min(most, int((distance <= radius - slack).sum()))
    if most < len(within):
        assert most * 0.97 <= len(found)
        nearest = within[most - 1] if most else 0.0
    else:
        assert len(found) >= wanted
        nearest = radius
    if len(found):
        assert np.linalg.norm(found[:, :2] - centre[:2], axis=1).max() <= nearest + slack


def test_near_of_an_empty_grid():
    assert VoxelGrid(SIZE).near(np.zeros(2), np.inf, 10).shape == (0, 3)
    assert VoxelGrid(SIZE).near(np.zeros(2), 5.0, 10).shape == (0, 3)
