"""Rows that grow in memory that a fork shares."""

import os

import numpy as np
import pytest
from full_disk import largest_file

from incremental_mapper.map.shared_rows import SHARED, SharedRows, shared_zeros

pytestmark = pytest.mark.skipif(not SHARED, reason='the system has no such memory')


def test_rows_stay_while_they_grow():
    rows = SharedRows(3)
    kept = rows.grown(2)
    kept[:] = [[1, 2, 3], [4, 5, 6]]
    del kept
    assert rows.grown(50_000)[:3].tolist() == [[1, 2, 3], [4, 5, 6], [0, 0, 0]]


def test_nothing_that_is_still_held_is_moved():
    rows = SharedRows(3)
    held = rows.grown(2)
    with pytest.raises(BufferError):
        rows.grown(50_000)
    assert held.tolist() == [[0, 0, 0]] * 2


def test_a_fork_writes_into_the_same_memory():
    row, zeros = SharedRows(2).grown(1), shared_zeros(2)
    child = os.fork()
    if child == 0:
        row[0] = zeros[:] = 7
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0
    assert row.tolist() == [[7, 7]] and zeros.tolist() == [7, 7]


@pytest.mark.parametrize('first', [0, 10])
def test_rows_go_on_in_own_memory_where_no_file_may_become_that_large(first):
    rows, expected = SharedRows(3), np.arange(3 * 10, dtype=np.int32).reshape(10, 3)
    if first:
        rows.grown(first)[:] = expected
    with largest_file(4096):
        more = rows.grown(2000)
        assert more.shape == (2000, 3) and not more[first:].any()
        more[first : first + 1] = 7
    again = rows.grown(5000)
    assert np.array_equal(again[:first], expected[:first])
    assert (again[first] == 7).all() and not again[first + 1 :].any()
