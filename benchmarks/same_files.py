"""Whether two states of the code make the same files, byte by byte.

    python benchmarks/same_files.py make PRINTS.json INPUT[=CONFIG]... [--jobs N] [--work DIR]
    python benchmarks/same_files.py compare BEFORE.json AFTER.json

``make`` maps every input with every strategy and writes the SHA-256 of ``trajectory.tum``,
``graph.json``, ``map.ply`` and of ``windows.csv`` without its seconds. It calls the command line
of whichever incremental_mapper Python finds: PYTHONPATH=OTHER_CHECKOUT fingerprints another state.
``compare`` prints what differs and exits with 1 where anything does.
"""

import argparse
import csv
import hashlib
import json
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from tqdm import tqdm

STRATEGIES = ('mom', 'base', 'min_time_shift', 'min_solver_error')
WHOLE = ('trajectory.tum', 'graph.json', 'map.ply')
SECONDS = {'front_end_s', 'candidates_s', 'solve_s', 'score_s', 'append_s', 'window_s'}
"""Columns of windows.csv that tell how long something took."""

Prints = dict[str, dict[str, str]]


def fingerprint(folder: Path) -> dict[str, str]:
    """SHA-256 by file of one output folder of ``map``."""
    prints = {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in WHOLE}
    with (folder / 'windows.csv').open(encoding='utf-8', newline='') as file:
        rows = [
            [value for name, value in row.items() if name not in SECONDS]
            for row in csv.DictReader(file)
        ]
    text = '\n'.join(','.join(row) for row in rows)
    prints['windows.csv'] = hashlib.sha256(text.encode()).hexdigest()
    return prints


def run(source: str, strategy: str, work: Path) -> tuple[str, dict[str, str]]:
    """Map one input with one strategy and fingerprint what it wrote."""
    path, _, config = source.partition('=')
    name = f'{Path(path).name}/{strategy}'
    out = work / name
    command = [sys.executable, '-m', 'incremental_mapper.cli.main', 'map', path, str(out)]
    command += ['--force', '--strategy', strategy, *(['--config', config] if config else [])]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        return name, {'failed': done.stderr.strip().splitlines()[-1]}
    return name, fingerprint(out)


def make(sources: list[str], jobs: int, work: Path) -> Prints:
    """Fingerprints of every input under every strategy."""
    wanted = [(source, strategy) for source in sources for strategy in STRATEGIES]
    with ThreadPoolExecutor(jobs) as pool:
        done = pool.map(lambda item: run(*item, work), wanted)
        return dict(tqdm(done, total=len(wanted), unit='run', disable=None))


def compare(before: Prints, after: Prints) -> list[str]:
    """One line for everything that differs."""
    lines = [f'{name}: only in one of the two' for name in sorted(before.keys() ^ after.keys())]
    for name in sorted(before.keys() & after.keys()):
        old, new = before[name], after[name]
        differs = [
            file for file in sorted(old.keys() | new.keys()) if old.get(file) != new.get(file)
        ]
        lines += [f'{name}: {file} differs' for file in differs]
    return lines


def main() -> int:
    """Make or compare fingerprints."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest='command', required=True)
    maker = commands.add_parser('make')
    maker.add_argument('prints', type=Path)
    maker.add_argument('sources', nargs='+', metavar='INPUT[=CONFIG]')
    maker.add_argument('--jobs', type=int, default=1)
    maker.add_argument('--work', type=Path, help='keep the runs here')
    comparer = commands.add_parser('compare')
    comparer.add_argument('before', type=Path)
    comparer.add_argument('after', type=Path)
    args = parser.parse_args()
    if args.command == 'make':
        with tempfile.TemporaryDirectory() as scratch:
            prints = make(args.sources, args.jobs, args.work or Path(scratch))
        args.prints.write_text(json.dumps(prints, indent=1, sort_keys=True) + '\n')
        failed = [name for name, files in prints.items() if 'failed' in files]
        print(f'{len(prints)} runs, {len(failed)} failed')
        return int(bool(failed))
    before, after = (json.loads(path.read_text()) for path in (args.before, args.after))
    lines = compare(before, after)
    files = sum(len(item) for item in before.values())
    print('\n'.join(lines) or f'{len(before)} runs, {files} files: all the same')
    return int(bool(lines))


if __name__ == '__main__':
    sys.exit(main())
