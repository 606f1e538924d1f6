"""Evidence on the shape of the fixes' track, and fixes whose degrees are put right."""

from dataclasses import replace

import numpy as np

from incremental_mapper.checks.finding import Finding
from incremental_mapper.checks.fix_shape import FEWEST, Shape, shape_finding
from incremental_mapper.config import GnssSettings
from incremental_mapper.frontend.fix_tracks import Entry
from incremental_mapper.measurements import GnssFix

APART = 1.0
"""Metres of way from one fix that is kept to the next."""
MOST = 80
"""Fixes that are kept: those of the beginning, over which odometry drifts little."""
FURTHEST = 400.0
"""Metres of way after which none are kept."""
GROWTH = 1.5
"""It is looked at again when there are so many times as many."""


class ShapeWatch:
    """Keeps fixes of the first stretch, good and bad ones, beside odometry."""

    def __init__(self, settings: GnssSettings) -> None:
        self._settings = settings
        self._entries: list[Entry] = []
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

    def finding(self, sensor: str, last: bool) -> Finding | None:
        """What is wrong with the shape, asked when there is enough more of it."""
        if self._settings.exchanged or self._settings.mirrored:
            return None
        if len(self._entries) < (FEWEST if last else self._due):
            return None
        self._due = round(GROWTH * len(self._entries))
        return shape_finding(
            sensor,
            Shape(
                np.array([(entry.fix.latitude, entry.fix.longitude) for entry in self._entries]),
                np.array([entry.place.position[:2] for entry in self._entries]),
                float(np.median([entry.sigma for entry in self._entries])),
            ),
        )
