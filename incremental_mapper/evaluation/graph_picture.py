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

from incremental_mapper.evaluation.pictures import (
    BLUE,
    DPI,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PURPLE,
    SKY,
    VERMILLION,
    WIDTH_PX,
    new_figure,
    plain,
    save,
    title,
)
from incremental_mapper.trajectory import NANOSECONDS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Record: TypeAlias = Mapping[str, Any]
Spot: TypeAlias = tuple[float, float]

ROWS = {'pose': 0.0, 'velocity': -1.2, 'bias': -2.4}
"""Height of each kind of variable; arcs of odometry rise above the poses."""
ROW_NAMES = {'pose': 'X  pose', 'velocity': 'V  velocity', 'bias': 'B  bias'}
FIRST_SENSOR_ROW = -3.5
SENSOR_ROW_STEP = 0.55
LOWEST_ARC, ARC_STEP = 0.75, 0.62
LIDAR_COLOURS = (BLUE, VERMILLION, PURPLE, SKY)
GNSS_COLOUR = GREEN
IMU_COLOUR = ORANGE
BOX_COLOURS = ('#E4EDF5', '#F3EEDF')
"""Fill of the cluster boxes in even and odd windows."""
LOOSE_FILL, LOOSE_EDGE = '#FBD5D5', '#B2182B'
FACTOR_SIZE = 9
"""Side of a factor's square in pixels."""
SMALLEST_LABELLED_NODE = 16
LEFT, BOTTOM, WIDTH, HEIGHT = 0.095, 0.13, 0.89, 0.79


@dataclass(frozen=True, slots=True)
class _Scene:
    """What the drawing steps share: the axes, the scale and where everything is.

    ``places`` and ``spots`` are where clusters (seconds since ``origin``) and variables (the same
    and a height) are drawn; ``origin`` is the stamp of the graph's first cluster in nanoseconds.
    ``node`` is the diameter of a variable in pixels, ``pixel`` the seconds that a pixel is wide.
    ``sensors`` has the heights of the sensors' rows.
    """

    axes: 'Axes'
    origin: int
    pixel: float
    node: float
    places: dict[int, float]
    spots: dict[str, Spot]
    sensors: dict[str, float]
    lidars: list[str]
    colours: dict[str, str]

    def seconds(self, stamp_ns: int) -> float:
        return (stamp_ns - self.origin) / NANOSECONDS


def draw_graph(path: Path, graph: Record, start_ns: int, end_ns: int) -> None:
    """Draw the part of ``graph`` (the layout of graph.json) between two stamps.

    A span of one to two seconds is legible. Variables that no path of factors joins to the
    largest part of the graph are marked. Raises OutputError where matplotlib is missing or the
    file cannot be written, ValueError where the span is empty.
    """
    if end_ns <= start_ns:
        raise ValueError(f'the span from {start_ns} to {end_ns} is empty')
    figure = new_figure()
    axes = figure.add_axes((LEFT, BOTTOM, WIDTH, HEIGHT))
    clusters = [item for item in graph['clusters'] if start_ns <= item['stamp_ns'] <= end_ns]
    scene = _make_scene(axes, graph, clusters, start_ns, end_ns)
    _draw_clusters(scene, clusters)
    shown = {item['id'] for item in clusters}
    factors = _draw_factors(scene, graph, shown)
    variables = _draw_variables(scene, graph, shown)
    _finish(scene, start_ns, end_ns)
    title(
        figure,
        'Factor graph',
        f'{len(clusters)} clusters, {variables} variables, {factors} factors between '
        f'{scene.seconds(start_ns):.2f} s and {scene.seconds(end_ns):.2f} s',
    )
    _add_legend(scene, graph)
    save(figure, path)


