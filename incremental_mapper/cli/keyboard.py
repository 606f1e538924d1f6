"""Single keys from the terminal while something runs."""

import os
import select
import sys
import termios
import time
import tty
from typing import Any

PAUSE = b' '


class Keyboard:
    """Watches for the space bar; without a terminal it only passes the time.

    A context manager: the terminal hands over keys without Enter while it is entered.
    """

    def __init__(self) -> None:
        self._terminal: int | None = None
        self._before: list[Any] = []

    def __enter__(self) -> 'Keyboard':
        """Start to watch, if there is a terminal."""
        if sys.stdin is not None and not sys.stdin.closed and sys.stdin.isatty():
            terminal = sys.stdin.fileno()
            if _in_foreground(terminal):
                self._before = termios.tcgetattr(terminal)
                tty.setcbreak(terminal)
                self._terminal = terminal
        return self

    def __exit__(self, *error: object) -> None:
        """Give the terminal back as it was."""
        if self._terminal is not None and _in_foreground(self._terminal):
            termios.tcsetattr(self._terminal, termios.TCSADRAIN, self._before)

    def wait(self, seconds: float) -> bool:
        """Wait that long; returns True at once when the space bar is pressed."""
        end = time.monotonic() + seconds
        while self._terminal is not None and _in_foreground(self._terminal):
            left = max(end - time.monotonic(), 0.0)
            if not select.select([self._terminal], [], [], left)[0]:
                return False
            key = os.read(self._terminal, 1)
            if key == PAUSE:
                return True
            if not key:  # the terminal is gone
                self._terminal = None
        time.sleep(max(end - time.monotonic(), 0.0))
        return False


def _in_foreground(terminal: int) -> bool:
    """Whether this process may use the terminal; a background job that tries to is stopped."""
    try:
        return os.tcgetpgrp(terminal) == os.getpgrp()
    except OSError:
        return False
