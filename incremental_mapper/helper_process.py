"""A Python process of our own that is asked on its standard input and answers on its output."""

import os
import subprocess
import sys
from collections.abc import Mapping
from typing import BinaryIO, TypeAlias

Helper: TypeAlias = 'subprocess.Popen[bytes]'


def start(module: str, surroundings: Mapping[str, str] | None = None) -> Helper:
    """Start a module as a program.

    Args:
        module: Its name; its ``main`` takes ``streams``.
        surroundings: Further variables of its environment.
    """
    # In a session of its own, so that Ctrl-C reaches the caller alone, which then ends it.
    return subprocess.Popen(
        [sys.executable, '-m', module],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={**os.environ, **(surroundings or {})},
        start_new_session=True,
    )


def streams() -> tuple[BinaryIO, BinaryIO]:
    """In such a process: what is asked, and where answers go; what is printed goes to stderr."""
    answers = os.fdopen(os.dup(sys.stdout.fileno()), 'wb')
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    return sys.stdin.buffer, answers
