"""The page of one run, which ``map`` writes beside its files.

Importing this needs jinja2 and matplotlib, which come with the extra ``report``.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from incremental_mapper.checks.finding import Severity
from incremental_mapper.evaluation.report.charts import strategy_colours
from incremental_mapper.evaluation.report.drawings import (
    GRAPH_SECONDS,
    Swatch,
    drive_pictures,
    graph_stretch,
    swatches,
)
from incremental_mapper.evaluation.report.rendering import as_yaml, write_page
from incremental_mapper.evaluation.report.words import Tile
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.trajectory import Trajectory
from incremental_mapper.visualization.figure import PAGE, css_colour

TEMPLATE = 'run.html'


def write_run_report(folder: Path, truth: Trajectory | None = None) -> Path:
    """Write ``report.html`` into the folder of a run; returns its path.

    Args:
        folder: The output of ``map``.
        truth: The true trajectory, where there is one.

    Raises:
        InputError: The folder holds no run.
        OutputError: The page cannot be written.
    """
    run = FinishedRun(folder)
    stats, strategy = run.stats, str(run.stats['strategy'])
    runs, name = {strategy: run}, Path(str(stats['input']['path'])).name
    colour = css_colour(strategy_colours((strategy,), PAGE)[strategy])
    stretch = graph_stretch(
        name, runs, (strategy,), strategy, 'g', 'A stretch of the graph', run.stretch(GRAPH_SECONDS)
    )
    return write_page(
        folder,
        TEMPLATE,
        {
            'name': name,
            'strategy': strategy,
            'stats': stats,
            'heading': _heading(stats),
            'findings': [
                (item['severity'], item['sensor'], item['text'], item['remedy'])
                for item in stats['warnings']
            ],
            'wrong': any(item['severity'] == Severity.ERROR for item in stats['warnings']),
            'tiles': _tiles(stats),
            'pictures': list(drive_pictures(name, runs, strategy, truth, (strategy,), 1)),
            'strategies': [Swatch(strategy, 'line', colour, colour)],
            'stretch': stretch,
            'graph_legend': swatches([run.graph]),
            'sensors': _sensors(stats),
            'numbers': _numbers(stats),
            'settings': as_yaml(stats['settings'] or {}),
        },
    )


def _heading(stats: Mapping[str, Any]) -> str:
    saving = stats['compression_vertices_percent']
    word = 'fewer' if saving >= 0.0 else 'more'
    told = f'{stats["drive_s"]:.1f} s mapped with {abs(saving):.1f} % {word} variables than base'
    error = stats.get('rpe_per_second_translation_rmse_m')
    return told if error is None else f'{told}; it drifts {100 * error:.1f} cm over a second'


def _tiles(stats: Mapping[str, Any]) -> list[Tile]:
    variables = f'{stats["vertices"]} instead of {stats["base_vertices"]}'
    made = [Tile(f'{stats["compression_vertices_percent"]:.1f} %', 'fewer variables', variables)]
    for key, what in (
        ('rpe_per_second_translation_rmse_m', 'relative pose error per second'),
        ('ate_rmse_m', 'absolute trajectory error'),
    ):
        if stats.get(key) is not None:
            made.append(Tile(f'{stats[key]:.4f} m', what))
    parts = stats['components']
    made.append(
        Tile(
            str(parts),
            'part of the graph: all is connected' if parts == 1 else 'parts of the graph',
            f'{stats["bridges"]} bridges' if stats['bridges'] else '',
        )
    )
    place = 'east, north, up' if stats['georeferenced'] else 'in a frame of its own'
    points = f'{stats["map_points"]:,}'.replace(',', '\N{NO-BREAK SPACE}')
    made.append(Tile(points, 'points of the map', place))
    factor = f'{stats["real_time_factor"]:.1f}'
    made.append(Tile(factor, 'real-time factor', f'mapped in {stats["wall_s"]:.1f} s'))
    return made


def _sensors(stats: Mapping[str, Any]) -> list[tuple[str, int, str]]:
    """Name, messages, and what was left out of each sensor."""
    counts, dropped = stats['input']['counts'], stats['dropped']
    return [
        (
            name,
            counts.get(name, 0),
            ', '.join(f'{count} {reason}' for reason, count in dropped.get(name, {}).items()),
        )
        for name in dict.fromkeys([*counts, *dropped])
    ]


def _numbers(stats: Mapping[str, Any]) -> list[tuple[str, str]]:
    kinds = ', '.join(f'{count} {kind}' for kind, count in stats['factors_by_kind'].items())
    rows = [
        ('Clusters', f'{stats["clusters"]} (base: {stats["base_clusters"]})'),
        ('Factors', f'{stats["factors"]} (base: {stats["base_factors"]}): {kinds}'),
        ('Windows', f'{stats["windows"]}, {stats["standing_windows"]} of them at rest'),
        (
            'Candidates',
            f'{stats["candidates_enumerated"]} enumerated, {stats["candidates_connected"]} '
            f'connected, {stats["candidates_solved"]} solved',
        ),
        ('Total time shift', f'{stats["total_time_shift_s"]:.4f} s'),
        ('Solver error', f'{stats["solver_error"]:.4f}'),
        ('Peak memory', f'{stats["peak_rss_mb"]:.0f} MB'),
    ]
    if stats.get('window_median_s') is not None:
        rows.append(
            (
                'A window takes',
                f'{1e3 * stats["window_median_s"]:.0f} ms, {1e3 * stats["window_p99_s"]:.0f} ms '
                'at p99',
            )
        )
    if stats.get('rpe_translation_rmse_m') is not None:
        rows.append(
            (
                'From pose to pose',
                f'{stats["rpe_translation_rmse_m"]:.4f} m, '
                f'{stats["rpe_rotation_rmse_deg"]:.3f}° (RPE)',
            )
        )
    if stats['datum']:
        latitude, longitude, height = stats['datum']
        rows.append(('Origin', f'{latitude:.7f}°, {longitude:.7f}°, {height:.2f} m'))
    return rows
