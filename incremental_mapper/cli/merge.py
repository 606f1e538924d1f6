"""``incremental_mapper merge``: finished runs as one map."""

import argparse
import sys
import time
from pathlib import Path
from typing import Any

from incremental_mapper.checks.finding import Severity
from incremental_mapper.cli import exit_status
from incremental_mapper.cli.findings_text import print_findings
from incremental_mapper.results.draw import draw_folder
from incremental_mapper.results.run_folder import prepare_folder, write_result
from incremental_mapper.results.sessions.merging import merge, read_fleet
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
    parser.add_argument(
        '--force', action='store_true', help='write into DIR although it is not empty'
    )
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Run the command; raises MapperError where runs cannot be related, or nothing be written."""
    started = time.perf_counter()
    fleet = read_fleet(args.runs)
    prepare_folder(args.out, args.force)
    done = merge(fleet)
    tree = done.statistics.to_tree()
    write_result(args.out, done.result, done.map, tree)
    remark = draw_folder(args.out)
    for note in (*done.statistics.input.notes, *([remark] if remark else [])):
        print(f'note: {note}', file=sys.stderr)
    print(summary(tree))
    print(f'written to {args.out} in {time.perf_counter() - started:.1f} s')
    sys.stdout.flush()  # the findings come last, where the eye rests
    print_findings(done.statistics.warnings)
    wrong = any(finding.severity is Severity.ERROR for finding in done.statistics.warnings)
    return exit_status.FAILURE if wrong else 0
