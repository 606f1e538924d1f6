"""What was wrong with messages that were used nevertheless, counted."""

from collections import Counter

from incremental_mapper.checks.finding import Finding
from incremental_mapper.checks.used_otherwise import remarked
from incremental_mapper.measurements import NANOSECONDS, GnssFix, LidarScan, Measurement

FROZEN_FIXES = 5
"""Repeats of one position after which a receiver may be frozen. Receivers that round to
centimetres repeat themselves by chance while the car stands."""
FROZEN_SECONDS = 2.0
"""Seconds that such repeats last at least."""


class Remarks:
    """Counts the remarks on the measurements of a run, and looks for receivers that are frozen."""

    def __init__(self) -> None:
        self._counts: Counter[tuple[str, str]] = Counter()
        self._totals: Counter[str] = Counter()
        self._texts: dict[tuple[str, str], str] = {}
        self._receivers: dict[str, _Receiver] = {}

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
        if isinstance(measurement, GnssFix):
            self._receivers.setdefault(measurement.sensor, _Receiver()).take(measurement)

    def findings(self) -> tuple[Finding, ...]:
        """One for every sensor and kind of remark, with the text of the first."""
        return tuple(
            remarked(sensor, reason, self._texts[sensor, reason], count, self._totals[sensor])
            for (sensor, reason), count in self._counts.items()
        )

    def notes(self) -> tuple[str, ...]:
        """One line for every receiver that repeats itself."""
        lines = []
        for sensor, receiver in self._receivers.items():
            if receiver.frozen:
                lines.append(
                    f'{sensor}: {receiver.frozen} fixes repeat the position before them bit for '
                    f'bit, for up to {receiver.longest:.1f} s, while their stamps go on '
                    '(frozen_fix); right where the car stood, else the receiver or its driver '
                    'hangs and its fixes are wrong'
                )
        return tuple(lines)


class _Receiver:
    """Runs of equal positions; ``frozen`` fixes are in long ones, the ``longest`` in seconds."""

    def __init__(self) -> None:
        self.frozen = 0
        self.longest = 0.0
        self._place: tuple[float, float] | None = None
        self._start = 0
        self._repeats = 0
        self._long = False

    def take(self, fix: GnssFix) -> None:
        place = fix.latitude, fix.longitude
        if place != self._place:
            self._place, self._start, self._repeats, self._long = place, fix.stamp, 0, False
            return
        self._repeats += 1
        seconds = (fix.stamp - self._start) / NANOSECONDS
        if self._repeats < FROZEN_FIXES or seconds < FROZEN_SECONDS:
            return
        self.frozen += 1 if self._long else self._repeats
        self._long = True
        self.longest = max(self.longest, seconds)
