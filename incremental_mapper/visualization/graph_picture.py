"""Picture of a piece of the factor graph over time: variables, clusters, measurements, factors."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.visualization.figure import (
    DPI,
    WHOLE,
    Look,
    Theme,
    axes_pixels,
    box,
    new_figure,
    plain,
    save,
    title,
)
from incremental_mapper.visualization.graph_legend import add_graph_legend, sensor_colours
from incremental_mapper.visualization.graph_view import (
    Record,
    first_stamp,
    sensor_names,
    spread_clusters,
    unconnected_variables,
)
from incremental_mapper.visualization.strokes import Spot, Strokes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ROWS = {'pose': 0.0, 'velocity': -1.2, 'bias': -2.4}
"""Height of each kind of variable; arcs of odometry rise above the poses."""
ROW_NAMES = {'pose': 'X  pose', 'velocity': 'V  velocity', 'bias': 'B  bias'}
FIRST_SENSOR_ROW = -1.1
"""How far below the lowest row of variables."""
SENSOR_ROW_STEP = 0.55
LOWEST_ARC, ARC_STEP = 0.75, 0.62
BIAS_RAIL = 0.3
"""How far above a bias the line runs that leads to the spans which share it."""
FACTOR_SIZE = 9
"""Side of a factor's square in pixels."""
SMALLEST_LABELLED_NODE = 14


@dataclass(frozen=True, slots=True)
class _Canvas:
    """What the drawing steps share: the axes, the scale and where everything is.

    ``places`` and ``spots`` are where clusters (seconds since ``origin``) and variables (the same
    and a height) are drawn; ``origin`` is the stamp of the graph's first cluster in nanoseconds.
    ``node`` is the diameter of a variable in pixels, ``pixel`` the seconds that a pixel is wide.
    ``kinds`` has the heights of the variables' rows by their names, ``sensors`` those of the
    sensors' rows, ``colours`` their colours. ``strokes`` are drawn when all is known.
    """

    axes: 'Axes'
    look: Look
    origin: int
    pixel: float
    node: float
    places: dict[int, float]
    spots: dict[str, Spot]
    kinds: dict[str, float]
    sensors: dict[str, float]
    lidars: list[str]
    colours: dict[str, str]
    strokes: Strokes = field(default_factory=Strokes)

    @property
    def theme(self) -> Theme:
        """The colours of the picture."""
        return self.look.theme

    def seconds(self, stamp_ns: int) -> float:
        return (stamp_ns - self.origin) / NANOSECONDS


@dataclass(frozen=True, slots=True)
class Shown:
    """How much of a graph a picture shows; ``unconnected`` counts some of the ``variables``."""

    clusters: int
    variables: int
    factors: int
    unconnected: int


def draw_graph(path: Path, graph: Record, start_ns: int, end_ns: int, look: Look = WHOLE) -> None:
    """Draw a stretch of a graph into a file; one to two seconds are legible.

    Variables that no path of factors joins to the largest component of the graph are marked.

    Args:
        path: A PNG, SVG or PDF, as the suffix says.
        graph: The layout of ``graph.json``.
        start_ns: Stamp where the stretch begins.
        end_ns: Stamp where it ends.
        look: Colours and size.

    Raises:
        OutputError: matplotlib is missing, or the file cannot be written.
        ValueError: The stretch is empty.
    """
    save(graph_figure(graph, start_ns, end_ns, look)[0], path)


def graph_figure(
    graph: Record, start_ns: int, end_ns: int, look: Look, origin: int | None = None
) -> tuple['Figure', Shown]:
    """The figure that ``draw_graph`` saves.

    Args:
        graph: The layout of ``graph.json``.
        start_ns: Stamp where the stretch begins.
        end_ns: Stamp where it ends.
        look: Colours and size.
        origin: See ``paint_graph``.

    Returns:
        The figure, and how much it shows.

    Raises:
        OutputError: matplotlib is missing.
        ValueError: The stretch is empty.
    """
    figure = new_figure(look)
    margins = (152, 117, 24, 72) if look.heading else (round(11 * look.text), 50, 10, 8)
    axes = figure.add_axes(box(look, *margins))
    origin = first_stamp(graph, start_ns) if origin is None else origin
    shown = paint_graph(axes, graph, start_ns, end_ns, look, origin)
    span = [f'{(stamp - origin) / NANOSECONDS:.2f} s' for stamp in (start_ns, end_ns)]
    counts = {
        'cluster': shown.clusters,
        'variable': shown.variables,
        'factor': shown.factors,
    }
    facts = ', '.join(f'{count} {name}{"s" * (count != 1)}' for name, count in counts.items())
    title(figure, 'Factor graph', f'{facts} between {span[0]} and {span[1]}', look)
    if look.heading:
        add_graph_legend(figure, [graph], look)
    return figure, shown


