"""Processes that prepare a LiDAR's scans, and the seed from which they are forked.

The seed takes most of a second to import what they need. A program that is about to import more
than that starts it first; it ends with the last that has asked for it.
"""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from incremental_mapper.helper_process import Helper, start
from incremental_mapper.helper_seed import Seed, possible

_MODULE = 'incremental_mapper.frontend.odometry_process'
_SURROUNDINGS = {
    # The processes share the cores among themselves; their libraries' threads would only compete.
    'OMP_NUM_THREADS': '1',
    'OPENBLAS_NUM_THREADS': '1',
    # Memory for a cloud is kept for the next one. By default glibc gives large pieces back at once,
    # and the pages that the next cloud gets anew cost half as much as thinning it.
    'MALLOC_MMAP_THRESHOLD_': str(64 << 20),
    'MALLOC_TRIM_THRESHOLD_': str(64 << 20),
}

_lock = threading.Lock()
_seed: Seed | None = None
_holders = 0


def hold() -> None:
    """Ask for the seed; it is not waited for, and ``let_go`` must follow."""
    global _seed, _holders
    with _lock:
        _holders += 1
        if _seed is None and possible():
            _seed = Seed([_MODULE], _SURROUNDINGS)


def let_go() -> None:
    """The seed is not needed any more by whoever held it."""
    global _seed, _holders
    with _lock:
        _holders -= 1
        if _holders == 0 and _seed is not None:
            _seed.close()
            _seed = None


@contextmanager
def ahead() -> Iterator[None]:
    """Have the seed get ready while the block imports; on a single core it would be in its way."""
    several = (os.cpu_count() or 1) > 1
    if several:
        hold()
    try:
        yield
    finally:
        if several:
            let_go()


def scan_server() -> Helper:
    """A process that serves as ``odometry_process`` says, and has served nobody yet."""
    return helper(_MODULE)


def helper(module: str) -> Helper:
    """A process that is a module's ``main``, forked from the seed where somebody holds it.

    Args:
        module: Its name. What LiDARs' processes import is there already.
    """
    global _seed
    with _lock:
        if _seed is not None:
            try:
                return _seed.start(module)
            except OSError:  # it was killed
                _seed.close()
                _seed = Seed([_MODULE], _SURROUNDINGS)
    return start(module, _SURROUNDINGS)
