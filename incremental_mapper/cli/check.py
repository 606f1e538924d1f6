"""``incremental_mapper check``: a look at an input before it is mapped."""

import argparse
import sys
from pathlib import Path
from typing import Any

from incremental_mapper.checks.finding import Severity
from incremental_mapper.cli import exit_status
from incremental_mapper.cli.findings_text import print_findings
from incremental_mapper.cli.inputs import add_input
from incremental_mapper.config import Tree


def add_parser(subparsers: Any) -> None:
    """Add the command to the ``argparse`` sub-parsers of the program."""
    parser = subparsers.add_parser(
        'check',
        description='Look at a bag or folder for a few seconds without mapping it: sensors, rates, '
        'gaps, clocks, units, frames and extrinsics, fixes; what is suspicious, and how to mend '
        'it. Exit status 1 where it cannot be mapped.',
    )
    add_input(parser)
    parser.add_argument(
        '--config', type=Path, metavar='YAML', help='settings, or a ROS parameter file, to check'
    )
    parser.add_argument(
        '--write',
        type=Path,
        metavar='FILE',
        help='write settings for this input: topics, extrinsics, offsets, units and a starting '
        'point, for "map --config" and as the parameter file of the node',
    )
    parser.add_argument('--force', action='store_true', help='replace FILE where it exists')
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Run the command; raises MapperError where input, settings or FILE cannot be used."""
    # Imported here: the parser is made for the help of the program too.
    from incremental_mapper.results.settings_file import refuse_existing, write_settings
    from incremental_mapper.results.survey import look_at
    from incremental_mapper.results.survey_text import survey_text
    from incremental_mapper.settings import read_yaml

    if args.write is not None:
        refuse_existing(args.write, args.force)
    tree: Tree = {} if args.config is None else read_yaml(args.config)
    seen = look_at(args.input, tree, str(args.config or 'settings'))
    print(survey_text(seen))
    if args.write is not None:
        write_settings(args.write, seen, tree, str(args.config))
        print(f'written: {args.write}')
    sys.stdout.flush()  # the findings come last, where the eye rests
    if not seen.findings:
        print('nothing suspicious was found', file=sys.stderr)
    print_findings(seen.findings)
    failed = any(finding.severity is Severity.ERROR for finding in seen.findings)
    return exit_status.FAILURE if failed else 0
