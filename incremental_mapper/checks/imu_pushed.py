"""Spells of an IMU that gathers a speed which no match knows of, and what is said of them."""

from dataclasses import dataclass

from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.measurements import NANOSECONDS

TOLD = 1.5
"""m/s that an IMU gathers within half a second before a user is told: pushes of 3 m/s^2 have 2.0, a
sound drive of 125 s had 1.2 once."""


@dataclass(slots=True)
class Pushes:
    """What was doubted so far.

    Attributes:
        count: Spells.
        until: Stamp up to which samples are doubted in the newest one, ns.
        nanoseconds: Length of all of them.
        most: Largest speed that was gathered within half a second, m/s.
        stamp: Where that spell began, ns.
    """

    count: int = 0
    until: int = 0
    nanoseconds: int = 0
    most: float = 0.0
    stamp: int = 0
    _begin: int = 0

    @property
    def seconds(self) -> float:
        """Of the samples that are doubted."""
        return self.nanoseconds / NANOSECONDS

    def add(self, start: int, end: int, gathered: float) -> None:
        """Count what one window doubts.

        Args:
            start: Stamp from which samples are doubted, ns.
            end: The last one, ns.
            gathered: m/s within half a second.
        """
        if self.count == 0 or start > self.until:
            self.count, self._begin, self.until = self.count + 1, start, start
        self.nanoseconds += max(end - self.until, 0)
        self.until = max(end, self.until)
        if gathered > self.most:
            self.most, self.stamp = gathered, self._begin


def pushed_findings(pushes: Pushes) -> tuple[Finding, ...]:
    """Tell of pushes that would have bent the map.

    Args:
        pushes: All of a drive so far.

    Returns:
        ``imu_pushed``, mended; nothing where all of them were slight.
    """
    if pushes.most < TOLD:
        return ()
    times = f', {pushes.count} times' if pushes.count > 1 else ''
    return (
        Finding(
            'imu_pushed',
            Severity.MENDED,
            'imu',
            f'for {pushes.seconds:.1f} s{times} it gathers a speed that no match knows of, up to '
            f'{pushes.most:.1f} m/s within half a second, first so at {pushes.stamp}: it was '
            'pushed, or the matches slip',
            'it is believed less meanwhile; fasten the IMU, and see whether the LiDARs are covered '
            'there',
        ),
    )
