"""A Python process of our own that is asked on its standard input and answers on its output."""

import fcntl
import os
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from typing import IO, BinaryIO, Protocol

ROOM = 1 << 20
"""Bytes that a pipe holds, the most that Linux grants everybody. Where an answer fits, whoever
gives it can go on before it is taken; by default that is 64 KiB."""


class Helper(Protocol):
    """A process with pipes to its standard input and output, as ``subprocess.Popen`` has it."""

    @property
    def stdin(self) -> IO[bytes] | None:
        """Where it is asked."""

    @property
    def stdout(self) -> IO[bytes] | None:
        """Where it answers."""

    @property
    def pid(self) -> int:
        """Number of the process."""

    def poll(self) -> int | None:
        """None while it runs."""

    def kill(self) -> None:
        """End it at once."""

    def wait(self) -> int:
        """Wait until it has ended."""

    def communicate(self) -> tuple[bytes, bytes | None]:
        """End its input, and take what it answers until it ends."""


def start(module: str, surroundings: Mapping[str, str] | None = None) -> Helper:
    """Start a module as a program.

    Args:
        module: Its name; its ``main`` takes ``streams``.
        surroundings: Further variables of its environment.
    """
    # In a session of its own, so that Ctrl-C reaches the caller alone, which then ends it.
    process = subprocess.Popen(
        [sys.executable, '-m', module],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={**os.environ, **(surroundings or {})},
        start_new_session=True,
    )
    for pipe in (process.stdin, process.stdout):
        assert pipe is not None
        widen(pipe.fileno())
    return process


def widen(pipe: int) -> None:
    """Give a pipe its ``ROOM``, where there is any left."""
    with suppress(OSError, AttributeError):  # no room is left, or it is not Linux
        fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, ROOM)


def streams() -> tuple[BinaryIO, BinaryIO]:
    """In such a process: what is asked, and where answers go; what is printed goes to stderr."""
    answers = os.fdopen(os.dup(sys.stdout.fileno()), 'wb')
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    return sys.stdin.buffer, answers
