"""The newest part of the graph as markers: poses, factors by kind, merged clusters."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.mapping.live_map import GraphView
from incremental_mapper.results.messages.result_messages import ResultMessages
from incremental_mapper.visualization.factor_colours import (
    CLUSTER_COLOUR,
    FACTOR_COLOURS,
    POSE_COLOUR,
    PRIOR_COLOUR,
)

_POSE_SIZE, _PRIOR_SIZE, _LINE_WIDTH = 0.25, 0.5, 0.06
_BOX_SIZE = (0.7, 0.7, 0.5)
_BOX_OPACITY = 0.4
MARKER = 'visualization_msgs/msg/Marker'


def graph_markers(messages: ResultMessages, view: GraphView, frame: str) -> Any:
    """Everything that is shown of the graph; what was shown before is taken away first.

    Args:
        messages: Makes the messages.
        view: The newest part of the graph.
        frame: Name of the map's frame.
    """

    def marker(
        name: str,
        kind: str,
        points: NDArray[np.float64],
        colour: tuple[float, float, float],
        size: tuple[float, float, float],
        opacity: float = 1.0,
    ) -> Any:
        red, green, blue = colour
        make = messages.types.make
        return make(
            MARKER,
            header=messages.header(view.stamp, frame),
            ns=name,
            type=messages.types.constant(MARKER, kind),
            action=messages.types.constant(MARKER, 'ADD'),
            pose=messages.pose([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
            scale=messages.vector(*size),
            color=make('std_msgs/msg/ColorRGBA', r=red, g=green, b=blue, a=opacity),
            points=[messages.point(x, y, z) for x, y, z in points.tolist()],
        )

    markers = [
        marker('poses', 'SPHERE_LIST', view.poses, POSE_COLOUR, (_POSE_SIZE,) * 3),
        marker('priors', 'CUBE_LIST', view.priors, PRIOR_COLOUR, (_PRIOR_SIZE,) * 3),
    ]
    for kind, ends in sorted(view.edges.items()):
        lines = ends.reshape(-1, 3)
        colour = FACTOR_COLOURS.get(kind, POSE_COLOUR)
        markers.append(marker(kind, 'LINE_LIST', lines, colour, (_LINE_WIDTH,) * 3))
    markers.append(
        marker('clusters', 'CUBE_LIST', view.merged, CLUSTER_COLOUR, _BOX_SIZE, _BOX_OPACITY)
    )
    # RViz complains of lists without points.
    return _array(messages, frame, view.stamp, (item for item in markers if item.points))


def no_markers(messages: ResultMessages, frame: str) -> Any:
    """Takes away all markers."""
    return _array(messages, frame, 0, ())


def _array(messages: ResultMessages, frame: str, stamp: int, markers: Iterable[Any]) -> Any:
    clear = messages.types.make(
        MARKER,
        header=messages.header(stamp, frame),
        action=messages.types.constant(MARKER, 'DELETEALL'),
    )
    return messages.types.make('visualization_msgs/msg/MarkerArray', markers=[clear, *markers])
