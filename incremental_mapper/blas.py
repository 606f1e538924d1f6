"""Keeps BLAS from using threads: they cost more than they bring where matrices are small."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

from threadpoolctl import ThreadpoolController


@contextmanager
def single_threaded_blas() -> Iterator[None]:
    """Limit BLAS to one thread inside, in the whole process.

    A window's matrices have a few dozen rows. Waking other threads for them takes longer than the
    work, and takes the cores away from the LiDARs' processes.
    """
    with _controller().limit(limits=1, user_api='blas'):
        yield


@cache
def _controller() -> ThreadpoolController:
    # Looking for the libraries takes a millisecond, using what was found almost nothing.
    return ThreadpoolController()
