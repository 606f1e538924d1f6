"""The pictures of one drive, as SVG elements in the colours of the page."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from incremental_mapper.evaluation.record import RecordedSequence
from incremental_mapper.evaluation.report.charts import (
    progress_figure,
    strategy_colours,
    trade_figure,
)
from incremental_mapper.evaluation.table import BASE, Entry, mean_metrics
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.trajectory import Trajectory
from incremental_mapper.visualization.figure import PAGE, Look, css_colour, svg_for_page
from incremental_mapper.visualization.graph_legend import graph_legend
from incremental_mapper.visualization.graph_picture import graph_figure
from incremental_mapper.visualization.graph_view import closure_ends, unconnected_variables
from incremental_mapper.visualization.pictures import map_figure, side_figure, trajectory_figure

FEWEST_POINTS = 3
"""Strategies that make a trade; two are told in words."""
GRAPH_SECONDS = 1.2
"""Length of the stretch of graph that fits the page's width, so that its numbers can be read."""
EDGE = 50_000_000
"""Nanoseconds that a stretch may reach beyond the first and the last cluster."""
TALL = Look(theme=PAGE, width=620, height=430, text=9.5, heading=False)
BROAD = Look(theme=PAGE, width=1240, height=380, text=10.5, heading=False)
FLAT = Look(theme=PAGE, width=620, height=330, text=9.5, heading=False)


@dataclass(frozen=True, slots=True)
class Picture:
    """An SVG element, what is said under it, and what of one strategy is headed by.

    ``colour`` is that of the strategy in CSS. A ``wide`` one is scrolled where there is no room.
    """

    svg: str
    caption: str
    name: str = ''
    colour: str = ''
    wide: bool = False


@dataclass(frozen=True, slots=True)
class Stretch:
    """Graphs over the same stretch of time, and what the stretch is."""

    heading: str
    pictures: tuple[Picture, ...]


@dataclass(frozen=True, slots=True)
class Swatch:
    """One item of a legend: what it is, its shape, and its fill and edge in CSS."""

    label: str
    shape: str
    fill: str
    edge: str


def sequence_pictures(
    sequence: RecordedSequence, strategies: tuple[str, ...], number: int
) -> Iterator[Picture]:
    """Trajectory, map from above and from the side, and the course of the numbers.

    ``number`` is the sequence's own in the page. Yields nothing where no run has finished.
    """
    if sequence.lead is not None:
        yield from drive_pictures(
            sequence.name, sequence.runs, sequence.lead, sequence.truth, strategies, number
        )


def drive_pictures(
    name: str,
    runs: Mapping[str, FinishedRun],
    lead: str,
    truth: Trajectory | None,
    strategies: tuple[str, ...],
    number: int,
) -> Iterator[Picture]:
    """As ``sequence_pictures``, of a drive's runs by strategy.

    Args:
        name: Of the drive.
        runs: Its runs; pictures are of ``lead``, courses of all of them.
        lead: The strategy that is shown.
        truth: The true trajectory, where there is one.
        strategies: All of the page, whose order gives the colours.
        number: The drive's own in the page.
    """
    run = runs[lead]
    against = 'over the truth (grey)' if truth is not None else 'without truth to compare with'
    yield Picture(
        svg_for_page(
            trajectory_figure(
                run.trajectory,
                truth,
                run.fixes,
                TALL,
                run.georeferenced,
                closure_ends(run.graph),
            ),
            f'path{number}',
            f'Trajectory of {name} from above, {against}',
        ),
        f'Trajectory of {lead} from above, {against}; crosses are GNSS positions.',
    )
    yield Picture(
        svg_for_page(
            map_figure(run.points, run.trajectory, TALL, run.georeferenced),
            f'map{number}',
            f'Map of {name} from above, coloured by height above the way',
        ),
        f'Map of {lead} from above: {run.map.count:,} points.'.replace(',', '\N{NO-BREAK SPACE}'),
    )
    figure, caption = progress_figure(runs, lead, truth, strategies, FLAT)
    if caption:
        yield Picture(
            svg_for_page(figure, f'course{number}', f'{caption[:-1]}, for {name}'), caption
        )
    yield Picture(
        svg_for_page(
            side_figure(run.points, run.trajectory, FLAT, run.georeferenced),
            f'side{number}',
            f'Map of {name} from the side, coloured by height above the way',
        ),
        'The same map from the side, all of it projected onto one line.',
    )


