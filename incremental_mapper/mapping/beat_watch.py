"""Evidence on the beat of the LiDARs' stamps."""

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from incremental_mapper.checks.finding import Finding
from incremental_mapper.checks.stamp_beat import RUNS, beat_finding, beat_scatter
from incremental_mapper.frontend.front_end import Prepared
from incremental_mapper.frontend.prepared_scan import PreparedScan

RUN = 24
"""Scans of a run."""
MOST = 8 * RUNS
"""Runs of a LiDAR that are looked at: a minute of 10 Hz."""


class BeatWatch:
    """Keeps the stamps of each LiDAR's scans, a run at a time, and asks once there are enough."""

    def __init__(self) -> None:
        self._stamps: defaultdict[str, list[int]] = defaultdict(list)
        self._scatters: defaultdict[str, list[float]] = defaultdict(list)
        self._told: set[str] = set()

    def scans(self, prepared: Sequence[Prepared]) -> list[Finding]:
        """Take in the scans of a window."""
        found = []
        for item in prepared:
            if not isinstance(item, PreparedScan):
                continue
            sensor = item.core.sensor
            if sensor in self._told or len(self._scatters[sensor]) >= MOST:
                continue
            stamps = self._stamps[sensor]
            stamps.append(item.core.stamp)
            if len(stamps) < RUN:
                continue
            scatter = beat_scatter(np.sort(np.array(stamps, dtype=np.int64)))
            stamps.clear()
            if scatter is None:
                continue
            self._scatters[sensor].append(scatter)
            finding = beat_finding(sensor, self._scatters[sensor])
            if finding is not None:
                self._told.add(sensor)
                found.append(finding)
        return found
