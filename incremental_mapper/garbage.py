"""Python's search for garbage: what it costs must not grow with what a program holds.

A full search looks at every object that there is. For what is imported alone that takes 0.2 to
0.4 s, in the middle of a drive, and longer with every window that is mapped. So what is there when
a map begins, and what has outlived one search, is left out of those that follow, until everything
is looked at again as the next map begins. The node and the commands do so, which are programs of
their own; whoever imports the package keeps Python's way.
"""

import gc
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

AGAIN = 0.01
"""Seconds after which an interrupt that met a search comes again."""


def search_little() -> None:
    """From now on, leave out of a full search what has outlived one; for a program of its own.

    A Ctrl-C that comes just then is handed on: Python drops what is raised within a search.
    """
    if _after_search not in gc.callbacks:
        gc.callbacks.append(_after_search)
        sys.unraisablehook = _hand_on


@contextmanager
def unsearched() -> Iterator[None]:
    """Search for nothing inside: what is imported stays, and looking at it takes 0.1 s."""
    before = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if _after_search in gc.callbacks:
            gc.freeze()
        if before:
            gc.enable()


def search_all() -> None:
    """Look at everything: a map that was let go is large, and may hold itself in cycles."""
    if _after_search in gc.callbacks:
        gc.unfreeze()
    gc.collect()


def set_aside() -> None:
    """Leave out what is there by now, where little is to be searched."""
    if _after_search in gc.callbacks:
        gc.freeze()
        # Python waits with the next full search until a quarter more has come than the last found.
        gc.collect()


def _after_search(phase: str, about: dict[str, Any]) -> None:
    if phase == 'stop' and about['generation'] == 2:
        gc.freeze()


def _hand_on(dropped: 'UnraisableHookArgs') -> None:
    if dropped.exc_type is KeyboardInterrupt:
        threading.Timer(AGAIN, _interrupt_again).start()
    else:
        sys.__unraisablehook__(dropped)


def _interrupt_again() -> None:
    # To the main thread itself: it may sleep.
    signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
