"""Rows of windows: all of them come back, and a night of them takes little memory."""

import tracemalloc
from collections import Counter

from incremental_mapper.mapping.row_archive import BLOCK, RowArchive
from incremental_mapper.mapping.statistics import window_row


def row(index):
    seconds = {'front_end': 0.012 + 1e-7 * index, 'append': 0.003 + 3e-7 * index}
    return window_row(index, (10**9 * index, 10**9 * index + 10**8), [], 10, None, 0.1, seconds)


def test_rows_come_back_in_their_order_whatever_their_number():
    archive = RowArchive()
    for index in range(2 * BLOCK + 3):
        assert len(archive) == index
        archive.add(row(index))
    assert archive.all() == tuple(row(number) for number in range(2 * BLOCK + 3))


def test_a_window_takes_a_tenth_of_what_its_row_does():
    counts = Counter()
    for keep, name in ((RowArchive().add, 'packed'), ([].append, 'plain')):
        tracemalloc.start()
        for index in range(20 * BLOCK):
            keep(row(index))
        counts[name] = tracemalloc.get_traced_memory()[0]
        tracemalloc.stop()
    assert counts['packed'] < counts['plain'] / 10
    assert counts['packed'] / (20 * BLOCK) < 120
