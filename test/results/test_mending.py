"""What is left of a map that is begun anew."""

import gc
import weakref
from types import SimpleNamespace

import pytest

from incremental_mapper.garbage import search_little
from incremental_mapper.results import mending as module
from incremental_mapper.results.mending import MendError, mending


class Held:
    """A map that holds itself in a cycle."""

    def __init__(self):
        self.own = self


@pytest.fixture
def little_searched():
    callbacks = list(gc.callbacks)
    search_little()
    yield
    gc.callbacks[:] = callbacks
    gc.unfreeze()


def test_a_map_that_outlived_a_search_is_gone_before_the_next_one(little_searched, monkeypatch):
    monkeypatch.setattr(module, '_mended', lambda begun, found: begun)
    drive = SimpleNamespace(source=SimpleNamespace(info=SimpleNamespace(findings=())))
    run = SimpleNamespace(result=SimpleNamespace(findings=()))
    first = []

    def attempt(_, may_mend):
        if not first:
            held = Held()
            first.append(weakref.ref(held))
            gc.collect()  # as happens in a long drive: what is there is left out from now on
            raise MendError([])
        assert first[0]() is None
        return run

    assert mending(drive, attempt) is run
