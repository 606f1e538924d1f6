"""The pictures that lie in a run's folder: trajectory, map from above, a stretch of the graph."""

from collections.abc import Mapping
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


def draw_run(
    folder: Path,
    trajectory: Trajectory,
    truth: Trajectory | None,
    fixes: NDArray[np.float64],
    points: NDArray[np.float32],
    graph: Mapping[str, Any],
    georeferenced: bool = False,
) -> None:
    """Write ``trajectory.png``, ``map.png`` and ``graph.png``, where matplotlib is installed.

    Args:
        folder: An existing folder.
        trajectory: The estimate.
        truth: The true trajectory, in any map frame, where there is one.
        fixes: Antenna positions (K, 3) that were used, metres in the map.
        points: The map (N, 3) in metres.
        graph: The layout of ``graph.json``.
        georeferenced: Whether x is east and y north.

    Raises:
        OutputError: A file cannot be written.
    """
    if not importable('pictures'):
        return
    place = georeferenced
    draw_trajectory(
        folder / 'trajectory.png',
        trajectory,
        truth,
        fixes,
        georeferenced=place,
        closures=closure_ends(graph),
    )
    draw_map(folder / 'map.png', points, trajectory, georeferenced=place)
    draw_graph(folder / 'graph.png', graph, *typical_stretch(graph, GRAPH_SECONDS))
