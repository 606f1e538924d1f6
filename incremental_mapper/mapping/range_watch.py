"""Evidence on how far away the points of each LiDAR are."""

from collections import defaultdict

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding
from incremental_mapper.checks.point_ranges import CLOUDS, far_points, point_ranges
from incremental_mapper.config import Config
from incremental_mapper.measurements import LidarScan

EVERY = 5
"""One of so many scans is looked at: neighbours see the same."""


class RangeWatch:
    """Looks at a few of the first clouds of each LiDAR."""

    def __init__(self, config: Config) -> None:
        self._scales = {name: lidar.scale for name, lidar in config.lidars.items()}
        self._looks: defaultdict[str, list[NDArray[np.float64]]] = defaultdict(list)
        self._scans: defaultdict[str, int] = defaultdict(int)

    def scan(self, scan: LidarScan) -> Finding | None:
        """Take in a scan as the message has it; tells once there are enough of them."""
        looks = self._looks[scan.sensor]
        if len(looks) >= CLOUDS:
            return None
        self._scans[scan.sensor] += 1
        if self._scans[scan.sensor] % EVERY:
            return None
        ranges = point_ranges(scan.points)
        if ranges is None:
            return None
        looks.append(ranges * self._scales.get(scan.sensor, 1.0))
        return far_points(scan.sensor, looks) if len(looks) == CLOUDS else None
