"""``incremental_mapper map``: a KAIST folder or a bag in, graph, trajectory and map out."""

import argparse
import sys
from pathlib import Path
from typing import Any

from tqdm import tqdm

from incremental_mapper.checks.finding import Severity
from incremental_mapper.cli import exit_status
from incremental_mapper.cli.findings_text import print_findings
from incremental_mapper.cli.inputs import add_input
from incremental_mapper.config import Tree
from incremental_mapper.results.offline_run import Stop, map_into, open_drive
from incremental_mapper.results.run_folder import prepare_folder
from incremental_mapper.results.summary import summary
from incremental_mapper.selection.strategies import strategy_names
from incremental_mapper.settings import merge, read_yaml


def add_parser(subparsers: Any) -> None:
    """Add the command to the ``argparse`` sub-parsers of the program."""
    parser = subparsers.add_parser(
        'map',
        description='Map a drive with LiDAR, and IMU and GNSS where there are any. Writes '
        'trajectory.tum, map.ply, graph.json, graph.g2o, windows.csv, candidates.parquet, '
        'stats.json and pictures. Ctrl-C stops early and writes what has been mapped so far.',
    )
    add_input(parser)
    parser.add_argument('out_dir', type=Path, metavar='OUT_DIR', help='folder to write into')
    parser.add_argument(
        '--strategy',
        choices=strategy_names(),
        help='which graph a window keeps (default: what the settings say, else mom)',
    )
    parser.add_argument(
        '--config', type=Path, metavar='YAML', help='settings, or a ROS parameter file'
    )
    parser.add_argument(
        '--truth',
        type=Path,
        metavar='FILE',
        help="true poses, TUM or KAIST's global_pose.csv (default: what the input holds)",
    )
    parser.add_argument(
        '--verify',
        action='store_true',
        help='score every candidate by direct search too and report the agreement (slow)',
    )
    parser.add_argument(
        '--force', action='store_true', help='write into OUT_DIR although it is not empty'
    )
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Run the command; raises MapperError where input, settings or output cannot be used."""
    tree: Tree = {} if args.config is None else read_yaml(args.config)
    chosen: Tree = {}
    if args.strategy is not None:
        chosen['strategy'] = args.strategy
    if args.verify:
        chosen['verify'] = True
    tree = merge(tree, {'selection': chosen} if chosen else {})
    drive = open_drive(args.input, tree, str(args.config or 'settings'), args.truth)
    prepare_folder(args.out_dir, args.force)
    info = drive.source.info
    for note in drive.all_notes():
        print(f'note: {note}', file=sys.stderr)
    stop = Stop()
    with stop.listening(), tqdm(total=info.count, unit='msg', desc='map', disable=None) as bar:
        done, remarks = map_into(args.out_dir, drive, bar.update, stop)
    found = [note for note in done.statistics.input.notes if note not in drive.all_notes()]
    for remark in (*found, *remarks):
        print(f'note: {remark}', file=sys.stderr)
    print(summary(done.statistics.to_tree()))
    warnings = done.statistics.warnings
    sys.stdout.flush()  # the findings come last, where the eye rests
    print_findings(warnings)
    if done.statistics.interrupted:
        return exit_status.INTERRUPTED
    failed = any(finding.severity is Severity.ERROR for finding in warnings)
    return exit_status.FAILURE if failed else 0
