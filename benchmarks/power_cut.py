"""Kills ``map`` and the node with SIGKILL at random moments, and recovers what they had.

    python benchmarks/power_cut.py map KAIST_FOLDER WORK [--times 20] [--seed 1]
    python benchmarks/power_cut.py node BAG WORK [--times 20] [--seed 1] [--config YAML]
    python benchmarks/power_cut.py cost KAIST_FOLDER WORK

Every recovery must end with status 0 and give a connected map whose files are whole. Of ``map`` its
rows of ``windows.csv`` must be those of an undisturbed run, seconds left out, up to where it was
killed; of the node it must hold all windows but one whose odometry was received before. ``cost``
maps a drive once, and prints what its journal takes of the processor and of the disk.
"""

import argparse
import csv
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from shutil import rmtree

import numpy as np

from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.results.graph_json import graph_tree
from incremental_mapper.results.journal.journal_writer import Journal
from incremental_mapper.results.journal.recovery import opened, recover
from incremental_mapper.results.manifest import require_whole
from incremental_mapper.results.opened_drive import open_drive
from incremental_mapper.results.run_statistics import InputFacts

PROGRAM = [sys.executable, '-m', 'incremental_mapper.cli.main']
LOOK = 0.002
PATIENCE = 120.0


@dataclass(frozen=True, slots=True)
class Recovery:
    """What came of one kill: when it was, windows of the map, what is wrong with it."""

    moment: str
    windows: int
    wrong: str


def rows_of(folder: Path) -> list[list[str]]:
    """The rows of windows.csv without seconds, which differ from run to run."""
    with (folder / 'windows.csv').open(encoding='utf-8', newline='') as file:
        return [
            [value for name, value in row.items() if not name.endswith('_s') or 'shift' in name]
            for row in csv.DictReader(file)
        ]


def recovered(journals: Path, out: Path) -> tuple[FinishedRun, str]:
    """Recover the only journal of a folder; the run, and what is wrong with it."""
    rmtree(out, ignore_errors=True)
    words = ['recover', str(journals), '--out', str(out), '--remove', '--no-pictures']
    done = subprocess.run([*PROGRAM, *words], capture_output=True, text=True, check=False)
    run = FinishedRun(out)
    if done.returncode:
        return run, f'status {done.returncode}: {done.stderr.strip()}'
    require_whole(out)
    wrong = []
    if run.stats['components'] != 1:
        wrong.append(f'{run.stats["components"]} components')
    if len(run.points) == 0 or len(run.trajectory) < len(run.graph['clusters']):
        wrong.append('points or poses are missing')
    if list(journals.glob('*.journal')):
        wrong.append('the journal is still there')
    return run, '; '.join(wrong)


def size_of(journals: Path) -> int:
    """Bytes of all journals of a folder."""
    return sum(path.stat().st_size for path in journals.glob('*.journal'))


