"""Reading ahead in a thread."""

import threading
import time
from contextlib import closing
from itertools import count

import pytest

from incremental_mapper.ros.player.read_ahead import read_ahead


def wait_until(true):
    end = time.monotonic() + 10
    while not true():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.mark.parametrize('most', [1, 3, 1000])
def test_all_items_in_order(most):
    assert list(read_ahead(lambda: iter(range(100)), most)) == list(range(100))


def test_error_comes_after_the_items_before_it():
    def make():
        yield 1
        yield 2
        raise ValueError('torn')

    items = read_ahead(make, 10)
    assert [next(items), next(items)] == [1, 2]
    with pytest.raises(ValueError, match='torn'):
        next(items)


def test_stays_a_bounded_number_of_items_ahead():
    made = []

    def make():
        for number in count():
            made.append(number)
            yield number

    with closing(read_ahead(make, 5)) as items:
        assert next(items) == 0
        # One used, five that wait, one that finds no room.
        wait_until(lambda: len(made) == 7)
        time.sleep(0.3)
        assert len(made) == 7


def test_closing_ends_the_thread_and_the_reader():
    ended = threading.Event()

    def make():
        try:
            yield from count()
        finally:
            ended.set()

    with closing(read_ahead(make, 2)) as items:
        next(items)
    assert ended.wait(10)
    assert not [thread for thread in threading.enumerate() if thread.name == 'read_ahead']
