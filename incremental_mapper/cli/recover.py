"""``incremental_mapper recover``: the map of a journal, after a crash or a power cut."""

import argparse
import sys
from pathlib import Path
from typing import Any

from incremental_mapper.checks.finding import Severity
from incremental_mapper.cli import exit_status
from incremental_mapper.cli.findings_text import print_findings
from incremental_mapper.errors import InputError, MapperError
from incremental_mapper.results.journal.recovered_folder import recover_journal
from incremental_mapper.results.journal.recovery import find_journals
from incremental_mapper.results.summary import summary


def add_parser(subparsers: Any) -> None:
    """Add the command to the ``argparse`` sub-parsers of the program."""
    parser = subparsers.add_parser(
        'recover',
        description='Make of the journals of maps that were cut off (by a crash, SIGKILL, a power '
        'cut) the files that "map" and "save_map" write, with at most the last window missing.',
    )
    parser.add_argument(
        'journal',
        type=Path,
        metavar='FOLDER',
        help='a folder with journals (journal.folder of the settings), or one journal',
    )
    parser.add_argument(
        '--out',
        type=Path,
        metavar='DIR',
        help='folder to make, with a number added where it exists (default: named as the journal, '
        'beside it)',
    )
    parser.add_argument(
        '--remove', action='store_true', help='remove a journal once its map is complete'
    )
    parser.add_argument(
        '--no-pictures', action='store_true', help='draw none, which takes some seconds'
    )
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Run the command; raises MapperError where there is no journal, or a map cannot be written."""
    status = 0
    journals = find_journals(args.journal)
    if not journals:
        whole = f'{args.journal}: is the folder of a finished run, and whole'
        # Who names a folder goes on with it, and must not be told that it is there.
        if args.out is not None:
            raise InputError(f'{whole}; {args.out} was not made')
        print(f'{whole}; nothing is missing')
    for path in journals:
        try:
            status = max(status, _recover(path, args))
        except MapperError as error:
            if len(journals) == 1:
                raise
            print(f'incremental_mapper: {error}', file=sys.stderr)
            status = exit_status.FAILURE
    return status


def _recover(path: Path, args: argparse.Namespace) -> int:
    done = recover_journal(path, args.out, args.remove, not args.no_pictures)
    for note in done.notes:
        print(f'note: {note}', file=sys.stderr)
    print(summary(done.statistics.to_tree()))
    print(done.folder)
    sys.stdout.flush()  # the findings come last, where the eye rests
    print_findings(done.statistics.warnings)
    wrong = any(finding.severity is Severity.ERROR for finding in done.statistics.warnings)
    return exit_status.FAILURE if wrong else 0
