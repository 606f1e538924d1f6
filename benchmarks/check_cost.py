"""What the checks of a recording cost: the share of a run's CPU time that goes into them.

    python benchmarks/check_cost.py INPUT [--config FILE] [--pairs 2]

Each pair maps the input twice, in turn: as it is, with a timer round every look of ``Watch``, and
with a ``Watch`` that never looks. Printed are the CPU seconds of both processes and of their
children, the ratio, and the seconds inside the looks, which a busy machine disturbs less. The
exit status is 1 where the looks take 1 % or more.
"""

import argparse
import contextlib
import functools
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from incremental_mapper.cli.main import main as command
from incremental_mapper.mapping.watch import Watch

LOOKS = ('measurement', 'window', 'prepared', 'fixes', 'grown', 'end')
JUDGEMENTS = ('findings', 'final')
ALLOWED = 0.01


def timed(look: Callable[..., Any], spent: Counter[str]) -> Callable[..., Any]:
    """The look, with the CPU seconds of its thread added to ``spent``."""

    @functools.wraps(look)
    def run(*args: Any) -> Any:
        start = time.thread_time()
        try:
            return look(*args)
        finally:
            spent[look.__name__] += time.thread_time() - start
            spent['calls'] += 1

    return run


def one_run(words: list[str], looking: bool) -> None:
    """Map in this process; the last line printed is what was measured, as JSON."""
    spent: Counter[str] = Counter()
    for name in LOOKS:
        look = timed(getattr(Watch, name), spent) if looking else lambda *_: None
        setattr(Watch, name, look)
    for name in JUDGEMENTS:
        judge = timed(getattr(Watch, name), spent) if looking else lambda *_: ()
        setattr(Watch, name, judge)
    with contextlib.redirect_stdout(sys.stderr):
        command(words)
    calls = spent.pop('calls', 0)
    start = time.thread_time()
    for _ in range(1000):
        time.thread_time()
    timer = (time.thread_time() - start) / 1000.0
    print(json.dumps({'seconds': sum(spent.values()) - calls * timer, 'by_look': spent}))


def measure(words: list[str], looking: bool) -> tuple[float, dict[str, Any]]:
    """CPU seconds of a process and its children, and what it measured itself."""
    before = os.times()
    child = [sys.executable, __file__, '--child', 'on' if looking else 'off', *words]
    done = subprocess.run(child, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, check=True)
    after = os.times()
    cpu = after.children_user + after.children_system
    cpu -= before.children_user + before.children_system
    return cpu, json.loads(done.stdout.splitlines()[-1])


def main() -> int:
    """Print the cost; 1 where it is too much."""
    if sys.argv[1:2] == ['--child']:
        one_run(sys.argv[3:], sys.argv[2] == 'on')
        return 0
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('input', type=Path)
    parser.add_argument('--config', type=Path)
    parser.add_argument('--pairs', type=int, default=2)
    args = parser.parse_args()
    shares = []
    with tempfile.TemporaryDirectory() as folder:
        words = ['map', str(args.input), str(Path(folder) / 'run'), '--force']
        words += ['--config', str(args.config)] if args.config else []
        measure(words, looking=True)  # compiles what a new installation has not
        for _ in range(args.pairs):
            cpu, own = measure(words, looking=True)
            without, _ = measure(words, looking=False)
            shares.append(own['seconds'] / cpu)
            looks = ', '.join(f'{name} {value:.3f}' for name, value in own['by_look'].items())
            print(
                f'with {cpu:.1f} s CPU, without {without:.1f} s, ratio {cpu / without:.3f}; '
                f'inside the looks {own["seconds"]:.3f} s = {shares[-1]:.2%} ({looks})'
            )
    return 0 if max(shares) < ALLOWED else 1


if __name__ == '__main__':
    sys.exit(main())
