"""``incremental_mapper inspect``: what a window of a finished run chose from, and why."""

import argparse
import csv
import io
import json
import textwrap
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from incremental_mapper.errors import ConfigError
from incremental_mapper.evaluation.inspection import Inspection, Row, inspect_window, window_at
from incremental_mapper.results.finished_run import FinishedRun

WIDTH = 100
"""Columns of a terminal that the text is laid out for."""
GAP = 2


def add_parser(subparsers: Any) -> None:
    """Add the command to argparse's ``subparsers``."""
    parser = subparsers.add_parser(
        'inspect',
        description='Show every candidate of one window, best first, and why the winner won. '
        'OUT_DIR is what "map" wrote, with candidates.parquet in it.',
    )
    parser.add_argument('out_dir', type=Path, metavar='OUT_DIR', help='output folder of "map"')
    parser.add_argument(
        'window', type=int, nargs='?', metavar='WINDOW', help='its number, as in windows.csv'
    )
    parser.add_argument(
        '--at',
        metavar='T',
        help='the window at a time instead: seconds since the first cluster, or a stamp '
        '(in seconds from 1e8 on, in nanoseconds from 1e15 on)',
    )
    parser.add_argument(
        '--format',
        choices=('text', 'json', 'csv'),
        default='text',
        help='what to print (default: %(default)s)',
    )
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Carry out the command; returns the exit status."""
    if (args.window is None) == (args.at is None):
        raise ConfigError('name the window either by its number or by --at T')
    finished = FinishedRun(args.out_dir)
    index = args.window if args.at is None else window_at(finished, finished.stamp(args.at))
    found = inspect_window(finished, index)
    layouts = {'text': as_text, 'json': as_json, 'csv': as_csv}
    print(layouts[args.format](found))
    return 0


def as_text(found: Inspection) -> str:
    """For a terminal of ``WIDTH`` columns."""
    window = found.window
    counts = ', '.join(
        f'{window[f"candidates_{what}"]} {what}' for what in ('enumerated', 'connected', 'solved')
    )
    lines = [
        f'Window {window["window"]}, {found.start_s:.3f} s to {found.end_s:.3f} s since the first '
        f'cluster ({window["start_ns"]} ns)',
        f'{window["core"]} core measurements ({window["sensors"] or "none"}), '
        f'{window["imu"]} IMU samples',
        f'Strategy {found.strategy}; candidates: {counts}',
        '',
    ]
    if found.candidates:
        lines += [*_table(found.candidates), '']
    for reason in found.reasons:
        lines += textwrap.wrap(reason, WIDTH)
    if found.candidates:
        lines += [
            '',
            '* the winner, = ties with the lowest score.  Clusters are split by |, their members '
            'joined by +.',
            'A connection is an IMU span between two clusters, counted from 0; G is the last one '
            'of the graph',
            'so far.',
        ]
    return '\n'.join(lines)


def as_json(found: Inspection) -> str:
    """All that is known of the window."""
    return json.dumps(asdict(found), indent=2)


def as_csv(found: Inspection) -> str:
    """A row a candidate, in the order of the text."""
    rows = [row | {'connections': links_text(row)} for row in found.candidates]
    names = [name for name in (rows[0] if rows else {'window': 0}) if name != 'clusters']
    file = io.StringIO()
    writer = csv.DictWriter(file, names, extrasaction='ignore', lineterminator='\n')
    writer.writeheader()
    writer.writerows(rows)
    return file.getvalue().rstrip('\n')


def links_text(row: Row) -> str:
    """A candidate's connections, for example ``G-0 0-2``."""
    return ' '.join(
        f'{"G" if link["start"] < 0 else link["start"]}-{link["end"]}'
        for link in row['connections']
    )


def _table(rows: Sequence[Row]) -> list[str]:
    """Aligned columns; the two texts share what the numbers leave and are wrapped."""
    head = ('', '#', 'clusters', 'connections', 'connected', 'vertices', 'score', 'shift', 'error')
    texts = {2, 3}
    cells = [
        (
            '*' if row['winner'] else '=' * bool(row['tied']),
            str(row['candidate']),
            row['members'].replace('|', ' | '),
            links_text(row) or 'none',
            'yes' if row['connected'] else 'no',
            str(row['vertices']),
            _number(row['score']),
            f'{1e3 * row["time_shift_s"]:.2f} ms',
            _number(row['solver_error']),
        )
        for row in rows
    ]
    widths = [max(map(len, column)) for column in zip(head, *cells, strict=True)]
    room = WIDTH - sum(w for i, w in enumerate(widths) if i not in texts) - GAP * (len(head) - 1)
    widths[3] = max(min(widths[3], room - widths[2]), len(head[3]), min(widths[3], room // 3))
    widths[2] = max(min(widths[2], room - widths[3]), len(head[2]))
    lines = []
    for row in (head, *cells):
        wrapped = [
            textwrap.wrap(cell, width, break_on_hyphens=False) or ['']
            for cell, width in zip(row, widths, strict=True)
        ]
        for number in range(max(map(len, wrapped))):
            parts = [cell[number] if number < len(cell) else '' for cell in wrapped]
            line = (' ' * GAP).join(
                part.ljust(width) if i in texts else part.rjust(width)
                for i, (part, width) in enumerate(zip(parts, widths, strict=True))
            )
            lines.append(line.rstrip())
    return lines


def _number(value: float | None) -> str:
    return '' if value is None else f'{value:.6g}'
