"""``incremental_mapper view``: a finished run, or a running node, in Rerun."""

import argparse
import os
import signal
import sys
from pathlib import Path
from typing import Any

from incremental_mapper.errors import ConfigError, InputError


def add_parser(subparsers: Any) -> None:
    """Add the command to argparse's ``subparsers``."""
    parser = subparsers.add_parser(
        'view',
        description='Show a run in Rerun (extra "view"): the map as it grew, poses, factors by '
        "kind, fixes with their ellipsoids, and each window's candidates with their scores.",
    )
    parser.add_argument(
        'out_dir', type=Path, nargs='?', metavar='RUN', help='output folder of "map"'
    )
    parser.add_argument(
        '--node',
        nargs='?',
        const='incremental_mapper',
        metavar='NAME',
        help='show a running node instead, until Ctrl-C (default name: incremental_mapper)',
    )
    parser.add_argument(
        '--save', type=Path, metavar='FILE', help='write a file (.rrd) and open no viewer'
    )
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Carry out the command; returns the exit status."""
    if (args.out_dir is None) == (args.node is None):
        raise ConfigError('view: name either the folder of a run, or a node by --node')
    from incremental_mapper.results.finished_run import FinishedRun
    from incremental_mapper.results.run_view import show_finished
    from incremental_mapper.visualization.rerun_scene import RerunScene, check_rrd, load_rerun

    load_rerun()
    if args.save is not None:
        check_rrd(args.save)
    if args.node is not None:
        return _node(args)
    finished = FinishedRun(args.out_dir)
    finished.check()
    scene = RerunScene(args.save)
    show_finished(finished, scene)
    scene.close()
    if args.save is not None:
        print(args.save)
    sys.stdout.flush()
    return 0


def _node(args: argparse.Namespace) -> int:
    try:
        from incremental_mapper.ros.node_view import show_node
    except ImportError as error:
        if (error.name or '').split('.')[0] == 'incremental_mapper':
            raise
        raise InputError(
            f'view --node needs rclpy, which cannot be imported ({error}); '
            'pip install "incremental_mapper[ros]", or source a ROS 2 installation'
        ) from error
    # A file is whole only once it is closed.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    windows = show_node(args.node, args.save, int(os.environ.get('ROS_DOMAIN_ID') or 0))
    print(f'{windows} windows shown' + (f', in {args.save}' if args.save else ''))
    return 0
