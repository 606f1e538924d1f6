"""What it costs the mapping to be shown in Rerun, written to a file: pairs of runs, in turn.

    python benchmarks/view_cost.py DRIVE [--config YAML] [--pairs 2]

Processor seconds of the whole process, the threads of Rerun among them, from the opened input to
the map; and the seconds of it that the mapping's own thread spends on what is shown.
"""

import argparse
import gc
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from incremental_mapper.config import Config
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.mapping.result import WindowResult
from incremental_mapper.results.offline_run import map_into
from incremental_mapper.results.opened_drive import open_drive
from incremental_mapper.results.run_view import RunView, run_view
from incremental_mapper.settings import merge, read_yaml


class Watched:
    """A view whose windows are timed in its thread."""

    def __init__(self, view: RunView, seconds: list[float]) -> None:
        self._view, self._seconds = view, seconds
        self.trouble = ''
        self.finish = view.finish

    def window(self, mapper: Mapper, result: WindowResult) -> None:
        """Show a window."""
        began = time.thread_time()
        self._view.window(mapper, result)
        self._seconds.append(time.thread_time() - began)


def once(drive: Path, config: Path | None, shown: bool) -> tuple[float, float]:
    """Processor seconds of a run until its files are written, and of its view."""
    tree = {} if config is None else read_yaml(config)
    # In one process all of it is counted.
    tree = merge(tree, {'odometry': {'processes': False}})
    opened = open_drive(drive, tree, 'settings')
    spent: list[float] = []
    ended: list[float] = []

    def stage(what: str) -> None:
        if what == 'write':
            ended.append(time.process_time())

    with tempfile.TemporaryDirectory() as folder:

        @contextmanager
        def watch(settings: Config) -> Iterator[Watched]:
            with ExitStack() as stack:
                view = stack.enter_context(run_view(Path(folder) / 'run.rrd', settings))
                yield Watched(view, spent)

        gc.collect()
        began = time.process_time()
        map_into(Path(folder), opened, stage=stage, watch=[watch] if shown else [])
    return ended[0] - began, sum(spent)


def main() -> None:
    """Run the pairs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('drive', type=Path, metavar='DRIVE')
    parser.add_argument('--config', type=Path, metavar='YAML')
    parser.add_argument('--pairs', type=int, default=2)
    args = parser.parse_args()
    once(args.drive, args.config, True)  # what is compiled or loaded once
    for _ in range(args.pairs):
        bare = once(args.drive, args.config, False)[0]
        shown, own = once(args.drive, args.config, True)
        print(
            f'without {bare:.2f} s, with {shown:.2f} s ({100 * (shown / bare - 1):+.1f} %), '
            f'{own:.2f} s of it in the mapping thread ({100 * own / bare:.1f} %)',
            flush=True,
        )


if __name__ == '__main__':
    main()
