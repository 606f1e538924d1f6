"""The first measurements of a map, kept in case it has to begin anew with other settings."""

from incremental_mapper.measurements import NANOSECONDS, LidarScan, Measurement

MOST_SECONDS = 30.0
"""Seconds of driving that are kept; what proves a setting wrong mostly does so within them."""
MOST_BYTES = 256_000_000
"""Points that are kept: 12 s of a LiDAR with 128 beams, 60 s of two with 16."""


class Beginning:
    """Measurements since a map began, as they came; used in one thread."""

    def __init__(self) -> None:
        self._kept: list[Measurement] | None = []
        self._first: dict[str, int] = {}
        self._bytes = 0

    def add(self, measurement: Measurement) -> None:
        """Keep a measurement; where there are too many, none is kept any more."""
        if self._kept is None:
            return
        self._kept.append(measurement)
        if isinstance(measurement, LidarScan):
            self._bytes += measurement.points.nbytes
        # Sensors may be on different clocks; each is held against itself.
        first = self._first.setdefault(measurement.sensor, measurement.stamp)
        old = measurement.stamp - first > MOST_SECONDS * NANOSECONDS
        if old or self._bytes > MOST_BYTES:
            self._kept = None

    def forget(self) -> None:
        """Keep none: not all that belong to this map came through here."""
        self._kept = None

    def whole(self) -> tuple[Measurement, ...] | None:
        """All of them in the order in which they came, or None where they were too many."""
        return None if self._kept is None else tuple(self._kept)
