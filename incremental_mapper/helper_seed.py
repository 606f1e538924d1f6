"""Helper processes that are forked from one, the seed, which has imported what they need.

Such imports take 0.8 s of a core, and as much memory in each process. The seed does nothing but
import and fork: it has no other thread, and no lock is held there.
"""

import contextlib
import gc
import importlib
import os
import select
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO

from incremental_mapper.garbage import unsearched
from incremental_mapper.helper_process import Helper, widen


def possible() -> bool:
    """Whether the system can do it: a process that somebody else has forked has a handle."""
    return hasattr(os, 'pidfd_open') and hasattr(signal, 'pidfd_send_signal')


class Seed:
    """Forks helpers from a process that has imported what they need.

    Args:
        modules: What is imported at once; each has ``get_ready``, which brings into memory what
            the first answer would wait for.
        surroundings: Further variables of the environment.
    """

    def __init__(self, modules: Sequence[str], surroundings: Mapping[str, str]) -> None:
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            # In a session of its own, so that Ctrl-C reaches the caller alone, which then ends it.
            self._process = subprocess.Popen(
                [sys.executable, '-m', 'incremental_mapper.helper_seed', *modules],
                stdin=theirs.fileno(),
                stdout=subprocess.DEVNULL,
                env={**os.environ, **surroundings},
                start_new_session=True,
            )
        self._lock = threading.Lock()
        self._asked: list[_Forked] = []  # in order; there is no answer yet

    @property
    def pid(self) -> int:
        """Number of the process."""
        number: int = self._process.pid
        return number

    def start(self, module: str) -> Helper:
        """Ask for a helper; it may be written to before it is there.

        Args:
            module: Its name; its ``main`` takes ``helper_process.streams``.

        Raises:
            OSError: The process has ended.
        """
        asked, stdin = os.pipe()
        stdout, answers = os.pipe()
        helper = _Forked(self, os.fdopen(stdin, 'wb'), os.fdopen(stdout, 'rb'))
        widen(stdin)
        widen(stdout)
        try:
            with self._lock:
                socket.send_fds(self._socket, [module.encode()], [asked, answers])
                self._asked.append(helper)
        except OSError:
            helper.let_go()
            raise
        finally:
            os.close(asked)
            os.close(answers)
        return helper

    def settle(self, helper: '_Forked') -> None:
        """Wait until a helper that was asked for is there, or can never be."""
        with self._lock:
            while helper in self._asked:
                answer, handles = b'', list[int]()
                with contextlib.suppress(OSError):
                    answer, handles, _, _ = socket.recv_fds(self._socket, 32, 1)
                self._asked.pop(0).found(int(answer or 0), handles[0] if handles else None)

    def close(self) -> None:
        """End the process; what was forked goes on."""
        self._socket.close()  # which ends it, but not while it imports
        self._process.kill()
        self._process.wait()


class _Forked:
    """A helper that a seed has forked, or is about to; see ``Helper``."""

    def __init__(self, seed: Seed, stdin: IO[bytes], stdout: IO[bytes]) -> None:
        self.stdin, self.stdout = stdin, stdout
        self._seed = seed
        self._pid = 0
        self._handle: int | None = None

    def found(self, pid: int, handle: int | None) -> None:
        """Take the process's number and a handle on it; without one it never was."""
        self._pid, self._handle = pid, handle

    @property
    def pid(self) -> int:
        self._seed.settle(self)
        return self._pid

    def poll(self) -> int | None:
        return None if not self._ended(0.0) else 0

    def kill(self) -> None:
        self._seed.settle(self)
        if self._handle is not None:
            with contextlib.suppress(ProcessLookupError):
                signal.pidfd_send_signal(self._handle, signal.SIGKILL)

    def wait(self) -> int:
        self._ended(None)
        return 0

    def communicate(self) -> tuple[bytes, None]:
        with contextlib.suppress(OSError):  # it is gone, and never took the last of it
            self.stdin.close()
        answer = self.stdout.read()
        self.wait()
        self.let_go()
        return answer, None

    def let_go(self) -> None:
        """Close the pipes."""
        for pipe in (self.stdin, self.stdout):
            with contextlib.suppress(OSError):
                pipe.close()

    def _ended(self, timeout: float | None) -> bool:
        self._seed.settle(self)
        if self._handle is None:
            return True
        # It is ready to be read from once the process has ended.
        if not select.select([self._handle], [], [], timeout)[0]:
            return False
        os.close(self._handle)
        self._handle = None
        return True


def main() -> None:
    """In the seed: import, then fork what is asked for on a socket, the standard input."""
    with socket.socket(fileno=os.dup(0)) as asked:
        with unsearched():
            for name in sys.argv[1:]:
                importlib.import_module(name).get_ready()
        gc.freeze()  # what is there stays, and is never copied to be looked at
        signal.signal(signal.SIGCHLD, _reap)
        while True:
            try:
                wanted, pipes, _, _ = socket.recv_fds(asked, 256, 2)
            except OSError:
                break
            if not wanted:
                break
            # Until there is a handle on it, its number must not be given to another.
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGCHLD})
            pid = os.fork()
            if pid == 0:
                asked.close()
                _be(wanted.decode(), *pipes)
            handle = os.pidfd_open(pid)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGCHLD})
            with contextlib.suppress(OSError):  # whoever asked is gone
                socket.send_fds(asked, [str(pid).encode()], [handle])
            for number in (handle, *pipes):
                os.close(number)


def _reap(*_: object) -> None:
    """Take note of the helpers that have ended."""
    with contextlib.suppress(ChildProcessError):
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass


def _be(name: str, asked: int, answers: int) -> None:
    """In a fork: be a helper, to the end."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGCHLD})
    code = 1
    try:
        for number, place in ((asked, 0), (answers, 1)):
            os.dup2(number, place)
            os.close(number)
        with contextlib.suppress(OSError):  # what lists of processes show
            Path('/proc/self/comm').write_text(name.rpartition('.')[2], encoding='ascii')
        importlib.import_module(name).main()
        code = 0
    except BaseException:
        sys.excepthook(*sys.exc_info())
    finally:
        sys.stderr.flush()
        os._exit(code)


if __name__ == '__main__':
    main()