def _make_scene(
    axes: 'Axes', graph: Record, clusters: Sequence[Record], start_ns: int, end_ns: int
) -> _Scene:
    origin = min((item['stamp_ns'] for item in graph['clusters']), default=start_ns)
    # Sensors of the whole graph, so that pictures of different spans have the same rows.
    kinds = {
        member['sensor']: member['kind'] for item in graph['clusters'] for member in item['members']
    }
    lidars = sorted(name for name, kind in kinds.items() if kind == 'lidar')
    others = sorted(name for name, kind in kinds.items() if kind != 'lidar')
    rows = {
        name: FIRST_SENSOR_ROW - SENSOR_ROW_STEP * row for row, name in enumerate(lidars + others)
    }
    colours = {name: LIDAR_COLOURS[index % len(LIDAR_COLOURS)] for index, name in enumerate(lidars)}
    colours.update({name: GNSS_COLOUR for name in others})
    pixel = (end_ns - start_ns) / NANOSECONDS / (WIDTH * WIDTH_PX)
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
    return _Scene(axes, origin, pixel, node, places, spots, rows, lidars, colours)


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
            facecolor=BOX_COLOURS[item['window'] % 2], edgecolor='#A9B7C4', linewidth=1.0, zorder=1,
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
            _draw_star(scene, hub, spots, IMU_COLOUR)
        elif kind == 'gnss':
            # Several fixes of one pose stand side by side.
            shift = fixes[keys[0]] * FACTOR_SIZE * 1.3 * scene.pixel
            _draw_star(scene, (spots[0][0] + shift, spots[0][1] - 0.56), spots, GNSS_COLOUR)
            fixes[keys[0]] += 1
        elif len(spots) == 1:
            shift = (scene.node / 2 + FACTOR_SIZE * 1.3) * scene.pixel
            _draw_star(scene, (spots[0][0] - shift, spots[0][1]), spots, INK)
        else:
            x, y = np.mean(spots, axis=0)
            _draw_star(scene, (float(x), float(y)), spots, GREY)
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
        markeredgecolor='white', markeredgewidth=0.6, zorder=5,
    )  # fmt: skip


def _draw_variables(scene: _Scene, graph: Record, shown: set[int]) -> int:
    """Draw the variables of the shown clusters; returns how many there are."""
    loose = loose_variables(graph)
    drawn = [item for item in graph['variables'] if item['cluster'] in shown]
    for item in drawn:
        x, y = scene.spots[item['key']]
        isolated = item['key'] in loose
        scene.axes.plot(
            x, y, linestyle='', marker='o', markersize=scene.node * 72 / DPI,
            markerfacecolor=LOOSE_FILL if isolated else 'white',
            markeredgecolor=LOOSE_EDGE if isolated else INK,
            markeredgewidth=1.8 if isolated else 1.3, zorder=6,
        )  # fmt: skip
        if scene.node >= SMALLEST_LABELLED_NODE:
            scene.axes.text(
                x, y, str(item['cluster']), ha='center', va='center_baseline', zorder=7,
                fontsize=scene.node * (0.33 if item['cluster'] > 99 else 0.4), color=INK,
                clip_on=True,
            )  # fmt: skip
    return len(drawn)


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
    axes.set_xlabel('seconds since the first cluster', fontsize=12)
    plain(axes)
    axes.tick_params(axis='y', length=0, labelsize=13, pad=12)
    for label, name in zip(axes.get_yticklabels(), rows, strict=True):
        label.set_color(scene.colours.get(name, INK))
    for height in rows.values():
        axes.axhline(height, color='#E9E9E9', linewidth=0.8, zorder=0)
    for side in ('left', 'right', 'top'):
        axes.spines[side].set_visible(False)


def _add_legend(scene: _Scene, graph: Record) -> None:
    """What the graph holds, in one row below the time axis."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    kinds = {factor['kind'] for factor in graph['factors']}
    squares = [(f'odometry {name}', scene.colours[name]) for name in scene.lidars]
    squares += [('IMU', IMU_COLOUR)] if 'imu' in kinds else []
    squares += [('GNSS', GNSS_COLOUR)] if 'gnss' in kinds else []
    squares += [('prior', INK)] if any(kind.startswith('prior') for kind in kinds) else []
    squares += [('bridge', GREY)] if 'bridge' in kinds else []
    nodes = [('variable', 'white', INK)]
    nodes += [('not connected', LOOSE_FILL, LOOSE_EDGE)] if loose_variables(graph) else []
    circle = [
        Line2D(
            [], [], linestyle='', marker='o', markersize=11, markerfacecolor=fill,
            markeredgecolor=edge, label=label,
        )
        for label, fill, edge in nodes
    ]  # fmt: skip
    square = [
        Line2D([], [], color=colour, marker='s', markersize=7, linewidth=1.6, label=label)
        for label, colour in squares
    ]
    boxes = [
        Patch(facecolor=colour, edgecolor='#A9B7C4', label=f'cluster, {name} window')
        for colour, name in zip(BOX_COLOURS, ('even', 'odd'), strict=True)
    ]
    scene.axes.get_figure(root=True).legend(  # type: ignore[union-attr]
        handles=[*circle, *square, *boxes], loc='lower center', ncols=12, frameon=False,
        fontsize=11, handlelength=1.8, columnspacing=1.4, bbox_to_anchor=(0.5, 0.005),
    )  # fmt: skip
