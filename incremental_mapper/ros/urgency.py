"""How urgent a process is beside the windows."""

import contextlib
import os
import time
from pathlib import Path

LEAST = 19
"""The least urgent that a process can be."""
ATTEMPTS, PAUSE = 5, 0.15
"""The kernel takes a group's niceness from users no more than ten times a second."""


def give_way() -> None:
    """Let every other process that has anything to do go first, at once, where that can be said.

    A process that is only nicer goes on for some milliseconds where another one wakes up, and
    windows wait for two or three of those. It has its share all the same where all processors are
    busy: that is told by its session's niceness.
    """
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))


def make_way(nice: int, process: int | None = None) -> None:
    """Make a process that has a session of its own less urgent than others.

    Where Linux groups processes by sessions (``autogroup``), as it does without control groups,
    each session has the same share of the processors, and niceness counts among its own processes
    alone; but the session has a niceness too.

    Args:
        nice: By how much.
        process: Its number; None is this one.
    """
    number = os.getpid() if process is None else process
    with contextlib.suppress(OSError):
        wanted = min(os.getpriority(os.PRIO_PROCESS, number) + nice, LEAST)
        os.setpriority(os.PRIO_PROCESS, number, wanted)
        group = Path(f'/proc/{number}/autogroup')
        for _ in range(ATTEMPTS):
            with contextlib.suppress(BlockingIOError):
                group.write_text(str(max(wanted, 0)), encoding='ascii')
                return
            time.sleep(PAUSE)
