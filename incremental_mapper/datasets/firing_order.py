"""When the points of clouds without times were measured, where they are in the order of firing.

A spinning LiDAR's azimuth is a clock: how far the head has turned from one point to the next says
how much later that was. KAIST's files are so: the driver wrote the points as they were fired, and
the stamp is that of the last packet.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.errors import MeasurementError
from incremental_mapper.measurements import NANOSECONDS, Points

TURN = 0.1
"""Seconds that a turn of KAIST's VLP-16s takes."""
FULL_TURN = 2.0 * np.pi
BACKWARDS = np.radians(10.0)
"""How far a point's azimuth may lie behind the one before it: lasers of a column are spread."""
LONGEST, WHOLE = np.radians(400.0), np.radians(355.0)
"""A sweep turns no further than the first, and where it shows more than the second, it has points
up to its end. KAIST's turn by 363 degrees."""
AROUND = 100
"""Sweeps before and after one among which a whole one is looked for."""


class TimedScans:
    """The sweeps of a LiDAR that turns clockwise, seen from above, with the times of their points.

    The last points of a sweep may be missing, where the head looks at the sky: then its end is
    where the nearest whole sweep lets expect it. What is said of a sweep does not depend on which
    others were read before.
    """

    def __init__(
        self, stamps: NDArray[np.int64], load: Callable[[int], NDArray[np.floating]]
    ) -> None:
        """Wrap a stream of clouds.

        Args:
            stamps: Ends of the sweeps, ns, ascending.
            load: The cloud at a place: x, y, z in the LiDAR's frame, metres, and more (N, C);
                raises MeasurementError where it cannot be read.
        """
        self.stamps = stamps
        self._load = load
        self._ends: dict[int, float | None] = {}

    def load(self, index: int) -> NDArray[np.floating]:
        """A cloud with one more column: seconds after the stamp, none positive, or NaN.

        A point without a direction has no time. No point has one where the order is another, or no
        sweep around tells where this one ended. Raises MeasurementError as what is wrapped does.
        """
        cloud = self._load(index)
        return np.column_stack([cloud, self._times(index, cloud[:, :3])])

    def _times(self, index: int, points: Points) -> NDArray[np.float32]:
        times = np.full(len(points), np.nan, dtype=np.float32)
        told, azimuths, turned = _turned(points)
        if len(turned) == 0:
            return times
        end = self._end(index, azimuths, turned)
        if end is None:
            return times
        missing = max((azimuths[-1] - end + BACKWARDS) % FULL_TURN - BACKWARDS, 0.0)
        if turned[-1] + missing < LONGEST:
            since = np.maximum(turned[-1] - turned, 0.0) + missing
            times[told] = -since / FULL_TURN * TURN
        return times

    def _end(
        self, index: int, azimuths: NDArray[np.floating], turned: NDArray[np.float64]
    ) -> float | None:
        """Azimuth at the end of a sweep, radians."""
        if turned[-1] > WHOLE:
            return float(azimuths[-1])
        for apart in range(1, AROUND + 1):
            for other in (index - apart, index + apart):
                if not 0 <= other < len(self.stamps):
                    continue
                known = self._whole_end(other)
                if known is not None:
                    passed = float(self.stamps[index] - self.stamps[other]) / NANOSECONDS
                    return known - FULL_TURN * passed / TURN
        return None

    def _whole_end(self, index: int) -> float | None:
        if index not in self._ends:
            try:
                _, azimuths, turned = _turned(self._load(index)[:, :3])
            except MeasurementError:
                turned = np.zeros(0)
            whole = len(turned) > 0 and turned[-1] > WHOLE
            self._ends[index] = float(azimuths[-1]) if whole else None
        return self._ends[index]


def _turned(
    points: Points,
) -> tuple[NDArray[np.bool_], NDArray[np.floating], NDArray[np.float64]]:
    """Which points have a direction; their azimuths; how far the head had turned at each.

    All radians; the last two are empty where the points are in another order.
    """
    x, y, z = points.T
    with np.errstate(over='ignore', invalid='ignore'):
        told = np.isfinite(x + y + z) & ((x != 0.0) | (y != 0.0))
    azimuths = np.arctan2(y[told], x[told])
    steps = azimuths[:-1] - azimuths[1:]
    steps += FULL_TURN * (steps < -BACKWARDS)
    steps -= FULL_TURN * (steps >= FULL_TURN - BACKWARDS)
    turned = np.append(np.zeros(min(len(azimuths), 1)), np.cumsum(steps, dtype=np.float64))
    if len(turned) < 2 or turned[-1] > LONGEST:
        return told, np.zeros(0), np.zeros(0)
    return told, azimuths, turned
