"""Picture of a piece of the factor graph over time: variables, clusters, measurements, factors."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from scipy.optimize import isotonic_regression
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

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

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Record: TypeAlias = Mapping[str, Any]
Spot: TypeAlias = tuple[float, float]

ROWS = {'pose': 0.0, 'velocity': -1.2, 'bias': -2.4}
"""Height of each kind of variable; arcs of odometry rise above the poses."""
ROW_NAMES = {'pose': 'X  pose', 'velocity': 'V  velocity', 'bias': 'B  bias'}
FIRST_SENSOR_ROW = -3.5
SENSOR_ROW_STEP = 0.55
LOWEST_ARC, ARC_STEP = 0.75, 0.62
FACTOR_SIZE = 9
"""Side of a factor's square in pixels."""
SMALLEST_LABELLED_NODE = 14


@dataclass(frozen=True, slots=True)
class _Scene:
    """What the drawing steps share: the axes, the scale and where everything is.

    ``places`` and ``spots`` are where clusters (seconds since ``origin``) and variables (the same
    and a height) are drawn; ``origin`` is the stamp of the graph's first cluster in nanoseconds.
    ``node`` is the diameter of a variable in pixels, ``pixel`` the seconds that a pixel is wide.
    ``sensors`` has the heights of the sensors' rows, ``colours`` their colours.
    """

    axes: 'Axes'
    look: Look
    origin: int
    pixel: float
    node: float
    places: dict[int, float]
    spots: dict[str, Spot]
    sensors: dict[str, float]
    lidars: list[str]
    colours: dict[str, str]

    @property
    def theme(self) -> Theme:
        """The colours of the picture."""
        return self.look.theme

    def seconds(self, stamp_ns: int) -> float:
        return (stamp_ns - self.origin) / NANOSECONDS


@dataclass(frozen=True, slots=True)
class Shown:
    """How much of a graph a picture shows; ``loose`` of the ``variables`` are not connected."""

    clusters: int
    variables: int
    factors: int
    loose: int


def draw_graph(path: Path, graph: Record, start_ns: int, end_ns: int, look: Look = WHOLE) -> None:
    """Draw the part of ``graph`` (the layout of graph.json) between two stamps.

    A span of one to two seconds is legible. Variables that no path of factors joins to the
    largest part of the graph are marked. Raises OutputError where matplotlib is missing or the
    file cannot be written, ValueError where the span is empty.
    """
    save(graph_figure(graph, start_ns, end_ns, look)[0], path)


def graph_figure(
    graph: Record, start_ns: int, end_ns: int, look: Look, origin: int | None = None
) -> tuple['Figure', Shown]:
    """The figure that ``draw_graph`` saves, and how much it shows; see ``paint_graph``."""
    figure = new_figure(look)
    margins = (152, 117, 24, 72) if look.heading else (round(11 * look.text), 50, 10, 8)
    axes = figure.add_axes(box(look, *margins))
    origin = first_stamp(graph, start_ns) if origin is None else origin
    shown = paint_graph(axes, graph, start_ns, end_ns, look, origin)
    span = [f'{(stamp - origin) / NANOSECONDS:.2f} s' for stamp in (start_ns, end_ns)]
    facts = f'{shown.clusters} clusters, {shown.variables} variables, {shown.factors} factors'
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
    """Draw a piece of a graph into axes, and a row of IMU samples where their stamps are given.

    ``origin`` is the stamp (ns) of second 0, by default that of the first cluster, which differs
    between graphs of one drive. Raises ValueError where the span is empty.
    """
    if end_ns <= start_ns:
        raise ValueError(f'the span from {start_ns} to {end_ns} is empty')
    clusters = [item for item in graph['clusters'] if start_ns <= item['stamp_ns'] <= end_ns]
    if origin is None:
        origin = first_stamp(graph, start_ns)
    scene = _make_scene(axes, look, graph, clusters, (start_ns, end_ns), origin)
    if len(imu_stamps):
        _draw_samples(scene, imu_stamps)
    _draw_clusters(scene, clusters)
    shown = {item['id'] for item in clusters}
    factors = _draw_factors(scene, graph, shown)
    variables, loose = _draw_variables(scene, graph, shown)
    _finish(scene, start_ns, end_ns)
    return Shown(len(clusters), variables, factors, loose)


def first_stamp(graph: Record, default: int) -> int:
    """Stamp of the first cluster in nanoseconds."""
    return min((int(item['stamp_ns']) for item in graph['clusters']), default=default)