def paint_graph(
    axes: 'Axes',
    graph: Record,
    start_ns: int,
    end_ns: int,
    look: Look,
    origin: int | None = None,
    imu_stamps: Sequence[int] = (),
) -> Shown:
    """Draw a stretch of a graph into axes of one's own.

    Args:
        axes: Where to draw.
        graph: The layout of ``graph.json``.
        start_ns: Stamp where the stretch begins.
        end_ns: Stamp where it ends.
        look: Colours and sizes.
        origin: Stamp (ns) of second 0; by default that of the first cluster, which differs
            between graphs of one drive.
        imu_stamps: Stamps (ns) of IMU samples to be drawn as a row of their own.

    Returns:
        How much is shown.

    Raises:
        ValueError: The stretch is empty.
    """
    if end_ns <= start_ns:
        raise ValueError(f'the span from {start_ns} to {end_ns} is empty')
    clusters = [item for item in graph['clusters'] if start_ns <= item['stamp_ns'] <= end_ns]
    if origin is None:
        origin = first_stamp(graph, start_ns)
    canvas = _make_canvas(axes, look, graph, clusters, (start_ns, end_ns), origin)
    if len(imu_stamps):
        _draw_samples(canvas, imu_stamps)
    _draw_clusters(canvas, clusters)
    shown = {item['id'] for item in clusters}
    factors = _draw_factors(canvas, graph, shown)
    variables, unconnected = _draw_variables(canvas, graph, shown)
    canvas.strokes.draw(axes)
    _finish(canvas, start_ns, end_ns)
    return Shown(len(clusters), variables, factors, unconnected)


def _make_canvas(
    axes: 'Axes',
    look: Look,
    graph: Record,
    clusters: Sequence[Record],
    span: tuple[int, int],
    origin: int,
) -> _Canvas:
    start_ns, end_ns = span
    # Sensors of the whole graph, so that pictures of different spans have the same rows.
    lidars, others = sensor_names(graph)
    there = {item['kind'] for item in graph['variables']} | {'pose'}
    kinds = {ROW_NAMES[kind]: height for kind, height in ROWS.items() if kind in there}
    highest = min(kinds.values()) + FIRST_SENSOR_ROW
    rows = {name: highest - SENSOR_ROW_STEP * row for row, name in enumerate(lidars + others)}
    colours = sensor_colours(lidars, others, look.theme)
    pixel = (end_ns - start_ns) / NANOSECONDS / axes_pixels(axes)[0]
    stamps = np.array(sorted(item['stamp_ns'] for item in clusters), dtype=np.int64)
    gaps = np.diff(stamps) / NANOSECONDS / pixel
    # The few pairs that are closer than this are moved apart.
    node = float(np.clip(np.percentile(gaps, 15) * 0.9 if len(gaps) else 24.0, 9.0, 24.0))
    # In a span too crowded for its nodes they overlap, rather than wander off their stamps.
    crowded = 0.7 * (end_ns - start_ns) / NANOSECONDS / max(len(clusters), 1)
    places = spread_clusters(graph['clusters'], origin, min(node * 0.95 * pixel, crowded))
    spots = {
        item['key']: (places[item['cluster']], ROWS[item['kind']]) for item in graph['variables']
    }
    return _Canvas(axes, look, origin, pixel, node, places, spots, kinds, rows, lidars, colours)


