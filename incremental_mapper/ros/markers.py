"""The newest part of the graph as markers: poses, factors by kind, merged clusters."""

from collections.abc import Iterable

import numpy as np
from geometry_msgs.msg import Point, Vector3
from numpy.typing import NDArray
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from incremental_mapper.graph.factors import FactorKind
from incremental_mapper.ros.live_map import GraphView
from incremental_mapper.ros.result_messages import header

_COLOURS = {
    str(FactorKind.ODOMETRY): (0.9, 0.6, 0.0),
    str(FactorKind.IMU): (0.35, 0.7, 0.9),
    str(FactorKind.GNSS): (0.0, 0.6, 0.5),
    str(FactorKind.BRIDGE): (0.8, 0.2, 0.2),
}
_POSE_COLOUR = (0.1, 0.1, 0.1)
_PRIOR_COLOUR = (0.8, 0.5, 0.7)
_BOX_COLOUR = (0.0, 0.45, 0.7)
_POSE_SIZE, _PRIOR_SIZE, _LINE_WIDTH = 0.25, 0.5, 0.06
_BOX_SIZE = (0.7, 0.7, 0.5)
_BOX_OPACITY = 0.4


def graph_markers(view: GraphView, frame: str) -> MarkerArray:
    """Everything that is shown of the graph; what was shown before is taken away first."""
    markers = [
        _marker(view, frame, 'poses', Marker.SPHERE_LIST, view.poses, _POSE_COLOUR, _POSE_SIZE),
        _marker(view, frame, 'priors', Marker.CUBE_LIST, view.priors, _PRIOR_COLOUR, _PRIOR_SIZE),
    ]
    for kind, ends in sorted(view.edges.items()):
        lines = ends.reshape(-1, 3)
        colour = _COLOURS.get(kind, _POSE_COLOUR)
        markers.append(_marker(view, frame, kind, Marker.LINE_LIST, lines, colour, _LINE_WIDTH))
    boxes = _marker(view, frame, 'clusters', Marker.CUBE_LIST, view.merged, _BOX_COLOUR, 1.0)
    boxes.scale = Vector3(**dict(zip('xyz', _BOX_SIZE, strict=True)))
    boxes.color.a = _BOX_OPACITY
    markers.append(boxes)
    # RViz complains of lists without points.
    return _array(frame, view.stamp, (marker for marker in markers if marker.points))


def no_markers(frame: str) -> MarkerArray:
    """Takes away all markers."""
    return _array(frame, 0, ())


def _array(frame: str, stamp: int, markers: Iterable[Marker]) -> MarkerArray:
    clear = Marker(header=header(stamp, frame), action=Marker.DELETEALL)
    return MarkerArray(markers=[clear, *markers])


def _marker(
    view: GraphView,
    frame: str,
    name: str,
    kind: int,
    points: NDArray[np.float64],
    colour: tuple[float, float, float],
    size: float,
) -> Marker:
    red, green, blue = colour
    marker = Marker(
        header=header(view.stamp, frame),
        ns=name,
        id=0,
        type=kind,
        action=Marker.ADD,
        scale=Vector3(x=size, y=size, z=size),
        color=ColorRGBA(r=red, g=green, b=blue, a=1.0),
        points=[Point(x=x, y=y, z=z) for x, y, z in points.tolist()],
    )
    marker.pose.orientation.w = 1.0
    return marker
