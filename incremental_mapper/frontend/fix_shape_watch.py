"""Evidence on the track of the fixes beside odometry's, and fixes whose degrees are put right."""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding
from incremental_mapper.checks.fix_clock import TimedTracks, clock_finding
from incremental_mapper.checks.fix_shape import FEWEST, Shape, metres, shape_finding
from incremental_mapper.checks.point_unit import unit_finding, way_ratios
from incremental_mapper.config import GnssSettings
from incremental_mapper.frontend.fix_tracks import Entry
from incremental_mapper.frontend.odometry_track import OdometryTrack
from incremental_mapper.frontend.prepared_scan import PreparedScan
from incremental_mapper.measurements import GnssFix

APART = 1.0
"""Metres of way from one fix that is kept to the next."""
MOST = 80
"""Fixes that are kept: those of the beginning, over which odometry drifts little."""
FURTHEST = 400.0
"""Metres of way after which none are kept."""
MOST_PLACES = 5000
"""Places by odometry that are kept: eight minutes of 10 Hz."""
BLIND = 0.3
"""Seconds without odometry within a stretch of the track, at most: it is 0.1 m off then, where
the car brakes hard."""
GROWTH = 1.5
"""It is looked at again when there are so many times as many."""
ALIKE = 0.2
"""Relative difference of two LiDARs' ways, at most, where both are in the same unit."""


class ShapeWatch:
    """Keeps fixes of the first stretch, good and bad ones, beside odometry."""

    def __init__(
        self, settings: GnssSettings, time_offset: float = 0.0, scales: Mapping[str, float] = {}
    ) -> None:
        """Begin without a fix.

        Args:
            settings: Those of the fixes.
            time_offset: Seconds that are added to their stamps already.
            scales: What the points of each LiDAR are multiplied by already.
        """
        self._settings = settings
        self._time_offset = time_offset
        self._scales = scales
        self._entries: list[Entry] = []
        self._moments: list[int] = []
        self._places: list[NDArray[np.float64]] = []
        self._ways: defaultdict[str, float] = defaultdict(float)  # of each LiDAR
        self._due = FEWEST

    def corrected(self, fix: GnssFix) -> GnssFix:
        """A fix with its degrees as the settings say that they are meant."""
        latitude, longitude = fix.latitude, fix.longitude
        if self._settings.exchanged and abs(longitude) <= 90.0:
            latitude, longitude = longitude, latitude
        if self._settings.mirrored:
            longitude = -longitude
        if (latitude, longitude) == (fix.latitude, fix.longitude):
            return fix
        return replace(fix, latitude=latitude, longitude=longitude)

    def take(self, entry: Entry) -> None:
        """Keep a fix, if it is far enough from the last one."""
        if len(self._entries) >= MOST or entry.place.way > FURTHEST:
            return
        if self._entries and entry.place.way - self._entries[-1].place.way < APART:
            return
        self._entries.append(entry)

    def pass_by(self, scan: PreparedScan, odometry: OdometryTrack) -> None:
        """Keep where odometry is after a scan; the first stretch suffices."""
        if len(self._places) >= MOST_PLACES or odometry.way > FURTHEST:
            return
        if scan.T_previous_current is not None:
            moved = scan.T_previous_current.translation()
            self._ways[scan.core.sensor] += float(np.linalg.norm(moved))
        stamp = scan.core.stamp
        if odometry.stamp == stamp and (not self._moments or stamp > self._moments[-1]):
            self._moments.append(stamp)
            self._places.append(odometry.at(stamp).position[:2])

    def finding(self, sensor: str, last: bool) -> Finding | None:
        """What is wrong with the track, asked when there is enough more of it."""
        if len(self._entries) < (FEWEST if last else self._due):
            return None
        self._due = round(GROWTH * len(self._entries))
        degrees = np.array([(item.fix.latitude, item.fix.longitude) for item in self._entries])
        local = np.array([item.place.position[:2] for item in self._entries])
        sigma = float(np.median([item.sigma for item in self._entries]))
        found = self._unit(degrees, sigma)
        if found is None and not (self._settings.exchanged or self._settings.mirrored):
            found = shape_finding(sensor, Shape(degrees, local, sigma, self._stretches()))
        if found is None:
            stamps = np.array([item.fix.stamp for item in self._entries], dtype=np.int64)
            moments = np.array(self._moments, dtype=np.int64)
            places = np.array(self._places).reshape(-1, 2)
            tracks = TimedTracks(stamps, degrees, sigma, moments, places)
            found = clock_finding(sensor, tracks, self._time_offset)
        return found

    def _stretches(self) -> NDArray[np.int64]:
        """Numbers of the stretches without a hole in odometry; a fix within one is alone."""
        numbers, begun = [0], self._entries[0].place
        for entry in self._entries[1:]:
            place = entry.place
            if place.blind - begun.blind + max(place.ahead, begun.ahead) > BLIND:
                numbers.append(numbers[-1] + 1)
                begun = place
            else:
                numbers.append(numbers[-1])
        return np.array(numbers, dtype=np.int64)

    def _unit(self, degrees: NDArray[np.float64], sigma: float) -> Finding | None:
        """Whether odometry's way is that of the fixes in another unit."""
        ways = np.array([item.place.way for item in self._entries])
        longest = max(self._ways.values(), default=0.0)
        lidars = [name for name, way in self._ways.items() if way > (1.0 - ALIKE) * longest]
        return unit_finding(sorted(lidars), way_ratios(ways, metres(degrees), sigma), self._scales)