@contextmanager
def mapping(source: Path, out: Path, settings: Path) -> Iterator['subprocess.Popen[bytes]']:
    """The command ``map``, killed behind the block where it has not ended."""
    words = ['map', str(source), str(out), '--force', '--config', str(settings)]
    with subprocess.Popen(
        [*PROGRAM, *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def kill_map(source: Path, work: Path, times: int, rng: np.random.Generator) -> Iterator[Recovery]:
    """Kill ``map`` when its journal has a random size."""
    journals, whole = work / 'journals', work / 'whole'
    settings = work / 'settings.yaml'
    settings.write_text(f'journal: {{folder: {journals}}}\n')
    largest = 0
    with mapping(source, whole, settings) as process:
        while process.poll() is None:
            largest = max(largest, size_of(journals) if journals.is_dir() else 0)
            time.sleep(LOOK)
    expected = rows_of(whole)
    for _ in range(times):
        rmtree(journals)
        target = int(rng.uniform(0.03, 0.97) * largest)
        with mapping(source, work / 'killed', settings) as process:
            while process.poll() is None and not (journals.is_dir() and size_of(journals) > target):
                time.sleep(LOOK)
        run, wrong = recovered(journals, work / 'recovered')
        rows = [] if wrong else rows_of(run.folder)
        if not wrong and rows != expected[: len(rows)]:
            wrong = 'its windows are not those of the undisturbed run'
        yield Recovery(f'at {target / 1e6:.2f} of {largest / 1e6:.2f} MB', len(rows), wrong)


def kill_node(
    bag: Path, work: Path, times: int, rng: np.random.Generator, config: Path | None
) -> Iterator[Recovery]:
    """Kill the node when a random number of its poses was received."""
    # Only the node needs ROS.
    from node_runs import Drive, node_run

    from incremental_mapper.datasets.bag_settings import SETTINGS_FILE
    from incremental_mapper.datasets.open import open_source
    from incremental_mapper.ros.programs import player_command, running

    info = open_source(bag, {}).info
    files = [path for path in (bag / SETTINGS_FILE, config) if path is not None and path.exists()]
    drive = Drive(bag, tuple(files), dict(info.counts), info.duration)
    for number in range(times):
        journals = work / f'journals_{number}'
        rmtree(journals, ignore_errors=True)
        wanted = int(rng.integers(2, max(int(info.duration * 10) - 8, 3)))
        parameters = {'journal.folder': journals}
        with node_run(drive, work / 'node.log', parameters) as run:
            command = player_command(bag, '--rate', 1, '--wait', PATIENCE)
            silent = subprocess.DEVNULL
            with running(command, run.environment, silent, silent) as player:
                while len(run.client.odometry) < wanted and player.poll() is None:
                    time.sleep(LOOK)
                told = len(run.client.odometry)
                subprocess.run(['kill', '-9', str(run.pid)], check=True)
        found, wrong = recovered(journals, work / 'recovered')
        windows = 0
        if not wrong:
            windows = sum(row['core'] != '0' for row in found.windows)
            if windows < told - 1:
                wrong = f'{told - windows} windows are missing'
        yield Recovery(f'after {told} poses', windows, wrong)


def cost(source: Path, work: Path) -> str:
    """What a journal takes, and whether the recovered graph is the one that was made."""
    drive = open_drive(source, {}, 'settings')
    journal = Journal(work / 'journals', drive.config, InputFacts(str(source), '', {}))
    mapper = Mapper(drive.config, store=journal)
    spent, windows = 0.0, 0
    for item in chain(drive.source.measurements(), [None]):
        for window in mapper.flush() if item is None else mapper.advance(item):
            begin = time.thread_time()
            journal.window(mapper, window, Counter())
            spent, windows = spent + time.thread_time() - begin, windows + 1
    result = mapper.result()
    mapper.close()
    journal.close()
    begin = time.thread_time()
    with opened(journal.path, alone=False) as file:
        found = recover(journal.path, file).result
    seconds = time.thread_time() - begin
    graphs = [graph_tree(made.clusters, made.factors, made.values) for made in (result, found)]
    journal.remove()
    return (
        f'{windows} windows: {1e3 * spent / windows:.2f} ms of the processor and '
        f'{journal.nbytes / windows / 1e6:.3f} MB each; read back and solved in {seconds:.2f} s, '
        f'{"the same graph" if graphs[0] == graphs[1] else "ANOTHER GRAPH"}'
    )


def main() -> int:
    """Kill, recover, and print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('what', choices=['map', 'node', 'cost'])
    parser.add_argument('input', type=Path)
    parser.add_argument('work', type=Path)
    parser.add_argument('--times', type=int, default=20)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--config', type=Path)
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    work, rng = args.work.resolve(), np.random.default_rng(args.seed)
    if args.what == 'cost':
        print(cost(args.input, work))
        return 0
    if args.what == 'map':
        results = kill_map(args.input, work, args.times, rng)
    else:
        results = kill_node(args.input, work, args.times, rng, args.config)
    failed = 0
    for number, item in enumerate(results, 1):
        failed += bool(item.wrong)
        print(
            f'{number:3} killed {item.moment}: {item.windows} windows; {item.wrong or "sound"}',
            flush=True,
        )
    print(f'{args.times - failed} of {args.times} recoveries are sound')
    return 1 if failed else 0


if __name__ == '__main__':
    sys.exit(main())
