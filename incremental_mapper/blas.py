"""Keeps BLAS from using threads: they cost more than they bring where matrices are small."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from typing import Any


def start_no_threads() -> None:
    """Keep BLAS from starting threads; for a program of its own, before it imports numpy.

    Each library that brings a BLAS starts some when it is imported, and they spin for a while: in
    a program that imports numpy and scipy that takes 0.2 s of the other cores.
    """
    os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')


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
    from threadpoolctl import ThreadpoolController  # a program's help does without

    # Looking for them takes a millisecond, asking those that were found almost nothing.
    found: Sequence[Any] = ThreadpoolController().select(user_api='blas').lib_controllers
    return found
