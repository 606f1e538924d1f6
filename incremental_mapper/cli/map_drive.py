"""``incremental_mapper map``: a KAIST folder or a bag in, graph, trajectory and map out.

What a run needs is imported when there is one: the help should not wait for it.
"""

import argparse
import sys
import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from incremental_mapper.cli import exit_status
from incremental_mapper.cli.inputs import add_input
from incremental_mapper.errors import OutputError
from incremental_mapper.frontend.scan_servers import ahead
from incremental_mapper.garbage import set_aside, unsearched

if TYPE_CHECKING:
    from incremental_mapper.config import Tree
    from incremental_mapper.results.watching import Watch

STRATEGIES = 'mom, base, min_time_shift, min_solver_error, fewest'
"""The built-in ones, for the help."""
TO_OPEN = ('report.html', 'map.png', 'map.ply')
"""What to look at first; without the extra ``report`` there is the map alone."""


def add_parser(subparsers: Any) -> None:
    """Add the command to the ``argparse`` sub-parsers of the program."""
    parser = subparsers.add_parser(
        'map',
        description='Map a drive with LiDAR, and IMU and GNSS where there are any. Writes '
        'trajectory.tum, map.ply, graph.json, graph.g2o, windows.csv, candidates.parquet, '
        'stats.json, pictures and report.html. Ctrl-C stops early and writes what has been mapped '
        'so far.',
    )
    add_input(parser)
    parser.add_argument(
        'out_dir',
        type=Path,
        nargs='?',
        metavar='OUT_DIR',
        help='folder to write into; with --continue it may be left out: FOLDER with a number',
    )
    parser.add_argument(
        '--continue',
        type=Path,
        dest='earlier',
        metavar='FOLDER',
        help='go on from a finished run or a saved map, in its frame and around its datum; what is '
        'written is the map of all sessions',
    )
    parser.add_argument(
        '--strategy',
        type=_strategy,
        metavar='NAME',
        help=f'which graph a window keeps: {STRATEGIES}, or one of another package (default: what '
        'the settings say, else mom)',
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
        '--bag',
        action='store_true',
        help="write run_bag too: poses, path, map, graph and statistics on the node's topics, for "
        'RViz and Foxglove',
    )
    parser.add_argument('--view', action='store_true', help='watch it in Rerun (extra "view")')
    parser.add_argument(
        '--rrd',
        type=Path,
        metavar='FILE',
        help='write what --view shows to a file (.rrd)',
    )
    parser.add_argument(
        '--force', action='store_true', help='write into OUT_DIR although it is not empty'
    )
    parser.add_argument('--verbose', action='store_true', help='print all numbers of the run')
    parser.set_defaults(func=run, wrong_usage=parser.error)


def run(args: argparse.Namespace) -> int:
    """Run the command; raises MapperError where input, settings or output cannot be used."""
    started = time.perf_counter()
    if args.out_dir is None and args.earlier is None and args.config is None:
        args.wrong_usage('the following arguments are required: OUT_DIR')
    with ahead():
        with unsearched():
            from incremental_mapper.settings import make_config

        tree, where = _settings(args), str(args.config or 'settings')
        make_config(tree, where)
        return _map(args, tree, where, started)


