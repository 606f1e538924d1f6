"""``incremental_mapper map``: a KAIST folder or a bag in, graph, trajectory and map out."""

import argparse
import sys
from pathlib import Path
from typing import Any

from tqdm import tqdm

from incremental_mapper.config import Tree, make_config, merge, read_yaml
from incremental_mapper.criteria.criterion import strategy_names
from incremental_mapper.datasets.open import open_source, read_truth
from incremental_mapper.evaluation import candidate_table
from incremental_mapper.evaluation.candidate_table import candidate_recorder
from incremental_mapper.evaluation.run import Run, Stop, map_source, settle_config
from incremental_mapper.evaluation.summary import draw_pictures, summary
from incremental_mapper.mapper.output import prepare_folder, write_result

EXIT_INTERRUPTED = 130


def add_parser(subparsers: Any) -> None:
    """Add the command to the ``argparse`` sub-parsers of the program."""
    parser = subparsers.add_parser(
        'map',
        help='map a KAIST folder or a bag',
        description='Map a drive with LiDAR, and IMU and GNSS where there are any. Writes '
        'trajectory.tum, map.ply, graph.json, graph.g2o, windows.csv, candidates.parquet, '
        'stats.json and pictures. Ctrl-C stops early and writes what has been mapped so far.',
    )
    parser.add_argument(
        'input',
        type=Path,
        metavar='INPUT',
        help='KAIST folder, rosbag2 (MCAP or sqlite3), ROS 1 bag, or folder of .bin scans',
    )
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
    make_config(tree, str(args.config or 'settings'))  # names the file, before the input is read
    source = open_source(args.input, tree)
    config = settle_config(source, tree, str(args.config or 'settings'))
    truth = source.truth() if args.truth is None else read_truth(args.truth)
    prepare_folder(args.out_dir, args.force)
    for note in source.info.notes:
        print(f'note: {note}', file=sys.stderr)
    stop = Stop()
    with (
        stop.listening(),
        tqdm(total=source.info.count, unit='msg', desc='map', disable=None) as bar,
        candidate_recorder(args.out_dir / candidate_table.FILE_NAME) as record,
    ):
        if record is None:
            bar.write(f'note: {candidate_table.MISSING}', file=sys.stderr)
        done = map_source(source, config, truth, bar.update, stop, record)
    _write(args.out_dir, done, truth)
    print(summary(done.stats))
    return EXIT_INTERRUPTED if done.interrupted else 0


def _write(out_dir: Path, done: Run, truth: Any) -> None:
    write_result(out_dir, done.result, done.points, done.stats)
    missing = draw_pictures(out_dir, done, truth)
    if missing:
        print(f'note: {missing}', file=sys.stderr)
