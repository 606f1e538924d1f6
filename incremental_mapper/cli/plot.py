"""``incremental_mapper plot``: single pictures of a finished run."""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from incremental_mapper.datasets.open import read_truth
from incremental_mapper.errors import ConfigError
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.visualization.figure import THEMES, WHOLE, check_suffix
from incremental_mapper.visualization.graph_picture import draw_graph
from incremental_mapper.visualization.graph_view import closure_ends
from incremental_mapper.visualization.pictures import WIDE, draw_map, draw_map_side, draw_trajectory

TIME = 'seconds since the first cluster, or a stamp (seconds from 1e8, nanoseconds from 1e15 on)'
TRUTH_NAME = 'truth.tum'


def add_parser(subparsers: Any) -> None:
    """Add the command to argparse's ``subparsers``."""
    parser = subparsers.add_parser(
        'plot',
        description='Draw one picture of what "map" wrote, as PNG, SVG or PDF.',
    )
    kinds = parser.add_subparsers(required=True, metavar='PICTURE')
    graph = _add_kind(kinds, 'graph', 'a stretch of the factor graph', _plot_graph)
    graph.add_argument('--from', dest='start', metavar='T', help=f'where to begin: {TIME}')
    graph.add_argument(
        '--to', dest='end', metavar='T', help='where to end (default: around a fix, 1.5 s)'
    )
    chart = _add_kind(kinds, 'map', 'the map from above, coloured by height', _plot_map)
    chart.add_argument('--side', action='store_true', help='from the side instead')
    path = _add_kind(kinds, 'trajectory', 'the trajectory from above', _plot_trajectory)
    path.add_argument(
        '--truth',
        type=Path,
        metavar='FILE',
        help="true poses to draw too, TUM or KAIST's global_pose.csv (default: truth.tum in "
        'OUT_DIR or beside it, where "evaluate" writes it)',
    )


def _add_kind(kinds: Any, name: str, what: str, function: Any) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = kinds.add_parser(name, help=what, description=f'Draw {what}.')
    parser.add_argument('out_dir', type=Path, metavar='OUT_DIR', help='output folder of "map"')
    parser.add_argument(
        '--out',
        type=Path,
        metavar='FILE',
        help='file to write, .png, .svg or .pdf (default: a PNG in OUT_DIR)',
    )
    parser.add_argument(
        '--theme',
        choices=list(THEMES),
        default='light',
        help='colours for a light or a dark ground (default: %(default)s)',
    )
    parser.set_defaults(func=function)
    return parser


def _plot_graph(args: argparse.Namespace) -> int:
    run, out = _opened(args, 'graph.png')
    start, end = run.stretch()
    if args.start is not None:
        start, end = run.stamp(args.start), run.stamp(args.start) + end - start
    if args.end is not None:
        start = start if args.start is not None else run.stamp(args.end) - (end - start)
        end = run.stamp(args.end)
    span = f'{run.seconds(start):.3f} s to {run.seconds(end):.3f} s'
    if end <= start:
        raise ConfigError(f'--from must be before --to; the span is {span}')
    if not any(start <= item['stamp_ns'] <= end for item in run.graph['clusters']):
        raise ConfigError(
            f'{args.out_dir}: no cluster from {span}; the run has them from 0 s to '
            f'{run.seconds(run.last_stamp):.3f} s'
        )
    draw_graph(out, run.graph, start, end, replace(WHOLE, theme=THEMES[args.theme]))
    return _told(out)


def _plot_map(args: argparse.Namespace) -> int:
    run, out = _opened(args, 'map_side.png' if args.side else 'map.png')
    look = replace(WIDE if args.side else WHOLE, theme=THEMES[args.theme])
    draw = draw_map_side if args.side else draw_map
    draw(out, run.points, run.trajectory, look, run.georeferenced)
    return _told(out)


def _plot_trajectory(args: argparse.Namespace) -> int:
    run, out = _opened(args, 'trajectory.png')
    beside = [folder / TRUTH_NAME for folder in (args.out_dir, args.out_dir.resolve().parent)]
    file = args.truth or next((path for path in beside if path.is_file()), None)
    truth = None if file is None else read_truth(file)
    look = replace(WHOLE, theme=THEMES[args.theme])
    closures = closure_ends(run.graph)
    draw_trajectory(out, run.trajectory, truth, run.fixes, look, run.georeferenced, closures)
    return _told(out)


def _opened(args: argparse.Namespace, name: str) -> tuple[FinishedRun, Path]:
    """The run, which must be one, and the file to write."""
    out: Path = args.out or args.out_dir / name
    check_suffix(out)
    run = FinishedRun(args.out_dir)
    run.check()
    return run, out


def _told(out: Path) -> int:
    print(out)
    return 0
