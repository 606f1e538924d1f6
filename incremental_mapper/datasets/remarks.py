"""What was wrong with messages that were used nevertheless, counted."""

from collections import Counter

from incremental_mapper.checks.finding import Finding
from incremental_mapper.checks.used_otherwise import remarked
from incremental_mapper.measurements import GnssFix, LidarScan, Measurement


class Remarks:
    """Counts the remarks on the measurements of a run."""

    def __init__(self) -> None:
        self._counts: Counter[tuple[str, str]] = Counter()
        self._totals: Counter[str] = Counter()
        self._texts: dict[tuple[str, str], str] = {}

    def take(self, measurement: Measurement) -> None:
        """Count what is remarked of a measurement.

        Args:
            measurement: the next one of its sensor.
        """
        if not isinstance(measurement, (LidarScan, GnssFix)):
            return
        self._totals[measurement.sensor] += 1
        for remark in measurement.remarks:
            key = measurement.sensor, remark.reason
            self._counts[key] += 1
            self._texts.setdefault(key, remark.text)

    def findings(self) -> tuple[Finding, ...]:
        """One for every sensor and kind of remark, with the text of the first."""
        return tuple(
            remarked(sensor, reason, self._texts[sensor, reason], count, self._totals[sensor])
            for (sensor, reason), count in self._counts.items()
        )
