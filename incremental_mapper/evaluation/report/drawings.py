"""The pictures of one drive, as SVG elements in the colours of the page."""

import re
from collections.abc import Iterator
from dataclasses import dataclass

from incremental_mapper.evaluation.figure import PAGE, Look, css_colour, svg_for_page
from incremental_mapper.evaluation.graph_picture import graph_figure, graph_legend, loose_variables
from incremental_mapper.evaluation.pictures import map_figure, side_figure, trajectory_figure
from incremental_mapper.evaluation.report.charts import progress_figure
from incremental_mapper.evaluation.report.contents import Sequence
from incremental_mapper.evaluation.table import BASE
from incremental_mapper.trajectory import NANOSECONDS

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
class Swatch:
    """One item of a legend: what it is, its shape, and its fill and edge in CSS."""

    label: str
    shape: str
    fill: str
    edge: str


def sequence_pictures(
    sequence: Sequence, strategies: tuple[str, ...], number: int
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


def graph_pictures(sequence: Sequence, number: int) -> Iterator[Picture]:
    """The same stretch of the graphs of base and of the lead."""
    lead = sequence.lead
    if lead is None:
        return
    start, end = stretch(sequence)
    origin = sequence.runs[lead].first_stamp
    for name in dict.fromkeys([BASE, lead]):
        if name not in sequence.runs:
            continue
        run = sequence.runs[name]
        figure, shown = graph_figure(run.graph, start, end, TALL, origin)
        loose = f'; {shown.loose} of them not connected' if shown.loose else ''
        caption = (
            f'{name}: {shown.clusters} clusters, {shown.variables} variables{loose}, '
            f'{shown.factors} factors.'
        )
        described = f'Factor graph of {name} on {sequence.name}, {caption.split(": ", 1)[1]}'
        yield Picture(svg_for_page(figure, f'graph{number}{_plain(name)}', described), caption)


def stretch(sequence: Sequence) -> tuple[int, int]:
    """Start and end (ns) of the graph pictures: where base is not connected, else around a fix."""
    assert sequence.lead is not None
    run = sequence.runs[sequence.lead]
    start, end = run.stretch(GRAPH_SECONDS)
    if BASE in sequence.runs:
        graph = sequence.runs[BASE].graph
        loose = loose_variables(graph)
        stamps = [item['stamp_ns'] for item in graph['variables'] if item['key'] in loose]
        middle, half = (start + end) // 2, (end - start) // 2
        centre = min(stamps, key=lambda stamp: abs(stamp - middle), default=middle)
        start = max(min(centre - half, run.last_stamp + EDGE - 2 * half), run.first_stamp - EDGE)
        end = start + 2 * half
    return start, end


def stretch_text(sequence: Sequence) -> str:
    """Where that stretch lies."""
    assert sequence.lead is not None
    run = sequence.runs[sequence.lead]
    start, end = stretch(sequence)
    return f'{run.seconds(start):.2f} s to {run.seconds(end):.2f} s'


def graph_swatches(sequences: tuple[Sequence, ...]) -> list[Swatch]:
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


def drive_seconds(sequence: Sequence) -> float:
    """Length of a drive in seconds, 0 where no run has finished."""
    if sequence.lead is None:
        return 0.0
    run = sequence.runs[sequence.lead]
    return (run.last_stamp - run.first_stamp) / NANOSECONDS
