"""The ``incremental_mapper`` command."""

import argparse
import os
import signal
import sys
from collections.abc import Sequence
from importlib import import_module

from incremental_mapper import __version__
from incremental_mapper.batch import work_in_batches
from incremental_mapper.blas import start_no_threads
from incremental_mapper.cli import exit_status
from incremental_mapper.errors import ConfigError, MapperError
from incremental_mapper.garbage import search_little

COMMANDS = {
    'simulate': ('simulate', 'write a simulated drive with ground truth, as a KAIST Urban folder'),
    'convert': ('convert', 'convert a KAIST folder to a ROS 2 bag'),
    'check': ('check', 'look at an input for a few seconds: what is in it, what is suspicious'),
    'map': ('map_drive', 'map a KAIST folder or a bag'),
    'merge': ('merge', 'join finished runs into one map'),
    'recover': ('recover', 'make maps of the journals of runs that were cut off'),
    'evaluate': ('evaluate', 'map drives with every strategy and compare'),
    'play': ('play', 'play a bag into ROS topics'),
    'plot': ('plot', 'draw one picture of a finished run'),
    'export': ('export', 'write a finished run in the formats of other programs'),
    'view': ('view', 'show a finished run, or a running node, in Rerun'),
    'inspect': ('inspect_window', 'show what a window of a finished run chose from, and why'),
}
"""Modules of the commands, and what the program's help says of them."""


def make_parser(command: str | None = None) -> argparse.ArgumentParser:
    """The parser of the program, with the options of ``command``, its first word.

    Of the other commands it knows what they are for: importing what they need takes seconds.
    """
    parser = argparse.ArgumentParser(
        prog='incremental_mapper',
        description='Maps of LiDAR, GNSS and IMU that arrive out of step: window by window, the '
        'factor graph that makes the best local map.',
        epilog='Exit status: 0 done, 1 the input or a setting cannot be used, 2 wrong usage, '
        '130 interrupted.',
    )
    parser.add_argument('--version', action='version', version=f'%(prog)s {__version__}')
    subparsers = parser.add_subparsers(required=True, metavar='COMMAND')
    for name, (module, what) in COMMANDS.items():
        if name == command:
            import_module(f'incremental_mapper.cli.{module}').add_parser(subparsers)
            subparsers.choices[name].set_defaults(usage_of=subparsers.choices[name])
        else:
            subparsers.add_parser(name, help=what)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: The words after the program's name; None takes those of this process, which
            ends afterwards.

    Returns:
        The exit status, see ``exit_status``.
    """
    words = sys.argv[1:] if arguments is None else list(arguments)
    if arguments is None:
        search_little()
        start_no_threads()
        if words[:1] != ['play']:  # which keeps the time of a drive
            work_in_batches()
    try:
        try:
            args, unknown = make_parser(words[0] if words else None).parse_known_args(words)
            if unknown:  # the usage of the command says more than that of the program
                args.usage_of.error(f'unrecognized arguments: {" ".join(unknown)}')
            args.words = words  # evaluate writes down what it was called with
            _refuse_bytes(words)
            status: int = args.func(args)
        finally:
            sys.stdout.flush()  # here, and not by the interpreter's end, which would complain
    except MapperError as error:
        print(f'incremental_mapper: {error}', file=sys.stderr)
        return exit_status.FAILURE
    except BrokenPipeError:
        _close_output()
        return exit_status.PIPE_CLOSED
    except KeyboardInterrupt:
        _end(arguments)
        print('incremental_mapper: interrupted', file=sys.stderr)
        return exit_status.INTERRUPTED
    finally:
        _end(arguments)
    return status


def _refuse_bytes(words: Sequence[str]) -> None:
    """Raise where a name is no text: files of the run that name it could not be written."""
    for word in words:
        try:
            word.encode()
        except UnicodeEncodeError:
            shown = word.encode(errors='backslashreplace').decode()
            raise ConfigError(
                f'{shown}: is no text in {sys.getfilesystemencoding()}, as the files of a run are; '
                'rename it, or set LC_ALL to a locale with UTF-8, such as C.UTF-8'
            ) from None


def _close_output() -> None:
    """Whoever read the output has gone, as ``head`` does: nothing more is written to it."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except BrokenPipeError:
            os.dup2(nowhere, stream.fileno())
    os.close(nowhere)


def _end(arguments: Sequence[str] | None) -> None:
    """Where this is the process's own command, nothing is left for another Ctrl-C to end."""
    if arguments is None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)


if __name__ == '__main__':
    sys.exit(main())
