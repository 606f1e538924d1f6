"""Searches for closed loops in forks of the node, one at a time.

GTSAM holds Python's lock while it solves, so a thread would keep the windows waiting. What a fork
has found comes back in a file without a name and is unpacked in a thread, in parts.
"""

import os
import pickle
import signal
import tempfile
import threading
import time
import traceback
from collections.abc import Callable
from typing import BinaryIO, NoReturn

from incremental_mapper.mapping.live_closing import Arrived, Search, unpacked
from incremental_mapper.ros.forks import Idleness, forked, stand_alone
from incremental_mapper.ros.urgency import give_way, make_way

NICE = 10
"""By how much a search is less urgent than the windows; a save is half as polite."""
LOOK = 0.05
"""Seconds between two looks whether a search has ended."""
ENDED = 'the search for closed loops was ended before it was done; it is tried again'
FAULT = 'the search for closed loops failed'


class SearchProcess:
    """Runs searches in forks; see Runner."""

    def __init__(self) -> None:
        self._child: int | None = None
        self._arrived: Arrived | None = None
        self._lock = threading.Lock()
        self._closed = False

    def start(self, search: Callable[[], Search]) -> bool:
        """See Runner."""
        try:
            file = _nameless()
        except OSError:
            return False
        try:
            child = forked()
        except OSError:
            file.close()
            return False
        if child == 0:
            _search_there(search, file)
        self._child = child
        threading.Thread(target=self._watch, args=(child, file), name='loops', daemon=True).start()
        return True

    def arrived(self) -> Arrived | None:
        """See Runner."""
        arrived, self._arrived = self._arrived, None
        return arrived

    def close(self) -> None:
        """See Runner."""
        with self._lock:
            self._closed = True
            if self._child is not None:
                os.kill(self._child, signal.SIGKILL)

    @property
    def pid(self) -> int | None:
        """Number of the process; None where no search goes on."""
        return self._child

    def _watch(self, child: int, file: BinaryIO) -> None:
        idle = Idleness(child)
        # Its number is another process's as soon as it was waited for, so nobody may end it then.
        while not self._ended(child):
            time.sleep(LOOK)
            if idle.stuck:
                os.kill(child, signal.SIGKILL)
        with file:
            if not self._closed:
                self._arrived = _read(file)

    def _ended(self, child: int) -> bool:
        with self._lock:
            ended = os.waitpid(child, os.WNOHANG)[0] == child
            if ended:
                self._child = None
            return ended


def _nameless() -> BinaryIO:
    if hasattr(os, 'memfd_create'):
        return os.fdopen(os.memfd_create('loops'), 'w+b')
    return tempfile.TemporaryFile()


def _search_there(search: Callable[[], Search], file: BinaryIO) -> NoReturn:
    """The whole life of the process."""
    try:
        stand_alone()
        make_way(NICE)
        give_way()
        try:
            found: Search | str = search()
        # The libraries below raise what they like; the map goes on without what they would find.
        except Exception:
            found = traceback.format_exc()
        pickle.dump(found, file, protocol=pickle.HIGHEST_PROTOCOL)
        file.flush()
    finally:
        os._exit(0)


def _read(file: BinaryIO) -> Arrived:
    """What a process has left."""
    try:
        file.seek(0)
        found = pickle.load(file)
        if isinstance(found, str):
            return Arrived(None, trouble=f'{FAULT}:\n{found}')
        return unpacked(found)
    except (EOFError, OSError, pickle.UnpicklingError):
        return Arrived(None, trouble=ENDED)