def _draw_samples(canvas: _Canvas, stamps: Sequence[int]) -> None:
    """A row of ticks below the other sensors."""
    low = min((*canvas.sensors.values(), *canvas.kinds.values()))
    canvas.sensors['imu'] = low - SENSOR_ROW_STEP
    canvas.colours['imu'] = canvas.theme.orange
    canvas.axes.vlines(
        [canvas.seconds(stamp) for stamp in stamps], canvas.sensors['imu'] - 0.16,
        canvas.sensors['imu'] + 0.16, color=canvas.theme.orange, linewidth=2.4, zorder=4,
    )  # fmt: skip


def _draw_clusters(canvas: _Canvas, clusters: Sequence[Record]) -> None:
    """Boxes from the first to the last member, and the members at their own stamps."""
    from matplotlib.patches import FancyBboxPatch

    ordered = sorted(clusters, key=lambda item: int(item['stamp_ns']))
    bottom = min((*canvas.sensors.values(), *canvas.kinds.values())) - 0.3
    half = canvas.node * 0.68 * canvas.pixel
    edges = [
        (
            min(canvas.seconds(item['first_ns']), canvas.places[item['id']]) - half,
            max(canvas.seconds(item['last_ns']), canvas.places[item['id']]) + half,
        )
        for item in ordered
    ]
    for index, item in enumerate(ordered):
        left, right = edges[index]
        # Boxes of clusters that are nearer than a node is wide share the room between them.
        if index > 0 and edges[index - 1][1] > left:
            left = (edges[index - 1][1] + left) / 2 + canvas.pixel
        if index + 1 < len(edges) and edges[index + 1][0] < right:
            right = (edges[index + 1][0] + right) / 2 - canvas.pixel
        box = FancyBboxPatch(
            (left, bottom), right - left, 0.42 - bottom, boxstyle='square,pad=0',
            facecolor=(canvas.theme.even, canvas.theme.odd)[item['window'] % 2],
            edgecolor=canvas.theme.edge, linewidth=1.0, zorder=1,
        )  # fmt: skip
        canvas.axes.add_patch(box)
        for member in item['members']:
            canvas.strokes.mark(
                (canvas.seconds(member['stamp_ns']), canvas.sensors[member['sensor']]),
                marker='D' if member['kind'] == 'lidar' else '^', markersize=7,
                color=canvas.colours[member['sensor']], zorder=4,
            )  # fmt: skip


def _draw_factors(canvas: _Canvas, graph: Record, shown: set[int]) -> int:
    """Draw the factors that touch a shown cluster; returns how many there are."""
    cluster_of = {item['key']: item['cluster'] for item in graph['variables']}
    above = {name: LOWEST_ARC + ARC_STEP * index for index, name in enumerate(canvas.lidars)}
    fixes: Counter[str] = Counter()
    drawn = 0
    for factor in graph['factors']:
        keys, kind = factor['variables'], factor['kind']
        if not any(cluster_of[key] in shown for key in keys):
            continue
        drawn += 1
        spots = [canvas.spots[key] for key in keys]
        if kind == 'odometry':
            _draw_arc(canvas, spots, canvas.colours[factor['sensor']], above[factor['sensor']])
        elif kind == 'closure':
            # Its other end lies minutes away: it leaves the picture.
            _draw_arc(canvas, spots, canvas.theme.unconnected_edge, max(above.values(), default=0))
        elif kind == 'imu':
            _draw_span(canvas, keys, spots)
        elif kind == 'gnss':
            # Several fixes of one pose stand side by side.
            shift = fixes[keys[0]] * FACTOR_SIZE * 1.3 * canvas.pixel
            _draw_star(canvas, (spots[0][0] + shift, spots[0][1] - 0.56), spots, canvas.theme.green)
            fixes[keys[0]] += 1
        elif len(spots) == 1:
            shift = (canvas.node / 2 + FACTOR_SIZE * 1.3) * canvas.pixel
            _draw_star(canvas, (spots[0][0] - shift, spots[0][1]), spots, canvas.theme.ink)
        else:
            x, y = np.mean(spots, axis=0)
            _draw_star(canvas, (float(x), float(y)), spots, canvas.theme.grey)
    return drawn


def _draw_arc(canvas: _Canvas, spots: Sequence[Spot], colour: str, height: float) -> None:
    (x0, y0), (x1, y1) = spots
    lift = height * 4 / 3  # a cubic curve reaches three quarters of its control points' height
    inset = (x1 - x0) * 0.12
    points = [(x0, y0), (x0 + inset, y0 + lift), (x1 - inset, y1 + lift), (x1, y1)]
    canvas.strokes.arc(points, edgecolor=colour, linewidth=1.6, zorder=2)
    _draw_square(canvas, ((x0 + x1) / 2, (y0 + y1) / 2 + height), colour)


