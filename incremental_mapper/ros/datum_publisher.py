"""Where the map lies on the earth, latched: ``~/datum``."""

import math
from collections.abc import Mapping
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import NavSatFix

from incremental_mapper.ros.rclpy_types import MESSAGES

LATCHED = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)


class DatumPublisher:
    """Publishes the origin of the map as soon as the map is ENU, and when it changes."""

    def __init__(self, node: Node, frame: str) -> None:
        """Begin to publish.

        Args:
            node: Whose topic it is.
            frame: Name of the map's frame.
        """
        self._frame = frame
        self._published: list[float] | None = None
        self._point = geographic_point()
        self._publisher = node.create_publisher(self._point or NavSatFix, '~/datum', LATCHED)

    def take(self, stats: Mapping[str, Any], stamp: int) -> None:
        """Look at the keys of ``stats.json`` after a window that ended at ``stamp`` (ns)."""
        datum: list[float] | None = stats['datum'] if stats['georeferenced'] else None
        if datum is None or datum == self._published:
            return
        self._published = datum
        self._publish(datum, stamp)

    def restart(self) -> None:
        """Take back what late joiners would get: the next map may lie elsewhere."""
        if self._published is not None:
            self._publish([math.nan] * 3, 0)
        self._published = None

    def _publish(self, datum: list[float], stamp: int) -> None:
        if self._point is None:
            self._publisher.publish(MESSAGES.datum(datum, stamp, self._frame))
            return
        latitude, longitude, altitude = datum
        point = self._point(latitude=latitude, longitude=longitude, altitude=altitude)
        self._publisher.publish(point)


def geographic_point() -> Any:
    """The type geographic_msgs/GeoPoint, or None: it is not among the wheels of PyPI."""
    try:
        from geographic_msgs.msg import GeoPoint
    except ImportError:
        return None
    return GeoPoint
