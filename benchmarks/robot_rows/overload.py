"""More than the machine can map: the node stays near, and says what it leaves out."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

from incremental_mapper.ros.programs import running
from robot_rows import Seen, row
from robot_rows.clocks import dropped, live, messages

SECONDS = 20.0
BUSY = 6
"""Programs that do nothing but take the processors away."""
WARM_UP = 30
"""Windows after which the latency counts."""
BOUND = 1.5
"""Seconds: ``queue.max_delay``, and what the windows themselves take on such a machine."""


@contextmanager
def busy(count: int) -> Iterator[None]:
    """So many programs that never rest, while the block runs."""
    with ExitStack() as stack:
        for _ in range(count):
            command = [sys.executable, '-c', 'while True: pass']
            stack.enter_context(running(command, os.environ, subprocess.DEVNULL))
        yield


@row('latency grew to 5 s within 12 s')
def busy_machine(folder: Path) -> Seen:
    """20 s at KAIST's rates while six programs take the processors away."""
    sent = [item for item in messages() if item.at < SECONDS]
    seen = live(folder, sent, {'queue.max_delay': 1.0}, beside=lambda: busy(BUSY))
    p50, p99, worst = np.percentile(seen.latencies[WARM_UP:], [50, 99, 100]) / 1e3
    worker = seen.parts['worker']
    shed = seen.parts['left']['dropped'].get('overload', 0) + worker['limited_windows']
    return Seen(
        f'{len(seen.latencies)} windows: p50 {p50:.2f} s, p99 {p99:.2f} s, worst {worst:.2f} s; '
        f'{worker["limited_windows"]} windows searched less, {worker["merged_windows"]} merged, '
        f'left out: {dropped(seen)}; ATE {seen.ate:.3f} m, '
        f'{seen.parts["map"]["components"]} component',
        bool(p99 <= BOUND and shed > 0 and seen.lost == 0 and seen.ate < 1.0),
    )
