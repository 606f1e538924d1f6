"""Python's search for garbage: what outlived it is left alone, and nothing is kept for ever."""

import gc
import subprocess
import sys
import weakref
from collections.abc import Iterator

import pytest

from incremental_mapper import garbage
from incremental_mapper.garbage import search_all, search_little, set_aside, unsearched


class Held:
    """Something that holds itself."""

    def __init__(self) -> None:
        self.itself = self


@pytest.fixture
def little() -> Iterator[None]:
    """Search little, and leave this process as it was."""
    before = sys.unraisablehook
    search_little()
    yield
    sys.unraisablehook = before
    gc.callbacks.remove(garbage._after_search)
    gc.unfreeze()


@pytest.mark.usefixtures('little')
def test_a_search_leaves_out_what_has_outlived_one() -> None:
    search_all()
    kept = [Held() for _ in range(1000)]
    gc.collect()
    # What is set aside is in no generation, so that the next search does not come upon it.
    assert not any(isinstance(item, Held) for item in gc.get_objects())
    assert gc.get_freeze_count() > len(kept)


@pytest.mark.usefixtures('little')
def test_cycles_that_die_before_a_search_are_let_go() -> None:
    search_all()
    seen = weakref.ref(Held())
    gc.collect()
    assert seen() is None


@pytest.mark.usefixtures('little')
def test_everything_is_looked_at_when_a_map_begins() -> None:
    held = Held()
    search_all()
    seen = weakref.ref(held)
    del held
    gc.collect()
    assert seen() is not None
    search_all()
    assert seen() is None


@pytest.mark.usefixtures('little')
def test_what_is_there_can_be_set_aside() -> None:
    search_all()
    kept = Held()
    set_aside()
    assert not any(item is kept for item in gc.get_objects())


def test_without_it_the_search_is_python_s_own() -> None:
    search_all()
    set_aside()
    assert gc.get_freeze_count() == 0


INTERRUPTED = """
import gc, time
from incremental_mapper.garbage import search_little

search_little()
times = iter([KeyboardInterrupt])


def interrupt(phase, about):
    for one in times:
        raise one  # as where Ctrl-C comes within a search


gc.callbacks.append(interrupt)
try:
    gc.collect()
    time.sleep(30.0)
except KeyboardInterrupt:
    print("interrupted")
"""


def test_an_interrupt_that_meets_a_search_ends_the_program_all_the_same() -> None:
    done = subprocess.run(
        [sys.executable, '-c', INTERRUPTED], capture_output=True, text=True, timeout=20
    )
    assert (done.stdout, done.stderr) == ('interrupted\n', '')


@pytest.mark.usefixtures('little')
def test_what_is_made_unsearched_is_not_looked_at_later_either() -> None:
    with unsearched():
        assert not gc.isenabled()
        kept = [Held() for _ in range(1000)]
    assert gc.isenabled()
    assert gc.get_freeze_count() > len(kept)
    gc.disable()
    with unsearched():
        pass
    assert not gc.isenabled()
    gc.enable()