def _make_scene(
    axes: 'Axes',
    look: Look,
    graph: Record,
    clusters: Sequence[Record],
    span: tuple[int, int],
    origin: int,
) -> _Scene:
    start_ns, end_ns = span
    # Sensors of the whole graph, so that pictures of different spans have the same rows.
    lidars, others = _sensors(graph)
    rows = {
        name: FIRST_SENSOR_ROW - SENSOR_ROW_STEP * row for row, name in enumerate(lidars + others)
    }
    colours = _sensor_colours(lidars, others, look.theme)
    pixel = (end_ns - start_ns) / NANOSECONDS / axes_pixels(axes)[0]
    stamps = np.array(sorted(item['stamp_ns'] for item in clusters), dtype=np.int64)
    gaps = np.diff(stamps) / NANOSECONDS / pixel
    # The few pairs that are closer than this are moved apart.
    node = float(np.clip(np.percentile(gaps, 15) * 0.9 if len(gaps) else 24.0, 9.0, 24.0))
    # In a span too crowded for its nodes they overlap, rather than wander off their stamps.
    crowded = 0.7 * (end_ns - start_ns) / NANOSECONDS / max(len(clusters), 1)
    places = _spread(graph['clusters'], origin, min(node * 0.95 * pixel, crowded))
    spots = {
        item['key']: (places[item['cluster']], ROWS[item['kind']]) for item in graph['variables']
    }
    return _Scene(axes, look, origin, pixel, node, places, spots, rows, lidars, colours)


def _sensors(graph: Record) -> tuple[list[str], list[str]]:
    """Names of the LiDARs and of the other sensors, sorted."""
    kinds = {
        member['sensor']: member['kind'] for item in graph['clusters'] for member in item['members']
    }
    lidars = sorted(name for name, kind in kinds.items() if kind == 'lidar')
    return lidars, sorted(kinds.keys() - set(lidars))


def _sensor_colours(lidars: Sequence[str], others: Sequence[str], theme: Theme) -> dict[str, str]:
    palette = theme.lidars
    colours = {name: palette[index % len(palette)] for index, name in enumerate(lidars)}
    return colours | {name: theme.green for name in others}


def _spread(clusters: Sequence[Record], origin: int, gap: float) -> dict[int, float]:
    """Seconds at which the clusters' variables are drawn: their stamps, ``gap`` apart at least.

    Groups of close clusters are spread about their common centre.
    """
    ordered = sorted(clusters, key=lambda item: int(item['stamp_ns']))
    # Less the gaps before it, a cluster may stand where the next one does: what is left is to
    # find the ascending sequence nearest to the wanted one, which isotonic regression does.
    room = gap * np.arange(len(ordered))
    wanted = np.array([(item['stamp_ns'] - origin) / NANOSECONDS for item in ordered]) - room
    placed = isotonic_regression(wanted).x + room if len(ordered) > 0 else wanted
    return {item['id']: float(x) for item, x in zip(ordered, placed, strict=True)}


def _draw_samples(scene: _Scene, stamps: Sequence[int]) -> None:
    """A row of ticks below the other sensors."""
    low = min(scene.sensors.values(), default=FIRST_SENSOR_ROW)
    scene.sensors['imu'] = low - SENSOR_ROW_STEP
    scene.colours['imu'] = scene.theme.orange
    scene.axes.vlines(
        [scene.seconds(stamp) for stamp in stamps], scene.sensors['imu'] - 0.16,
        scene.sensors['imu'] + 0.16, color=scene.theme.orange, linewidth=2.4, zorder=4,
    )  # fmt: skip


def _draw_clusters(scene: _Scene, clusters: Sequence[Record]) -> None:
    """Boxes from the first to the last member, and the members at their own stamps."""
    from matplotlib.patches import FancyBboxPatch

    ordered = sorted(clusters, key=lambda item: int(item['stamp_ns']))
    bottom = min(scene.sensors.values(), default=ROWS['bias']) - 0.3
    half = scene.node * 0.68 * scene.pixel
    edges = [
        (
            min(scene.seconds(item['first_ns']), scene.places[item['id']]) - half,
            max(scene.seconds(item['last_ns']), scene.places[item['id']]) + half,
        )
        for item in ordered
    ]
    for index, item in enumerate(ordered):
        left, right = edges[index]
        # Boxes of clusters that are nearer than a node is wide share the room between them.
        if index > 0 and edges[index - 1][1] > left:
            left = (edges[index - 1][1] + left) / 2 + scene.pixel
        if index + 1 < len(edges) and edges[index + 1][0] < right:
            right = (edges[index + 1][0] + right) / 2 - scene.pixel
        box = FancyBboxPatch(
            (left, bottom), right - left, 0.42 - bottom, boxstyle='square,pad=0',
            facecolor=(scene.theme.even, scene.theme.odd)[item['window'] % 2],
            edgecolor=scene.theme.edge, linewidth=1.0, zorder=1,
        )  # fmt: skip
        scene.axes.add_patch(box)
        for member in item['members']:
            scene.axes.plot(
                scene.seconds(member['stamp_ns']), scene.sensors[member['sensor']], linestyle='',
                marker='D' if member['kind'] == 'lidar' else '^', markersize=7,
                color=scene.colours[member['sensor']], zorder=4,
            )  # fmt: skip


