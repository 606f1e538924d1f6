"""Keeps BLAS from using threads: they cost more than they bring where matrices are small."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from typing import Any

from threadpoolctl import ThreadpoolController


@contextmanager
def single_threaded_blas() -> Iterator[None]:
    """Limit BLAS to one thread inside, in the whole process.

    A window's matrices have a few dozen rows. Waking other threads for them takes longer than the
    work, and takes the cores away from the LiDARs' processes.
    """
    libraries = _libraries()
    before = [library.get_num_threads() for library in libraries]
    for library in libraries:
        library.set_num_threads(1)
    try:
        yield
    finally:
        for library, threads in zip(libraries, before, strict=True):
            library.set_num_threads(threads)


@cache
def _libraries() -> Sequence[Any]:
    # Looking for them takes a millisecond, asking those that were found almost nothing.
    found: Sequence[Any] = ThreadpoolController().select(user_api='blas').lib_controllers
    return found
