"""Evidence on where the antenna is: the newest fixes beside odometry, and the car's heading."""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.antenna_place import FEWEST, TurningTrack, antenna_finding
from incremental_mapper.checks.finding import Finding
from incremental_mapper.checks.fix_shape import metres
from incremental_mapper.frontend.fix_tracks import Entry

APART = 1.0
"""Metres of way from one fix that is kept to the next."""
MOST = 80
"""Fixes that are kept: a minute at 1 Hz, in which odometry turns little away. What is found
among the first of them counts at once: later, a live map would be given up for it."""
EACH = 40
"""Fixes from one look to the next."""


class AntennaWatch:
    """Keeps the newest fixes that agree with each other and with odometry."""

    def __init__(self, lever_arm: NDArray[np.float64]) -> None:
        """Begin without a fix.

        Args:
            lever_arm: The antenna in base_link (3,), metres.
        """
        self._arm = lever_arm
        self._entries: deque[Entry] = deque(maxlen=MOST)
        self._new = self._taken = 0

    def take(self, entry: Entry) -> None:
        """Keep a fix, if it is far enough from the last one."""
        if self._entries and entry.place.way - self._entries[-1].place.way < APART:
            return
        self._entries.append(entry)
        self._new += 1
        self._taken += 1

    def finding(self, sensor: str, last: bool) -> Finding | None:
        """Whether the antenna is elsewhere, asked when there is enough more of it."""
        if self._new < (1 if last else EACH) or len(self._entries) < FEWEST:
            return None
        self._new = 0
        kept = list(self._entries)
        degrees = np.array([(item.fix.latitude, item.fix.longitude) for item in kept])
        track = TurningTrack(
            stamps=np.array([item.fix.stamp for item in kept], dtype=np.int64),
            enu=metres(degrees),
            local=np.array([item.place.position[:2] for item in kept]),
            headings=np.array([item.place.heading for item in kept]),
            sigmas=np.array([item.sigma for item in kept]),
            slipped=np.array([item.place.looser for item in kept]),
        )
        return antenna_finding(sensor, track, self._arm, early=self._taken <= MOST)
