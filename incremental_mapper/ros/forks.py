"""Forks of the node: its state as it is in one moment, at a cost of some 10 ms for each gigabyte.

A fork has a session of its own and does not listen to SIGINT and SIGTERM.

What a fork must beware of: other threads are not in it, and locks that they held stay locked. So
it touches neither the middleware nor anything else that the node's other threads use; GTSAM and
the compiled parts have no threads and no locks of their own here, and the C library and Python
put theirs right.
"""

import contextlib
import gc
import os
import signal
import sys
import time
import warnings
from pathlib import Path

STUCK = 120.0
"""Seconds without any work done after which a fork may be ended."""


def forked() -> int:
    """Fork; returns as ``os.fork``.

    Raises:
        OSError: There is no room for another process.
    """
    # Whatever waits to be written would be written twice.
    sys.stdout.flush()
    sys.stderr.flush()
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', DeprecationWarning)  # see above
        return os.fork()


def stand_alone() -> None:
    """What a fork does first: let go of what belongs to the node."""
    os.setsid()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    # Looking for garbage would touch, and so copy, every page of the map.
    gc.disable()
    _let_go()
    sys.stderr = open(2, 'w', closefd=False)  # noqa: SIM115 (its lock may be held)


class Idleness:
    """Whether a process does nothing; asked now and then."""

    def __init__(self, child: int) -> None:
        self._child = child
        self._work, self._worked = -1, time.monotonic()

    @property
    def stuck(self) -> bool:
        """Whether it did no work for ``STUCK``, as far as it was asked."""
        now = _work(self._child)
        if now != self._work:
            self._work, self._worked = now, time.monotonic()
        return time.monotonic() - self._worked > STUCK


def _work(child: int) -> int:
    """A number that changes while a process works: its time on a processor, and what it wrote.

    It grows while it waits for its turn, too.
    """
    try:
        fields = Path(f'/proc/{child}/stat').read_text(encoding='ascii').rpartition(')')[2].split()
        written = Path(f'/proc/{child}/io').read_text(encoding='ascii').split()
    except OSError:
        return time.monotonic_ns()  # it cannot be told here
    return int(fields[11]) + int(fields[12]) + int(written[written.index('write_bytes:') + 1])


def tell(pipe: int, data: bytes) -> None:
    """Write to whoever listens, if anybody still does."""
    with contextlib.suppress(OSError):
        while data:
            data = data[os.write(pipe, data) :]


def _let_go() -> None:
    """Close what belongs to the middleware, so that a node that follows finds it free."""
    with contextlib.suppress(OSError):
        for path in list(Path('/proc/self/fd').iterdir()):
            with contextlib.suppress(OSError):
                place = str(path.readlink())
                if place.startswith('socket:') or 'fastrtps' in place or 'fastdds' in place:
                    os.close(int(path.name))