def _map(args: argparse.Namespace, tree: 'Tree', where: str, started: float) -> int:
    """Map with the settings ``tree`` from ``where``; told is how long it took since ``started``."""
    with unsearched():
        from incremental_mapper.checks.finding import Severity
        from incremental_mapper.cli.findings_text import print_findings
        from incremental_mapper.cli.progress import Progress
        from incremental_mapper.evaluation.report.report_process import ReportProcess
        from incremental_mapper.results.candidate_table import FILE_NAME
        from incremental_mapper.results.offline_run import Stop, map_into
        from incremental_mapper.results.opened_drive import open_drive
        from incremental_mapper.results.run_folder import is_whole, prepared_folder
        from incremental_mapper.results.summary import brief, summary
        from incremental_mapper.visualization.extras import importable, missing_files

    if args.view or args.rrd is not None:
        from incremental_mapper.visualization.rerun_scene import check_rrd, load_rerun

        load_rerun()  # what is missing is told before the folder is made
        if args.rrd is not None:
            check_rrd(args.rrd)
    drive = open_drive(args.input, tree, where, args.truth)
    folder = _out_dir(args, drive.config.session.folder)
    stop, watch = Stop(), _watch(args, folder)
    with ExitStack() as stack:
        stack.enter_context(prepared_folder(folder, args.force))
        for note in drive.all_notes():
            print(f'note: {note}', file=sys.stderr)
        set_aside()
        stack.enter_context(stop.listening())
        progress = stack.enter_context(Progress(drive.source.info.count))
        report = stack.enter_context(ReportProcess(folder, drive.truth))

        def stage(name: str) -> None:
            progress.stage(name)
            if name == 'final solve':
                report.prepare()

        def drawn() -> bool:
            report.written()
            progress.stage('pictures')
            return report.end()

        watch.append(report.watch)
        try:
            done = map_into(folder, drive, progress.read, stop, stage, watch, pictures=False)
        except OutputError:
            if is_whole(folder):  # it is of something beside the map
                drawn()
            raise
        lost = [] if importable(FILE_NAME) else [FILE_NAME]
        lost += [] if drawn() else ['pictures']
    found = [note for note in done.statistics.input.notes if note not in drive.all_notes()]
    remark = missing_files(lost)
    for note in (*found, *([remark] if remark else [])):
        print(f'note: {note}', file=sys.stderr)
    numbers = done.statistics.to_tree()
    if args.verbose:
        print(summary(numbers))
    print(brief(numbers, time.perf_counter() - started))
    warnings = done.statistics.warnings
    sys.stdout.flush()  # the findings come after the numbers, the worst last
    print_findings(warnings)
    failed = any(finding.severity is Severity.ERROR for finding in warnings)
    print(_where(folder, failed))
    if done.statistics.interrupted:
        return exit_status.INTERRUPTED
    return exit_status.FAILURE if failed else 0


def _watch(args: argparse.Namespace, folder: Path) -> 'list[Watch]':
    """What is made of the run beside its files."""
    watch: list[Watch] = []
    if args.bag:
        from incremental_mapper.results.messages.output_bag import output_bag

        watch.append(partial(output_bag, folder))
    for wanted, save in ((args.view, None), (args.rrd is not None, args.rrd)):
        if wanted:
            from incremental_mapper.results.run_view import run_view

            watch.append(partial(run_view, save))
    return watch


def _settings(args: argparse.Namespace) -> 'Tree':
    from incremental_mapper.settings import merge, read_yaml

    tree: Tree = {} if args.config is None else read_yaml(args.config)
    chosen: Tree = {}
    if args.strategy is not None:
        chosen['strategy'] = args.strategy
    if args.verify:
        chosen['verify'] = True
    tree = merge(tree, {'selection': chosen} if chosen else {})
    return merge(tree, {'session': {'continue': str(args.earlier)}} if args.earlier else {})


def _out_dir(args: argparse.Namespace, earlier: Path | None) -> Path:
    """The folder to write into: never the one that is gone on with."""
    from incremental_mapper.results.new_folder import free_name

    out_dir: Path | None = args.out_dir
    if out_dir is None:
        if earlier is None:
            raise args.wrong_usage('the following arguments are required: OUT_DIR')  # ends here
        return free_name(earlier)
    if earlier is not None and out_dir.resolve() == earlier.resolve():
        raise OutputError(
            f'{out_dir}: is the map that is gone on with; name another folder, or none'
        )
    return out_dir


def _strategy(name: str) -> str:
    """A name that is installed; others are wrong usage."""
    from incremental_mapper.selection.strategies import strategy_names

    known = strategy_names()
    if name not in known:
        raise argparse.ArgumentTypeError(f'{name!r} is none of {", ".join(known)}')
    return name


def _where(folder: Path, failed: bool) -> str:
    """Where everything is, and what to look at first."""
    first = next((folder / name for name in TO_OPEN if (folder / name).is_file()), folder)
    text = f'written to {folder}; open {first}'
    return f'{text}; the map is not to be trusted, see above' if failed else text
