"""Which processes prepare scans, however deep below this one they are."""

import os
from pathlib import Path


def scan_processes(parent: str | None = None) -> list[str]:
    """Numbers of the processes below one, by default this one, whichever thread made them.

    The seed counts as well: it has the command of what is forked from it.
    """
    found = []
    for task in Path(f'/proc/{parent or os.getpid()}/task').iterdir():
        for number in (task / 'children').read_text(encoding='ascii').split():
            command = Path(f'/proc/{number}/cmdline').read_text(encoding='utf-8')
            found += [number] if 'odometry_process' in command else []
            found += scan_processes(number)
    return found