def trade_picture(entries: Sequence[Entry], strategies: Sequence[str]) -> Picture | None:
    """What each strategy saves and what it costs; means over the drives.

    Args:
        entries: Of all drives.
        strategies: Their labels.

    Returns:
        The chart; None where too few strategies have both numbers to show a trade.
    """
    found: dict[str, dict[str, Entry]] = {}
    for entry in entries:
        found.setdefault(entry.sequence, {})[entry.strategy] = entry
    points: dict[str, tuple[float, float]] = {}
    for label, means in zip(
        strategies, mean_metrics(list(found.values()), strategies), strict=True
    ):
        error = means.get('rpe_per_second_translation_rmse_m')
        saved = 0.0 if label == BASE else means.get('compression_vertices_percent')
        if error is not None and saved is not None:
            points[label] = (100.0 * error, saved)
    if len(points) < FEWEST_POINTS:
        return None
    over = 'means over the drives' if len(found) > 1 else 'of the drive'
    caption = f'Variables saved against the relative pose error per second, {over}'
    said = f'{caption}: up is smaller, left is more accurate.'
    return Picture(svg_for_page(trade_figure(points, FLAT), 'trade', caption), said)


def graph_stretches(
    sequence: RecordedSequence, strategies: tuple[str, ...], number: int
) -> Iterator[Stretch]:
    """The graphs of base and of the lead: a typical stretch, and one where base is unconnected."""
    lead = sequence.lead
    if lead is None:
        return
    run = sequence.runs[lead]
    typical = run.stretch(GRAPH_SECONDS)
    names = (sequence.name, sequence.runs, strategies, lead)
    yield graph_stretch(*names, f'{number}a', 'The graph', typical)
    unconnected = [] if BASE not in sequence.runs else _unconnected_stamps(sequence.runs[BASE])
    if unconnected:
        length, middle = typical[1] - typical[0], sum(typical) // 2
        centre = min(unconnected, key=lambda stamp: abs(stamp - middle))
        latest = run.last_stamp + EDGE - length
        start = max(min(centre - length // 2, latest), run.first_stamp - EDGE)
        span = (start, start + length)
        heading = 'Where base is not connected'
        yield graph_stretch(*names, f'{number}b', heading, span)


def graph_stretch(
    drive: str,
    runs: Mapping[str, FinishedRun],
    strategies: tuple[str, ...],
    lead: str,
    place: str,
    heading: str,
    span: tuple[int, int],
) -> Stretch:
    """The graphs of base and of ``lead``, those that there are, over one stretch of time.

    ``drive``, ``runs``, ``strategies`` and ``lead`` are as in ``drive_pictures``; ``place`` tells
    names in the page apart, and ``span`` is from and to, ns.
    """
    origin = runs[lead].first_stamp
    colours = strategy_colours(strategies, PAGE)
    pictures = []
    for name in dict.fromkeys([BASE, lead]):
        if name not in runs:
            continue
        figure, shown = graph_figure(runs[name].graph, *span, BROAD, origin)
        unconnected = f', {shown.unconnected} of them not connected' if shown.unconnected else ''
        counts = (
            f'{shown.clusters} clusters, {shown.variables} variables{unconnected}, '
            f'{shown.factors} factors'
        )
        described = f'Factor graph of {name} on {drive}: {counts}'
        plain_name = f'graph{place}{_plain(name)}'
        what = 'the conventional graph' if name == BASE else 'the chosen graph'
        pictures.append(
            Picture(
                svg_for_page(figure, plain_name, described),
                f'{counts}.',
                f'{name}, {what}',
                css_colour(colours[name]),
                wide=True,
            )
        )
    start, end = ((stamp - origin) / NANOSECONDS for stamp in span)
    return Stretch(f'{heading}, {start:.2f} s to {end:.2f} s', tuple(pictures))


def _unconnected_stamps(run: FinishedRun) -> list[int]:
    unconnected = unconnected_variables(run.graph)
    return [item['stamp_ns'] for item in run.graph['variables'] if item['key'] in unconnected]


def graph_swatches(sequences: tuple[RecordedSequence, ...]) -> list[Swatch]:
    """What the graph pictures of all sequences show, each thing once."""
    return swatches(
        sequence.runs[name].graph
        for sequence in sequences
        for name in dict.fromkeys([BASE, sequence.lead])
        if name in sequence.runs
    )


def swatches(graphs: Iterable[Mapping[str, Any]]) -> list[Swatch]:
    """What the pictures of graphs, in the layout of ``graph.json``, show; each thing once."""
    return [
        Swatch(label, shape, css_colour(fill), css_colour(edge))
        for label, shape, fill, edge in graph_legend(list(graphs), PAGE)
    ]


def _plain(name: str) -> str:
    return re.sub(r'\W', '', name)


def drive_seconds(sequence: RecordedSequence) -> float:
    """Length of a drive in seconds, 0 where no run has finished."""
    if sequence.lead is None:
        return 0.0
    run = sequence.runs[sequence.lead]
    return (run.last_stamp - run.first_stamp) / NANOSECONDS