def _draw_span(canvas: _Canvas, keys: Sequence[str], spots: Sequence[Spot]) -> None:
    """An IMU span, with a line along the row of biases where it shares one with others."""
    ends = [spot for key, spot in zip(keys, spots, strict=True) if key[0] != 'b']
    biases = [spot for key, spot in zip(keys, spots, strict=True) if key[0] == 'b']
    places = [x for x, _ in ends]
    hub = ((min(places) + max(places)) / 2, ROWS['velocity'])
    shared = len(biases) == 1
    if shared:
        (x, y) = biases[0]
        rail = y + BIAS_RAIL
        canvas.strokes.line(
            [hub, (hub[0], rail), (x, rail), (x, y)], color=canvas.theme.orange, linewidth=1.1,
            alpha=0.8, zorder=2,
        )  # fmt: skip
    _draw_star(canvas, hub, ends if shared else spots, canvas.theme.orange)


def _draw_star(canvas: _Canvas, centre: Spot, spots: Sequence[Spot], colour: str) -> None:
    """A factor at ``centre`` with a line to each of its variables."""
    for spot in spots:
        canvas.strokes.line([centre, spot], color=colour, linewidth=1.1, alpha=0.8, zorder=2)
    _draw_square(canvas, centre, colour)


def _draw_square(canvas: _Canvas, centre: Spot, colour: str) -> None:
    canvas.strokes.mark(
        centre, marker='s', markersize=FACTOR_SIZE * 72 / DPI, color=colour,
        markeredgecolor=canvas.theme.ground, markeredgewidth=0.6, zorder=5,
    )  # fmt: skip


def _draw_variables(canvas: _Canvas, graph: Record, shown: set[int]) -> tuple[int, int]:
    """Draw the variables of the shown clusters; how many, and how many of them unconnected."""
    theme, unconnected = canvas.theme, unconnected_variables(graph)
    drawn = [item for item in graph['variables'] if item['cluster'] in shown]
    for item in drawn:
        x, y = canvas.spots[item['key']]
        isolated = item['key'] in unconnected
        canvas.strokes.mark(
            (x, y), marker='o', markersize=canvas.node * 72 / DPI,
            markerfacecolor=theme.unconnected if isolated else theme.node,
            markeredgecolor=theme.unconnected_edge if isolated else theme.ink,
            markeredgewidth=2.2 if isolated else 1.3, zorder=6,
        )  # fmt: skip
        if canvas.node >= SMALLEST_LABELLED_NODE:
            canvas.axes.text(
                x, y, str(item['cluster']), ha='center', va='center_baseline', zorder=7,
                fontsize=canvas.node * (0.33 if item['cluster'] > 99 else 0.4), color=theme.ink,
                clip_on=True,
            )  # fmt: skip
    return len(drawn), sum(item['key'] in unconnected for item in drawn)


def _finish(canvas: _Canvas, start_ns: int, end_ns: int) -> None:
    """Limits, names of the rows and the time axis."""
    axes = canvas.axes
    top = LOWEST_ARC + ARC_STEP * max(len(canvas.lidars) - 1, 0) + 0.3
    axes.set_xlim(canvas.seconds(start_ns), canvas.seconds(end_ns))
    rows = canvas.kinds | canvas.sensors
    axes.set_ylim(min(rows.values()) - 0.45, top)
    axes.set_yticks(list(rows.values()), labels=list(rows))
    axes.set_xlabel('seconds since the first cluster')
    plain(axes, canvas.look)
    axes.tick_params(axis='y', length=0, labelsize=canvas.look.text + 1, pad=12)
    for label, name in zip(axes.get_yticklabels(), rows, strict=True):
        label.set_color(canvas.colours.get(name, canvas.theme.ink))
    for height in rows.values():
        axes.axhline(height, color=canvas.theme.grid, linewidth=0.8, zorder=0)
    for side in ('left', 'right', 'top'):
        axes.spines[side].set_visible(False)
