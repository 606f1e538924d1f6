"""When the points of clouds without times were measured, where they are in the order of firing.

A spinning LiDAR's azimuth is a clock: how far the head has turned from one point to the next says
how much later that was. KAIST's files are so: the driver wrote the points as they were fired, and
the stamp is that of the last packet.
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.errors import MeasurementError
from incremental_mapper.measurements import NANOSECONDS

TURN = 0.1
"""Seconds that a turn of KAIST's VLP-16s takes."""
FULL_TURN = 2.0 * math.pi
BACKWARDS = math.radians(10.0)
"""How far a point's azimuth may lie behind the one before it: lasers of a column are spread."""
LONGEST, WHOLE = math.radians(400.0), math.radians(355.0)
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
        sweep around tells where this one ended. Each column is one piece of memory: what looks at
        one coordinate of all points, which nearly everything does, is several times as fast.
        Raises MeasurementError as what is wrapped does.
        """
        cloud = self._load(index)
        columns = np.empty((cloud.shape[1] + 1, len(cloud)), dtype=cloud.dtype)
        columns[:-1] = cloud.T
        columns[-1] = self._times(index, columns[:3])
        return columns.T

    def _times(self, index: int, columns: NDArray[np.floating]) -> NDArray[np.floating] | float:
        """Seconds (N,) after the stamp, or NaN for all of the points (3, N)."""
        told, azimuths, turned = _turned(columns)
        self._keep_end(index, azimuths, turned)
        if len(turned) == 0:
            return math.nan
        end = self._end(index, azimuths, turned)
        if end is None:
            return math.nan
        missing = max((float(azimuths[-1] - end) + BACKWARDS) % FULL_TURN - BACKWARDS, 0.0)
        if turned[-1] + missing >= LONGEST:
            return math.nan
        times: NDArray[np.float64] = turned - turned[-1]
        np.minimum(times, 0.0, out=times)
        times -= missing
        times /= FULL_TURN
        times *= TURN
        if told is None:
            return times
        of_all = np.full(columns.shape[1], np.nan)
        of_all[told] = times
        return of_all

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
        """Azimuth at the end of a whole sweep, radians; None where it is not whole."""
        if index not in self._ends:
            try:
                columns = np.ascontiguousarray(self._load(index)[:, :3].T)
                _, azimuths, turned = _turned(columns)
            except MeasurementError:
                azimuths, turned = np.zeros(0), np.zeros(0)
            self._keep_end(index, azimuths, turned)
        return self._ends[index]

    def _keep_end(
        self, index: int, azimuths: NDArray[np.floating], turned: NDArray[np.float64]
    ) -> None:
        whole = len(turned) > 0 and turned[-1] > WHOLE
        self._ends[index] = float(azimuths[-1]) if whole else None


def _turned(
    columns: NDArray[np.floating],
) -> tuple[NDArray[np.bool_] | None, NDArray[np.floating], NDArray[np.float64]]:
    """Which points (3, N) have a direction; their azimuths; how far the head had turned at each.

    None for the first where all have one. All radians; the last two are empty where the points are
    in another order.
    """
    x, y, z = columns
    with np.errstate(over='ignore', invalid='ignore'):
        told = np.isfinite(x + y + z) & ((x != 0.0) | (y != 0.0))
    if told.all():
        told = None
    else:
        x, y = x[told], y[told]
    azimuths = np.arctan2(y, x)
    if len(azimuths) < 2:
        return told, np.zeros(0), np.zeros(0)
    steps = azimuths[:-1] - azimuths[1:]
    # The head passes the seam of the azimuths once in a turn: few steps are to be mended.
    steps[np.flatnonzero(steps < -BACKWARDS)] += np.float64(FULL_TURN)
    steps[np.flatnonzero(steps >= FULL_TURN - BACKWARDS)] -= np.float64(FULL_TURN)
    turned = np.zeros(len(azimuths))
    turned[1:] = steps
    np.cumsum(turned, out=turned)
    if turned[-1] > LONGEST:
        return told, np.zeros(0), np.zeros(0)
    return told, azimuths, turned
