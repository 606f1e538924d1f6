"""The pictures of one drive, as SVG elements in the colours of the page."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from incremental_mapper.evaluation.record import RecordedSequence
from incremental_mapper.evaluation.report.charts import progress_figure, trade_figure
from incremental_mapper.evaluation.table import BASE, Entry, mean_metrics
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.results.run_folder import FinishedRun
from incremental_mapper.visualization.figure import PAGE, Look, css_colour, svg_for_page
from incremental_mapper.visualization.graph_legend import graph_legend
from incremental_mapper.visualization.graph_picture import graph_figure
from incremental_mapper.visualization.graph_view import unconnected_variables
from incremental_mapper.visualization.pictures import map_figure, side_figure, trajectory_figure

FEWEST_POINTS = 3
"""Strategies that make a trade; two are told in words."""
GRAPH_SECONDS = 0.8
"""Length of the stretch of graph that fits half of the page's width."""
EDGE = 50_000_000
"""Nanoseconds that a stretch may reach beyond the first and the last cluster."""
TALL = Look(theme=PAGE, width=620, height=430, text=9.5, heading=False)
FLAT = Look(theme=PAGE, width=620, height=330, text=9.5, heading=False)


@dataclass(frozen=True, slots=True)
class Picture:
    """An SVG element, and what is said under it."""

    svg: str
    caption: str


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
    lead = sequence.lead
    if lead is None:
        return
    run, truth = sequence.runs[lead], sequence.truth
    against = 'over the truth (grey)' if truth is not None else 'without truth to compare with'
    yield Picture(
        svg_for_page(
            trajectory_figure(run.trajectory, truth, run.fixes, TALL),
            f'path{number}',
            f'Trajectory of {sequence.name} from above, {against}',
        ),
        f'Trajectory of {lead} from above, {against}; crosses are GNSS positions.',
    )
    yield Picture(
        svg_for_page(
            map_figure(run.points, run.trajectory, TALL),
            f'map{number}',
            f'Map of {sequence.name} from above, coloured by height',
        ),
        f'Map of {lead} from above: {len(run.points):,} points.'.replace(',', '\N{NO-BREAK SPACE}'),
    )
    figure, caption = progress_figure(dict(sequence.runs), lead, truth, strategies, FLAT)
    if caption:
        yield Picture(
            svg_for_page(figure, f'course{number}', f'{caption[:-1]}, for {sequence.name}'), caption
        )
    yield Picture(
        svg_for_page(
            side_figure(run.points, run.trajectory, FLAT),
            f'side{number}',
            f'Map of {sequence.name} from the side, coloured by height',
        ),
        'The same map from the side.',
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


def graph_stretches(sequence: RecordedSequence, number: int) -> Iterator[Stretch]:
    """The graphs of base and of the lead: a typical stretch, and one where base is unconnected."""
    lead = sequence.lead
    if lead is None:
        return
    run = sequence.runs[lead]
    typical = run.stretch(GRAPH_SECONDS)
    yield _stretch(sequence, lead, f'{number}a', 'The graph', typical)
    unconnected = [] if BASE not in sequence.runs else _unconnected_stamps(sequence.runs[BASE])
    if unconnected:
        length, middle = typical[1] - typical[0], sum(typical) // 2
        centre = min(unconnected, key=lambda stamp: abs(stamp - middle))
        latest = run.last_stamp + EDGE - length
        start = max(min(centre - length // 2, latest), run.first_stamp - EDGE)
        span = (start, start + length)
        yield _stretch(sequence, lead, f'{number}b', 'Where base is not connected', span)


def _stretch(
    sequence: RecordedSequence, lead: str, place: str, heading: str, span: tuple[int, int]
) -> Stretch:
    origin = sequence.runs[lead].first_stamp
    pictures = []
    for name in dict.fromkeys([BASE, lead]):
        if name not in sequence.runs:
            continue
        figure, shown = graph_figure(sequence.runs[name].graph, *span, TALL, origin)
        unconnected = f', {shown.unconnected} of them not connected' if shown.unconnected else ''
        counts = (
            f'{shown.clusters} clusters, {shown.variables} variables{unconnected}, '
            f'{shown.factors} factors'
        )
        described = f'Factor graph of {name} on {sequence.name}: {counts}'
        plain_name = f'graph{place}{_plain(name)}'
        pictures.append(Picture(svg_for_page(figure, plain_name, described), f'{name}: {counts}.'))
    start, end = ((stamp - origin) / NANOSECONDS for stamp in span)
    return Stretch(f'{heading}, {start:.2f} s to {end:.2f} s', tuple(pictures))


def _unconnected_stamps(run: FinishedRun) -> list[int]:
    unconnected = unconnected_variables(run.graph)
    return [item['stamp_ns'] for item in run.graph['variables'] if item['key'] in unconnected]


def graph_swatches(sequences: tuple[RecordedSequence, ...]) -> list[Swatch]:
    """What the graph pictures of all sequences show, each thing once."""
    graphs = [
        sequence.runs[name].graph
        for sequence in sequences
        for name in dict.fromkeys([BASE, sequence.lead])
        if name in sequence.runs
    ]
    return [
        Swatch(label, shape, css_colour(fill), css_colour(edge))
        for label, shape, fill, edge in graph_legend(graphs, PAGE)
    ]


def _plain(name: str) -> str:
    return re.sub(r'\W', '', name)


def drive_seconds(sequence: RecordedSequence) -> float:
    """Length of a drive in seconds, 0 where no run has finished."""
    if sequence.lead is None:
        return 0.0
    run = sequence.runs[sequence.lead]
    return (run.last_stamp - run.first_stamp) / NANOSECONDS
