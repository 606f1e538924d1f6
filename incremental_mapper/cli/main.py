"""The ``incremental_mapper`` command."""

import argparse
import sys
from collections.abc import Sequence

from incremental_mapper import __version__
from incremental_mapper.cli import (
    convert,
    evaluate,
    inspect_window,
    map_drive,
    play,
    plot,
    simulate,
)
from incremental_mapper.errors import MapperError

EXIT_FAILURE = 1
EXIT_INTERRUPTED = 130


def make_parser() -> argparse.ArgumentParser:
    """The parser of all sub-commands."""
    parser = argparse.ArgumentParser(
        prog='incremental_mapper',
        description='Maps of LiDAR, GNSS and IMU that arrive out of step: window by window, the '
        'factor graph that makes the best local map.',
        epilog='Exit status: 0 done, 1 the input or a setting cannot be used, 2 wrong usage, '
        '130 interrupted.',
    )
    parser.add_argument('--version', action='version', version=f'%(prog)s {__version__}')
    subparsers = parser.add_subparsers(required=True, metavar='COMMAND')
    for command in (simulate, convert, map_drive, evaluate, play, plot, inspect_window):
        command.add_parser(subparsers)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    args = make_parser().parse_args(arguments)
    try:
        status: int = args.func(args)
    except MapperError as error:
        print(f'incremental_mapper: {error}', file=sys.stderr)
        return EXIT_FAILURE
    except KeyboardInterrupt:
        print('incremental_mapper: interrupted', file=sys.stderr)
        return EXIT_INTERRUPTED
    return status


if __name__ == '__main__':
    sys.exit(main())
