"""The LiDARs' scans in metres, without those that a driver repeats or that another one sent."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from incremental_mapper.config import LidarSensor
from incremental_mapper.measurements import NANOSECONDS, Drops, LidarScan

GUESSED = frozenset({'field_names', 'wrong_layout'})
"""Remarks on clouds that were not read as they are labelled."""
SILENT = NANOSECONDS
"""Nanoseconds without a cloud that says what it is, after which a driver may have been changed."""


class ScanIntake:
    """Takes in scans one by one; ``drops`` counts those that are not used, by reason.

    No LiDAR measures the same number twice at thousands of points: a driver that lost its sensor
    sends its last cloud on. Matched, it would say that the car stands. Where a simulated LiDAR
    without noise stands, nothing is lost with the copies.

    Nor does a driver change its layout from cloud to cloud: where clouds are labelled properly, one
    that had to be guessed is another's, and a fragment of them beside a sweep would be matched.
    """

    def __init__(self, lidars: Mapping[str, LidarSensor] = {}) -> None:
        """Make ready for the first scan.

        Args:
            lidars: The settings of each LiDAR, which tell what its points are multiplied by.
        """
        self.drops: Drops = Counter()
        self._scales = {name: one.scale for name, one in lidars.items() if one.scale != 1.0}
        self._last: dict[str, LidarScan] = {}
        self._labelled: dict[str, int] = {}  # stamp of the newest cloud that says what it is

    def take(self, scan: LidarScan) -> LidarScan | None:
        """A scan in metres; None where it repeats the one before, or is of another layout."""
        if any(remark.reason in GUESSED for remark in scan.remarks):
            labelled = self._labelled.get(scan.sensor)
            if labelled is not None and abs(scan.stamp - labelled) < SILENT:
                self.drops[scan.sensor, 'other_layout'] += 1
                return None
        else:
            self._labelled[scan.sensor] = scan.stamp
        last = self._last.get(scan.sensor)
        if last is not None and scan.stamp != last.stamp and _same(scan, last):
            self.drops[scan.sensor, 'repeated_cloud'] += 1
            return None
        self._last[scan.sensor] = scan
        scale = self._scales.get(scan.sensor)
        return scan if scale is None else replace(scan, points=scan.points * np.float32(scale))


def _same(scan: LidarScan, last: LidarScan) -> bool:
    if scan.points.shape != last.points.shape or not len(scan.points):
        return False
    # A few points tell nearly always, at no cost.
    few = slice(None, None, max(len(scan.points) // 8, 1))
    return bool(
        np.array_equal(scan.points[few], last.points[few])
        and np.array_equal(scan.points, last.points)
    )