def _draw_factors(scene: _Scene, graph: Record, shown: set[int]) -> int:
    """Draw the factors that touch a shown cluster; returns how many there are."""
    cluster_of = {item['key']: item['cluster'] for item in graph['variables']}
    above = {name: LOWEST_ARC + ARC_STEP * index for index, name in enumerate(scene.lidars)}
    fixes: Counter[str] = Counter()
    drawn = 0
    for factor in graph['factors']:
        keys, kind = factor['variables'], factor['kind']
        if not any(cluster_of[key] in shown for key in keys):
            continue
        drawn += 1
        spots = [scene.spots[key] for key in keys]
        if kind == 'odometry':
            _draw_arc(scene, spots, scene.colours[factor['sensor']], above[factor['sensor']])
        elif kind == 'imu':
            hub = ((min(x for x, _ in spots) + max(x for x, _ in spots)) / 2, ROWS['velocity'])
            _draw_star(scene, hub, spots, scene.theme.orange)
        elif kind == 'gnss':
            # Several fixes of one pose stand side by side.
            shift = fixes[keys[0]] * FACTOR_SIZE * 1.3 * scene.pixel
            _draw_star(scene, (spots[0][0] + shift, spots[0][1] - 0.56), spots, scene.theme.green)
            fixes[keys[0]] += 1
        elif len(spots) == 1:
            shift = (scene.node / 2 + FACTOR_SIZE * 1.3) * scene.pixel
            _draw_star(scene, (spots[0][0] - shift, spots[0][1]), spots, scene.theme.ink)
        else:
            x, y = np.mean(spots, axis=0)
            _draw_star(scene, (float(x), float(y)), spots, scene.theme.grey)
    return drawn


def _draw_arc(scene: _Scene, spots: Sequence[Spot], colour: str, height: float) -> None:
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Curve

    (x0, y0), (x1, y1) = spots
    lift = height * 4 / 3  # a cubic curve reaches three quarters of its control points' height
    inset = (x1 - x0) * 0.12
    points = [(x0, y0), (x0 + inset, y0 + lift), (x1 - inset, y1 + lift), (x1, y1)]
    curve = Curve(points, [Curve.MOVETO, Curve.CURVE4, Curve.CURVE4, Curve.CURVE4])
    scene.axes.add_patch(
        PathPatch(curve, facecolor='none', edgecolor=colour, linewidth=1.6, zorder=2)
    )
    _draw_square(scene, ((x0 + x1) / 2, (y0 + y1) / 2 + height), colour)


def _draw_star(scene: _Scene, centre: Spot, spots: Sequence[Spot], colour: str) -> None:
    """A factor at ``centre`` with a line to each of its variables."""
    for x, y in spots:
        scene.axes.plot(
            [centre[0], x], [centre[1], y], color=colour, linewidth=1.1, alpha=0.8, zorder=2
        )
    _draw_square(scene, centre, colour)


def _draw_square(scene: _Scene, centre: Spot, colour: str) -> None:
    scene.axes.plot(
        *centre, linestyle='', marker='s', markersize=FACTOR_SIZE * 72 / DPI, color=colour,
        markeredgecolor=scene.theme.ground, markeredgewidth=0.6, zorder=5,
    )  # fmt: skip


def _draw_variables(scene: _Scene, graph: Record, shown: set[int]) -> tuple[int, int]:
    """Draw the variables of the shown clusters; how many there are, and how many are loose."""
    theme, loose = scene.theme, loose_variables(graph)
    drawn = [item for item in graph['variables'] if item['cluster'] in shown]
    for item in drawn:
        x, y = scene.spots[item['key']]
        isolated = item['key'] in loose
        scene.axes.plot(
            x, y, linestyle='', marker='o', markersize=scene.node * 72 / DPI,
            markerfacecolor=theme.loose if isolated else theme.node,
            markeredgecolor=theme.loose_edge if isolated else theme.ink,
            markeredgewidth=2.2 if isolated else 1.3, zorder=6,
        )  # fmt: skip
        if scene.node >= SMALLEST_LABELLED_NODE:
            scene.axes.text(
                x, y, str(item['cluster']), ha='center', va='center_baseline', zorder=7,
                fontsize=scene.node * (0.33 if item['cluster'] > 99 else 0.4), color=theme.ink,
                clip_on=True,
            )  # fmt: skip
    return len(drawn), sum(item['key'] in loose for item in drawn)


