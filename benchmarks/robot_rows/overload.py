"""More than the machine can map: the node stays near, says so, and is in time again afterwards."""

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from incremental_mapper.ros.programs import running
from robot_rows import Seen, row
from robot_rows.clocks import WARM_UP, Live, Sent, dropped, live, messages

SECONDS = 20.0
BUSY = 6
"""Programs that do nothing but take the processors away."""
DELAY = 1.0
"""Seconds: ``queue.max_delay``."""
BOUND = 1.5
"""Seconds: that, and what the windows themselves take on such a machine."""
TOLD = 0.6
"""Seconds from which on a window is late, by half of the delay and its own length."""
CALM, RUSH, FASTER = 8.0, 28.0, 8.0
"""Seconds of the drive at which the rush begins and ends, and how much faster it is then."""
AGAIN = 2.0
"""Seconds after the rush within which the node is in time again."""
USUAL = 0.2
"""Seconds that the last message of a window is old when its odometry comes, at most."""
WARN = 1


@contextmanager
def busy(count: int) -> Iterator[None]:
    """So many programs that never rest, while the block runs."""
    with ExitStack() as stack:
        for _ in range(count):
            command = [sys.executable, '-c', 'while True: pass']
            stack.enter_context(running(command, os.environ, subprocess.DEVNULL))
        yield


def said(seen: Live, latencies: Sequence[float]) -> str:
    """What happened, in words."""
    p50, p99, worst = np.percentile(latencies, [50, 99, 100])
    worker = seen.parts['worker']
    return (
        f'{len(latencies)} windows: p50 {p50:.2f} s, p99 {p99:.2f} s, worst {worst:.2f} s; '
        f'{worker["limited_windows"]} windows searched less, {worker["merged_windows"]} merged, '
        f'left out: {dropped(seen)}; {sum(level >= WARN for _, level, _ in seen.worker)} of '
        f'{len(seen.worker)} diagnostics warn; ATE {seen.ate:.3f} m, '
        f'{seen.parts["map"]["components"]} component'
    )


def sound(seen: Live, late: Sequence[float]) -> bool:
    """Whether nothing was lost unseen, the map is one, and what was late was told."""
    told = any(level >= WARN and ' late' in text for _, level, text in seen.worker)
    whole = seen.lost == 0 and seen.ate < 1.0 and seen.parts['map']['components'] == 1
    return whole and max(late) <= BOUND and (told or max(late) <= TOLD)


@row('latency grew to 5 s within 12 s')
def busy_machine(folder: Path) -> Seen:
    """20 s at KAIST's rates while six programs take the processors away."""
    sent = [item for item in messages() if item.at < SECONDS]
    seen = live(folder, sent, {'queue.max_delay': DELAY}, beside=lambda: busy(BUSY))
    late = [item / 1e3 for item in seen.latencies[WARM_UP:]]
    return Seen(said(seen, late), sound(seen, late))


@row('latency grew without bound')
def rush(folder: Path) -> Seen:
    """Eight times as much as KAIST's sensors send, for seconds, and then as much as before."""

    def moment(at: float) -> float:
        return min(at, CALM) + min(max(at - CALM, 0.0), RUSH - CALM) / FASTER + max(at - RUSH, 0.0)

    sent: list[Sent] = [replace(item, at=moment(item.at)) for item in messages()]
    seen = live(folder, sent, {'queue.max_delay': DELAY})
    late = [item / 1e3 for item in seen.latencies[WARM_UP:]]
    at = (np.array(seen.published[WARM_UP:]) - seen.published[0]) / 1e9
    over = moment(RUSH)
    during = [item for item, when in zip(late, at, strict=True) if CALM < when < over]
    after = [item for item, when in zip(late, at, strict=True) if when > over + AGAIN]
    warned = [text for _, level, text in seen.worker if level >= WARN and ' late' in text]
    calm = seen.worker[-1][1] < WARN
    now = (
        f'{said(seen, late)}; in the rush of {over - CALM:.1f} s p50 {np.median(during):.2f} s; '
        f'{AGAIN:g} s after it worst {max(after):.2f} s, diagnostics {"OK" if calm else "not OK"}; '
        f'said: {warned[-1] if warned else "nothing"}'
    )
    good = bool(warned) and calm and float(np.percentile(after, 95)) <= USUAL
    return Seen(now, sound(seen, late) and good)
