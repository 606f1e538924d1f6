"""Gives each scan the IMU's samples up to the end of its sweep, and says when they have come.

Which samples a scan gets depends on stamps alone, so that a run is the same whether measurements
come from a file or one by one, and wherever scans are matched.
"""

from bisect import bisect_left, bisect_right

from incremental_mapper.frontend.imu_preintegration import ImuSeries, series_of
from incremental_mapper.measurements import NANOSECONDS, ImuSample, LidarScan

KEPT = 5 * NANOSECONDS
"""Nanoseconds for which samples are kept: scans further apart are not guessed by the IMU."""
LEAST_PATIENCE = NANOSECONDS // 5
"""Nanoseconds of patience at the least, or all would depend on the order of arrival."""


def sweep_end(scan: LidarScan) -> int:
    """Stamp (ns) of a scan's last point."""
    times = scan.point_times
    after = 0.0 if times is None else max(float(times.max()), 0.0)
    return scan.stamp + round(after * NANOSECONDS)


class ImuSupply:
    """Samples in time order, and what was handed out of them to each LiDAR."""

    def __init__(self, expected: bool, patience: float) -> None:
        """Make ready for the first measurement.

        Args:
            expected: Whether samples will come, as far as is known.
            patience: Seconds after which samples that have not come are not waited for.
        """
        self._samples: list[ImuSample] = []
        self._stamps: list[int] = []  # theirs
        self._expected = expected
        self._patience = max(round(patience * NANOSECONDS), LEAST_PATIENCE)
        self._first: int | None = None  # of all stamps
        self._newest = -1  # of all stamps
        self._newest_sample: int | None = None
        self._given: dict[str, int] = {}  # newest stamp by LiDAR

    def add(self, sample: ImuSample) -> None:
        """Take in a sample, in rad/s and m/s^2, in the IMU's axes."""
        place = bisect_right(self._stamps, sample.stamp)
        self._samples.insert(place, sample)
        self._stamps.insert(place, sample.stamp)
        self._newest_sample = max(self._newest_sample or 0, sample.stamp)
        oldest = self._newest_sample - KEPT - self._patience
        if self._stamps[0] < oldest - NANOSECONDS:  # seldom, since it takes its time
            first = bisect_left(self._stamps, oldest)
            del self._samples[:first], self._stamps[:first]

    def passed(self, stamp: int) -> None:
        """Take note of the newest stamp of all sensors, ns."""
        self._first = stamp if self._first is None else self._first
        self._newest = stamp

    def complete(self, end: int) -> bool:
        """Whether no sample up to a stamp (ns) is to be waited for."""
        if self._newest_sample is not None:
            return end <= self._newest_sample or self._silent_since(self._newest_sample)
        return not self._expected or (self._first is not None and self._silent_since(self._first))

    def take(self, sensor: str, end: int) -> ImuSeries:
        """The samples that are new to a LiDAR, up to the first one at or after a stamp (ns)."""
        low = bisect_right(self._stamps, self._given.get(sensor, end - KEPT))
        high = bisect_left(self._stamps, end) + 1
        samples = self._samples[low:high]
        if samples:
            self._given[sensor] = samples[-1].stamp
        return series_of(samples)

    def _silent_since(self, stamp: int) -> bool:
        return self._newest - stamp > self._patience
