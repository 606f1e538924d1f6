"""The pictures that lie in a run's folder: trajectory, map from above, a stretch of the graph."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.trajectory import Trajectory
from incremental_mapper.visualization.extras import importable
from incremental_mapper.visualization.graph_picture import draw_graph
from incremental_mapper.visualization.graph_view import (
    GRAPH_SECONDS,
    closure_ends,
    typical_stretch,
)
from incremental_mapper.visualization.pictures import draw_map, draw_trajectory


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """What the pictures of a run show.

    Attributes:
        trajectory: The estimate.
        truth: The true trajectory, in any map frame, where there is one.
        fixes: Antenna positions (K, 3) that were used, metres in the map.
        points: As many points (N, 3) of the map as are drawn, metres; see ``drawn_points``.
        count: How many points the map has.
        graph: The layout of ``graph.json``.
        georeferenced: Whether x is east and y north.
    """

    trajectory: Trajectory
    truth: Trajectory | None
    fixes: NDArray[np.float64]
    points: NDArray[np.floating]
    count: int
    graph: Mapping[str, Any]
    georeferenced: bool


def draw_run(folder: Path, shown: Shown) -> bool:
    """Write ``trajectory.png``, ``map.png`` and ``graph.png``, where matplotlib is installed.

    Args:
        folder: An existing folder.
        shown: What is drawn.

    Returns:
        Whether matplotlib is installed, and works.

    Raises:
        OutputError: A file cannot be written.
    """
    if not importable('pictures'):
        return False
    place, trajectory, graph = shown.georeferenced, shown.trajectory, shown.graph
    draw_trajectory(
        folder / 'trajectory.png',
        trajectory,
        shown.truth,
        shown.fixes,
        georeferenced=place,
        closures=closure_ends(graph),
    )
    draw_map(folder / 'map.png', shown.points, trajectory, georeferenced=place, count=shown.count)
    draw_graph(folder / 'graph.png', graph, *typical_stretch(graph, GRAPH_SECONDS))
    return True
