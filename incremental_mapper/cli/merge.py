"""``incremental_mapper merge``: finished runs as one map."""

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tqdm import tqdm

from incremental_mapper.checks.finding import Severity
from incremental_mapper.cli import exit_status
from incremental_mapper.cli.findings_text import print_findings
from incremental_mapper.cli.workers_option import add_workers, check_workers, workers_of
from incremental_mapper.errors import InputError, MapperError, OutputError
from incremental_mapper.results.draw import draw_folder
from incremental_mapper.results.run_folder import prepared_folder, write_result
from incremental_mapper.results.sessions.merging import (
    Pair,
    merge,
    pairs_of,
    read_fleet,
    search_pair,
)
from incremental_mapper.results.sessions.ties import Ties
from incremental_mapper.results.summary import summary


def add_parser(subparsers: Any) -> None:
    """Add the command to the ``argparse`` sub-parsers of the program."""
    parser = subparsers.add_parser(
        'merge',
        description='Join finished runs into one map, in the frame of the first one: one graph '
        'that is solved once, one cloud, the files of "map". Fixes tell how runs lie to each '
        'other; runs that cannot be related are refused.',
    )
    parser.add_argument(
        'runs',
        type=Path,
        nargs='+',
        metavar='RUN',
        help='folder that map, save_map, recover or merge wrote',
    )
    parser.add_argument(
        '--out', type=Path, required=True, metavar='DIR', help='folder to write into'
    )
    add_workers(parser, 'searches of pairs of runs')
    parser.add_argument(
        '--force', action='store_true', help='write into DIR although it is not empty'
    )
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Run the command; raises MapperError where runs cannot be related, or nothing be written."""
    started = time.perf_counter()
    check_workers(args)
    if args.out.resolve() in [folder.resolve() for folder in args.runs]:
        raise OutputError(f'{args.out}: is one of the runs; name another folder')
    fleet = read_fleet(args.runs)
    read = time.perf_counter()
    with prepared_folder(args.out, args.force):
        found = _search(pairs_of(fleet), args)
        searched = time.perf_counter()
        done = merge(fleet, found)
        tree = done.statistics.to_tree()
        write_result(args.out, done.result, done.map, tree)
        remark = draw_folder(args.out)
    for note in (*done.statistics.input.notes, *([remark] if remark else [])):
        print(f'note: {note}', file=sys.stderr)
    print(summary(tree))
    print(
        f'written to {args.out} in {time.perf_counter() - started:.1f} s: read in '
        f'{read - started:.1f} s, {len(found)} pairs of runs searched in {searched - read:.1f} s, '
        f'solved and mapped in {done.statistics.wall_s:.1f} s'
    )
    sys.stdout.flush()  # the findings come last, where the eye rests
    print_findings(done.statistics.warnings)
    wrong = any(finding.severity is Severity.ERROR for finding in done.statistics.warnings)
    return exit_status.FAILURE if wrong else 0


def _search(pairs: Sequence[Pair], args: argparse.Namespace) -> dict[Pair, Ties]:
    """What pairs of runs show, by whoever the options name."""
    found: dict[Pair, Ties] = {}
    if not pairs:
        return found
    with (
        workers_of(args) as workers,
        tqdm(total=len(pairs), unit='pair', desc='merge', disable=None) as bar,
    ):
        for pair, future in workers.run(search_pair, pairs):
            try:
                found[pair] = future.result()
            except MapperError:
                raise
            # A worker may die, and the libraries of a cluster raise what they like.
            except Exception as error:
                one, other = pair.folders
                reason = ' '.join(str(error).split()) or type(error).__name__
                raise InputError(f'{one} and {other} cannot be compared: {reason}') from error
            bar.update()
    return found
