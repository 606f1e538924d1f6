"""Rows that grow in memory that a fork shares."""

import os
import resource

import numpy as np
import pytest

from incremental_mapper.map.shared_rows import SHARED, SharedRows, shared_zeros
from incremental_mapper.map.voxel_grid import VoxelGrid

pytestmark = pytest.mark.skipif(not SHARED, reason='the system has no such memory')


def test_rows_stay_while_they_grow():
    rows = SharedRows(3)
    assert rows.rows().shape == (0, 3) and rows.grow(2)
    rows.rows()[:] = [[1, 2, 3], [4, 5, 6]]
    assert rows.grow(50_000)
    assert rows.rows()[:3].tolist() == [[1, 2, 3], [4, 5, 6], [0, 0, 0]]


def test_nothing_that_is_still_held_is_moved():
    rows = SharedRows(3)
    assert rows.grow(2)
    held = rows.rows()
    with pytest.raises(BufferError):
        rows.grow(50_000)
    assert held.tolist() == [[0, 0, 0]] * 2


def test_a_fork_writes_into_the_same_memory():
    rows, zeros = SharedRows(2), shared_zeros(2)
    assert rows.grow(1)
    row = rows.rows()
    child = os.fork()
    if child == 0:
        row[0] = zeros[:] = 7
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0
    assert row.tolist() == [[7, 7]] and zeros.tolist() == [7, 7]


@pytest.mark.parametrize('bytes_', [1000, 200_000])
def test_a_limit_on_the_size_of_files_costs_a_grid_nothing(bytes_):
    points = (np.arange(60_000, dtype=np.float32).reshape(-1, 3) * 0.5).astype(np.float32)
    wanted = VoxelGrid(0.5)
    wanted.add(points, np.eye(4))
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (bytes_, before[1]))
    try:
        grid = VoxelGrid(0.5, shared=True)
        for piece in np.array_split(points, 20):
            grid.add(piece, np.eye(4))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert np.array_equal(grid.points(), wanted.points())