def loose_variables(graph: Record) -> set[str]:
    """Keys of the variables that no path of factors joins to the largest part of the graph."""
    keys = [item['key'] for item in graph['variables']]
    number = {key: index for index, key in enumerate(keys)}
    edges = [
        (number[factor['variables'][0]], number[key])
        for factor in graph['factors']
        for key in factor['variables'][1:]
    ]
    if not keys:
        return set()
    ends = np.array(edges, dtype=np.int64).reshape(-1, 2)
    links = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(len(keys),) * 2)
    part = connected_components(links, directed=False)[1]
    largest = int(np.bincount(part).argmax())
    return {key for key, own in zip(keys, part, strict=True) if own != largest}


def _finish(scene: _Scene, start_ns: int, end_ns: int) -> None:
    """Limits, names of the rows and the time axis."""
    axes = scene.axes
    top = LOWEST_ARC + ARC_STEP * max(len(scene.lidars) - 1, 0) + 0.3
    axes.set_xlim(scene.seconds(start_ns), scene.seconds(end_ns))
    axes.set_ylim(min(scene.sensors.values(), default=ROWS['bias']) - 0.45, top)
    rows = {ROW_NAMES[kind]: height for kind, height in ROWS.items()} | scene.sensors
    axes.set_yticks(list(rows.values()), labels=list(rows))
    axes.set_xlabel('seconds since the first cluster')
    plain(axes, scene.look)
    axes.tick_params(axis='y', length=0, labelsize=scene.look.text + 1, pad=12)
    for label, name in zip(axes.get_yticklabels(), rows, strict=True):
        label.set_color(scene.colours.get(name, scene.theme.ink))
    for height in rows.values():
        axes.axhline(height, color=scene.theme.grid, linewidth=0.8, zorder=0)
    for side in ('left', 'right', 'top'):
        axes.spines[side].set_visible(False)


def graph_legend(graphs: Sequence[Record], theme: Theme) -> list[tuple[str, str, str, str]]:
    """What pictures of the graphs show: label, shape (node, factor or box), fill and edge."""
    kinds = {factor['kind'] for graph in graphs for factor in graph['factors']}
    lidars = sorted({name for graph in graphs for name in _sensors(graph)[0]})
    colours = _sensor_colours(lidars, [], theme)
    factors = [(f'odometry {name}', colours[name]) for name in lidars]
    factors += [('IMU', theme.orange)] if 'imu' in kinds else []
    factors += [('GNSS', theme.green)] if 'gnss' in kinds else []
    factors += [('prior', theme.ink)] if any(kind.startswith('prior') for kind in kinds) else []
    factors += [('bridge', theme.grey)] if 'bridge' in kinds else []
    nodes = [('variable', 'node', theme.node, theme.ink)]
    if any(loose_variables(graph) for graph in graphs):
        nodes.append(('not connected', 'node', theme.loose, theme.loose_edge))
    return [
        *nodes,
        *((label, 'factor', colour, colour) for label, colour in factors),
        ('cluster, even window', 'box', theme.even, theme.edge),
        ('cluster, odd window', 'box', theme.odd, theme.edge),
    ]


def add_graph_legend(figure: 'Figure', graphs: Sequence[Record], look: Look) -> None:
    """What the graphs hold, in one row at the bottom of the figure."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Line2D | Patch] = []
    for label, shape, fill, edge in graph_legend(graphs, look.theme):
        if shape == 'box':
            handles.append(Patch(facecolor=fill, edgecolor=edge, label=label))
        elif shape == 'factor':
            handles.append(
                Line2D([], [], color=fill, marker='s', markersize=7, linewidth=1.6, label=label)
            )
        else:
            handles.append(
                Line2D(
                    [], [], linestyle='', marker='o', markersize=11, markerfacecolor=fill,
                    markeredgecolor=edge, label=label,
                )
            )  # fmt: skip
    figure.legend(
        handles=handles, loc='lower center', ncols=12, frameon=False, fontsize=look.text - 1,
        handlelength=1.8, columnspacing=1.4, bbox_to_anchor=(0.5, 0.005),
        labelcolor=look.theme.ink,
    )  # fmt: skip
