"""What the colours and shapes in pictures of a graph stand for."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from incremental_mapper.visualization.figure import Look, Theme
from incremental_mapper.visualization.graph_view import Record, sensor_names, unconnected_variables

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend


WIDEST = 0.98
"""Share of a picture's width that a legend may have; a longer one gets smaller letters."""
TRIES = 5
LOOSE = {
    'bridge': 'bridge',
    'imu_part': 'part of an IMU span',
    'dead_reckoning': 'dead reckoning',
    'continuity_velocity': 'velocity goes on',
    'continuity_bias': 'bias walks',
}
"""What grey factors are."""


def graph_legend(graphs: Sequence[Record], theme: Theme) -> list[tuple[str, str, str, str]]:
    """What pictures of some graphs show.

    Args:
        graphs: Graphs with the layout of ``graph.json``.
        theme: The colours of the pictures.

    Returns:
        For each kind of thing its label, its shape (node, factor or box), its fill and its edge.
    """
    kinds = {factor['kind'] for graph in graphs for factor in graph['factors']}
    lidars = sorted({name for graph in graphs for name in sensor_names(graph)[0]})
    colours = sensor_colours(lidars, [], theme)
    factors = [(f'odometry {name}', colours[name]) for name in lidars]
    factors += [('IMU', theme.orange)] if 'imu' in kinds else []
    factors += [('GNSS', theme.green)] if 'gnss' in kinds else []
    factors += [('prior', theme.ink)] if any(kind.startswith('prior') for kind in kinds) else []
    loose = [label for name, label in LOOSE.items() if name in kinds]
    factors += [(', '.join(loose), theme.grey)] if loose else []
    factors += [('closure', theme.unconnected_edge)] if 'closure' in kinds else []
    nodes = [('variable', 'node', theme.node, theme.ink)]
    if any(unconnected_variables(graph) for graph in graphs):
        nodes.append(('not connected', 'node', theme.unconnected, theme.unconnected_edge))
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

    def row(text: float) -> 'Legend':
        return figure.legend(
            handles=handles, loc='lower center', ncols=len(handles), frameon=False, fontsize=text,
            handlelength=1.8, columnspacing=1.4, bbox_to_anchor=(0.5, 0.005),
            labelcolor=look.theme.ink,
        )  # fmt: skip

    # Letters are drawn on whole pixels: half the size is not half as wide.
    text, share = float(look.text - 1), 1.0
    for _ in range(TRIES):
        text *= min(1.0, WIDEST / share)
        legend = row(text)
        share = legend.get_window_extent().width / figure.bbox.width
        if share <= 1.0:
            return
        legend.remove()
    row(text * WIDEST / share)


def sensor_colours(lidars: Sequence[str], others: Sequence[str], theme: Theme) -> dict[str, str]:
    """A colour for each sensor by its name: LiDARs have one each, the others share one."""
    palette = theme.lidars
    colours = {name: palette[index % len(palette)] for index, name in enumerate(lidars)}
    return colours | {name: theme.green for name in others}
