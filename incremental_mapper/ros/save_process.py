"""Saves in processes of their own, so that nobody waits for them and nothing ends them.

GTSAM solves and numbers become text under Python's lock: a thread that saves a map of ten minutes
keeps the windows waiting for as long as it takes. A fork costs some 10 ms for each gigabyte, holds
the map as it was in that moment, and goes on by itself where the node is killed: it has a session
of its own and does not listen to SIGINT and SIGTERM. What a fork must beware of
is in ``forks``.
"""

import contextlib
import fcntl
import os
import pickle
import select
import signal
import struct
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from incremental_mapper.errors import MapperError
from incremental_mapper.results.draw import MODULE as DRAW
from incremental_mapper.ros.forks import Idleness, forked, stand_alone, tell
from incremental_mapper.ros.saving import Saved
from incremental_mapper.ros.urgency import make_way

MOST = 2
"""Saves that may be under way: one that writes, one that waits for its turn with its snapshot."""
LOOK = 5.0
"""Seconds between two looks at whether a save gets on."""
NICE = 5
"""By how much a save is less urgent than the windows, and what follows it again than a save."""
LENGTH = struct.Struct('<Q')


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a save: the folder, or why there is none.

    ``fault`` is the traceback where the program is to blame; ``died`` tells that the process ended
    before it had an answer, so that the save may be tried without one.
    """

    saved: Saved | None
    reason: str = ''
    fault: str = ''
    died: bool = False


@dataclass(frozen=True, slots=True)
class Job:
    """A save.

    Attributes:
        save: Writes the data; raises MapperError where it cannot.
        more: Writes what may follow into the folder; returns a remark where it cannot.
        pictures: Whether pictures follow.
        quiet: Whether it makes way for the windows.
    """

    save: Callable[[], Saved]
    more: Callable[[Path], str | None] = lambda _: None
    pictures: bool = True
    quiet: bool = True


class SaveProcesses:
    """Runs jobs, each in a fork, one after the other.

    ``remark`` is told what could not be added to a map that is saved; it is called by any thread.
    """

    def __init__(self, remark: Callable[[str], None]) -> None:
        self._remark = remark
        self._changed = threading.Condition()
        self._saving = self._drawing = 0
        # A lock that goes with its process, in a file that nobody else sees.
        self._turn = os.memfd_create('turn') if hasattr(os, 'memfd_create') else None

    @property
    def saving(self) -> int:
        """How many saves do not have their data in place."""
        return self._saving

    def start(self, job: Job, done: Callable[[Outcome], None]) -> None:
        """Begin a save of the state as it is; waits where ``MOST`` are under way.

        Args:
            job: What is done.
            done: Called once, in another thread, when the data are in place or cannot be.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._saving < MOST)
            self._saving += 1
        mine, theirs = os.pipe()
        try:
            child = forked()
        except OSError:
            os.close(mine)
            os.close(theirs)
            self._save_here(job, done)
            return
        if child == 0:
            _save_there(job, theirs, self._turn)
        os.close(theirs)
        watch = threading.Thread(
            target=self._watch, args=(child, mine, done), name='save', daemon=True
        )
        watch.start()

    def wait(self) -> None:
        """Wait until the data of all saves are in place, or cannot be."""
        with self._changed:
            self._changed.wait_for(lambda: self._saving == 0)

    def wait_for_pictures(self, seconds: float) -> bool:
        """Wait for what follows the data, for so long at most; returns whether all is done."""
        with self._changed:
            return self._changed.wait_for(lambda: self._drawing == 0, seconds)

    def _save_here(self, job: Job, done: Callable[[Outcome], None]) -> None:
        """Without a process, as where memory does not suffice for one."""
        outcome = run_here(job.save)
        done(outcome)
        with self._changed:
            self._saving -= 1
            self._changed.notify_all()
        if outcome.saved is None:
            return
        remark = job.more(outcome.saved.folder)
        if remark is not None:
            self._remark(remark)
        if job.pictures:
            with contextlib.suppress(OSError):
                subprocess.Popen(draw_command(outcome.saved.folder), start_new_session=True)

    def _watch(self, child: int, pipe: int, done: Callable[[Outcome], None]) -> None:
        with open(pipe, 'rb', buffering=0) as answers:
            outcome = _answer(child, answers.fileno())
            done(outcome)
            with self._changed:
                self._saving -= 1
                self._drawing += 1
                self._changed.notify_all()
            said = b''.join(iter(lambda: answers.read(1 << 16), b''))
        os.waitpid(child, 0)
        if said.strip() and not outcome.died:
            self._remark(said.decode(errors='replace').strip())
        with self._changed:
            self._drawing -= 1
            self._changed.notify_all()


def run_here(save: Callable[[], Saved]) -> Outcome:
    """Save in this thread.

    Args:
        save: Writes the data.
    """
    try:
        return Outcome(save())
    except MapperError as error:
        return Outcome(None, str(error))
    # A map that cannot be saved is no reason to lose it.
    except Exception:
        return Outcome(None, 'saving failed; the log says how', traceback.format_exc())


def draw_command(folder: Path) -> list[str]:
    """The program that draws a folder's pictures.

    Args:
        folder: The output of a run.
    """
    return [sys.executable, '-m', DRAW, str(folder)]


def _answer(child: int, pipe: int) -> Outcome:
    """The outcome that a process tells; ends it where it does nothing for long."""
    data, idle = b'', Idleness(child)
    while len(data) < LENGTH.size or len(data) < LENGTH.size + LENGTH.unpack_from(data)[0]:
        if not select.select([pipe], [], [], LOOK)[0]:
            if idle.stuck:
                os.kill(child, signal.SIGKILL)
            continue
        # No more than the answer: what is said afterwards is read by another.
        wanted = LENGTH.size - len(data)
        if wanted <= 0:
            wanted = LENGTH.size + LENGTH.unpack_from(data)[0] - len(data)
        part = os.read(pipe, wanted)
        if not part:
            reason = 'the process that saved the map was ended before it was done'
            return Outcome(None, reason, died=True)
        data += part
    outcome: Outcome = pickle.loads(data[LENGTH.size :])
    return outcome


def _save_there(job: Job, pipe: int, turn: int | None) -> NoReturn:
    """The whole life of the process."""
    try:
        stand_alone()
        if job.quiet:
            make_way(NICE)
        if turn is not None:
            while not _took(turn):
                time.sleep(0.1)  # which is work, if little, for whoever watches
        outcome = run_here(job.save)
        data = pickle.dumps(outcome)
        tell(pipe, LENGTH.pack(len(data)) + data)
        if turn is not None:
            fcntl.lockf(turn, fcntl.LOCK_UN)
        if outcome.saved is not None:
            make_way(NICE)
            _follow(job, outcome.saved.folder, pipe)
    except BaseException:
        tell(pipe, traceback.format_exc().encode())
    finally:
        os._exit(0)


def _follow(job: Job, folder: Path, pipe: int) -> None:
    """Add what may follow, and become the program that draws."""
    remark = job.more(folder)
    if remark is not None:
        tell(pipe, f'{remark}\n'.encode())
    if not job.pictures:
        return
    silence = os.open(os.devnull, os.O_RDWR)
    for number, place in ((silence, 0), (silence, 1), (pipe, 2)):
        os.dup2(number, place)
    os.execv(sys.executable, draw_command(folder))


def _took(turn: int) -> bool:
    try:
        fcntl.lockf(turn, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True
