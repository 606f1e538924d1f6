"""Keeps BLAS from using threads: they cost more than they bring where matrices are small."""

from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import threadpool_limits


@contextmanager
def small_algebra() -> Iterator[None]:
    """Limit BLAS to one thread inside, in the whole process.

    A window's matrices have a few dozen rows. Waking other threads for them takes longer than the
    work, and takes the cores away from the LiDARs' processes.
    """
    with threadpool_limits(limits=1, user_api='blas'):
        yield
