"""``incremental_mapper export``: a finished run in the formats of other programs."""

import argparse
import sys
from pathlib import Path
from typing import Any

from incremental_mapper.errors import ConfigError, OutputError
from incremental_mapper.exports.formats import Content, export, find_format, formats
from incremental_mapper.results.file_names import FILES
from incremental_mapper.results.finished_run import FinishedRun


def add_parser(subparsers: Any) -> None:
    """Add the command to argparse's ``subparsers``."""
    parser = subparsers.add_parser(
        'export',
        formatter_class=argparse.RawDescriptionHelpFormatter,
        description='Write what "map" made in the formats of other programs, named by the suffix.\n'
        + _known(),
        epilog='Formats of other packages are found by their entry points.',
    )
    parser.add_argument('out_dir', type=Path, metavar='RUN', help='output folder of "map"')
    parser.add_argument(
        '--to',
        type=Path,
        metavar='FILE',
        action='append',
        required=True,
        help='file to write; may be given several times',
    )
    parser.add_argument(
        '--format', metavar='NAME', help='format of the files, where their suffix does not tell it'
    )
    parser.add_argument(
        '--crs',
        metavar='CODE',
        help='coordinate system of laz and las, such as EPSG:32632, or EPSG:32632+5773 for heights '
        'above the sea (default: the UTM zone of the map, heights above the ellipsoid)',
    )
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Carry out the command; returns the exit status."""
    finished = FinishedRun(args.out_dir)
    finished.check()
    wanted = [(path, find_format(path, args.format)) for path in args.to]
    for path, form in wanted:
        if path.name in FILES and path.parent.resolve() == args.out_dir.resolve():
            raise OutputError(f'{path}: is a file of the run itself; name another')
        if args.crs is not None and not form.systems:
            raise ConfigError(f'--crs: {form.name} holds no coordinate system; leave it out')
    for path, form in wanted:
        remarks = export(finished, form, path, args.crs)
        print(path)
        for remark in remarks:
            print(f'note: {path.name}: {remark}', file=sys.stderr)
    return 0


def _known() -> str:
    """What of a run can be written how, and what is missing for it."""
    lines = []
    found = formats()
    for content in Content:
        names = [
            f'{name} (needs the extra: {form.install})' if form.missing() else name
            for name, form in found.items()
            if form.content is content
        ]
        lines.append(f'  {content + ":":<12} {", ".join(names)}')
    return '\n'.join(lines)
