"""Accelerations that drive a velocity which no match knows of: an IMU that is pushed.

What a push adds is no more than a vehicle may feel, so that no single sample tells it. But it adds
up: after some tenths of a second the IMU has gathered a speed that matches do not see.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.imu_pushed import Pushes
from incremental_mapper.frontend.front_end import Prepared
from incremental_mapper.frontend.imu_preintegration import ImuSeries
from incremental_mapper.frontend.inertial_motion import rotations_after
from incremental_mapper.frontend.match_noise import loosest_shift
from incremental_mapper.frontend.prepared_scan import PreparedScan
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.quantiles import median

Array = NDArray[np.float64]

LONGEST = 0.35
"""Seconds; a match over more time has no one velocity."""
LEARNED = 4.0
"""Seconds of matches that tell gravity, as the IMU feels it and its bias with it."""
FEWEST, LEAST = 12, 2.0
"""Matches, and seconds that they are spread over, from which gravity is told."""
GATHERING, BESIDE = 0.5, 0.3
"""Seconds over which a push is looked for, and of matches whose mean is the velocity before them;
that behind is of half as many, so that a push is known early."""
GATHERED = 0.6
"""m/s that an IMU gathers at least, and no match knows of, where it is pushed."""
UNUSUAL = 6.0
"""So many times the usual difference it is at least."""
USUAL = 20
"""Windows that tell which difference is usual."""
COHERENT = 5.0
"""So many times the push is doubted: spans take their noise for new at each, and it stays."""
PATIENCE = 3.0
"""Seconds of a push after which gravity is learned anew: what stays so long is a new bias."""
UNSURE = 3.0
"""Times the deviation that is usual for a LiDAR's matches, in their worst direction, from which on
one accuses nobody. Of sound ones over bends 1 in 100 has 2.2 and 3.2; two in a row that slipped by
4 m/s, where a LiDAR was alone, had 6."""
HELD = 0.15
"""Metres of deviation from which on a match accuses nobody. Pushes over bends of 3 m/s^2 for 2 s
and of 6 for 0.5 s leave 0.038 and 0.026 m; with 0.13, where two of five matches say nothing, 0.042
and 0.20, with 0.17 0.14 and 0.046, with 0.2 and its noisier matches 1.2 (an error) and 0.029."""
HOLE = 0.06
"""Seconds without samples behind which all begins anew: what an IMU of 10 Hz and less gathers in
between is not known well enough to accuse it."""


class ImuPushes:
    """Holds what the IMU gathers against the matches, window by window.

    Everything is in the axes that the IMU had at first, carried on by its gyroscope: gravity is
    a slope of the difference between the two velocities there, and the same one for seconds.
    ``told`` counts what was doubted.
    """

    def __init__(self, T_base_imu: Array) -> None:
        """Make ready for an IMU at this pose (4, 4) in base_link."""
        self._turn, self._arm = T_base_imu[:3, :3], T_base_imu[:3, 3]
        self.told = Pushes()
        self._slope: Array | None = None
        self._usual: deque[float] = deque(maxlen=USUAL)
        self._certain: dict[str, deque[float]] = {}
        self._begin_anew(0)

    def _begin_anew(self, stamp: int) -> None:
        self._origin = self._last = stamp
        self._moments = np.zeros(0)
        self._turns = np.zeros((0, 3, 3))
        self._speeds, self._ways = np.zeros((0, 3)), np.zeros((0, 3))
        # How fast matches went beyond the IMU, m/s, and at which moments, seconds, in their order.
        self._told, self._beyond = np.zeros(0), np.zeros((0, 3))
        self._since: float | None = None
        self._calm = 0.0

    def take(self, series: ImuSeries, prepared: Sequence[Prepared]) -> ImuSeries:
        """Doubt the samples of a window that gather what no match knows of.

        Args:
            series: Samples that no span has used yet, in the IMU's frame.
            prepared: Core measurements of the window.

        Returns:
            The series, with its ``doubts``.
        """
        self._integrate(series)
        new = [row for item in prepared if (row := self._row(item)) is not None]
        if not new:
            return series
        told = np.concatenate([self._told, [moment for moment, _ in new]])
        beyond = np.concatenate([self._beyond, [speed for _, speed in new]])
        last = max(moment for moment, _ in new)
        order = np.argsort(told, kind='stable')
        order = order[told[order] > last - LEARNED]
        self._told, self._beyond = told[order], beyond[order]
        doubted = self._doubted(last)
        self._learn(last, doubted is not None)
        if doubted is None:
            return series
        since, gathered = doubted
        push = COHERENT * gathered / GATHERING
        which = series.stamps >= self._origin + round(since * NANOSECONDS)
        if which.any():
            stamps = series.stamps[which]
            self.told.add(int(stamps[0]), int(stamps[-1]), gathered)
        before = np.zeros(len(which)) if series.doubts is None else series.doubts
        return replace(series, doubts=np.where(which, np.maximum(before, push), before))

    def _integrate(self, series: ImuSeries) -> None:
        """Take in the samples that are new."""
        low = int(series.stamps.searchsorted(self._last, side='right'))
        stamps = series.stamps[low:]
        if len(stamps) == 0:
            return
        if len(self._moments) == 0 or stamps[0] - self._last > HOLE * NANOSECONDS:
            self._begin_anew(int(stamps[0]))
            self._slope = None
            self._turns, self._speeds = np.eye(3)[None], np.zeros((1, 3))
            self._ways, self._moments = np.zeros((1, 3)), np.zeros(1)
            low, stamps = low + 1, stamps[1:]
            if len(stamps) == 0:
                return
        moments = (stamps - self._origin) / NANOSECONDS
        steps = moments.copy()[:, None]
        steps[0] -= self._moments[-1]
        steps[1:, 0] -= moments[:-1]
        turns = self._turns[-1] @ rotations_after(series.gyro[low:] @ self._turn.T * steps)
        # What is felt at the end of a step is taken for all of it, along the axes at its beginning.
        forces = series.acceleration[low:] @ self._turn.T
        felt = np.einsum('kij,kj->ki', turns[:-1], forces)
        speeds = self._speeds[-1] + np.cumsum(felt * steps, axis=0)
        shifts = (speeds - 0.5 * felt * steps) * steps
        keep = int(self._moments.searchsorted(moments[-1] - 2.0))
        self._moments = np.concatenate([self._moments[keep:], moments])
        self._turns = np.concatenate([self._turns[keep:], turns[1:]])
        self._speeds = np.concatenate([self._speeds[keep:], speeds])
        ways = self._ways[-1] + np.cumsum(shifts, axis=0)
        self._ways = np.concatenate([self._ways[keep:], ways])
        self._last = int(stamps[-1])

    def _row(self, item: Prepared) -> tuple[float, Array] | None:
        """What a match says, if the samples cover it and it is held in all directions."""
        if not isinstance(item, PreparedScan) or item.previous is None:
            return None
        assert item.T_previous_current is not None
        start = (item.previous - self._origin) / NANOSECONDS
        end = (item.core.stamp - self._origin) / NANOSECONDS
        known = self._moments
        if not 0.0 < end - start < LONGEST or len(known) < 2:
            return None
        if item.covariance is not None and self._unsure(item.core.sensor, item.covariance):
            return None
        if start < known[0] or end > known[-1] + (known[-1] - known[-2]):
            return None
        motion = item.T_previous_current
        shift = motion.translation() - self._arm + motion.rotation().matrix() @ self._arm
        low = min(max(int(known.searchsorted(start)) - 1, 0), len(known) - 2)
        share = (start - known[low]) / (known[low + 1] - known[low])
        turned = (1.0 - share) * (self._turns[low] @ shift) + share * self._turns[low + 1] @ shift
        gathered = self._way_at(end) - self._way_at(start)
        gathered += max(end - known[-1], 0.0) * self._speeds[-1]
        return 0.5 * (start + end), (turned - gathered) / (end - start)

    def _way_at(self, moment: float) -> Array:
        """Way (3,) at a moment; what is beyond the last sample is taken for the last."""
        known = self._moments
        low = int(known.searchsorted(moment, side='right')) - 1
        if low >= len(known) - 1:
            last: Array = self._ways[-1]
            return last
        slope = (self._ways[low + 1] - self._ways[low]) / (known[low + 1] - known[low])
        way: Array = slope * (moment - known[low]) + self._ways[low]
        return way

    def _unsure(self, sensor: str, covariance: Array) -> bool:
        """Whether a match (6, 6) is held weakly, or less than most of its LiDAR are."""
        worst = loosest_shift(covariance)
        if worst > HELD**2:
            return True
        usual = self._certain.setdefault(sensor, deque(maxlen=USUAL))
        usual.append(worst)
        return worst > UNSURE**2 * median(usual)

    def _doubted(self, last: float) -> tuple[float, float] | None:
        """Since which moment samples are doubted, and m/s that they gathered; None: none are."""
        if self._slope is None:
            return None  # nothing is known yet
        before = self._mean(self._slope, last - GATHERING - BESIDE, last - GATHERING)
        behind = self._mean(self._slope, last - BESIDE / 2.0, last)
        if before is None or behind is None:
            return None
        gathered = float(np.linalg.norm(behind - before))
        usual = median(self._usual) if len(self._usual) == USUAL else GATHERED
        if gathered < max(GATHERED, UNUSUAL * usual):
            self._usual.append(gathered)
            return None
        return last - GATHERING, gathered

    def _mean(self, slope: Array, start: float, end: float) -> Array | None:
        """Mean of the rows in (start, end], without gravity; None where they are too few."""
        low, high = self._told.searchsorted((start, end), side='right')
        rows = self._beyond[low:high] - self._told[low:high, None] * slope
        return rows.mean(axis=0) if len(rows) > 1 else None

    def _learn(self, last: float, pushed: bool) -> None:
        """Learn gravity from what is calm; behind a push it is the same, and the speed is not."""
        if pushed:
            self._since = last if self._since is None else self._since
            self._calm = last
            if last - self._since > PATIENCE:
                self._slope = self._since = None
            return
        self._since = None
        until = last if self._slope is None else last - GATHERING
        since = max(self._calm, last - LEARNED)
        low, high = self._told.searchsorted((since, until), side='right')
        moments = self._told[low:high]
        if len(moments) < FEWEST or np.ptp(moments) < LEAST:
            return
        centred = moments - moments.mean()
        self._slope = centred @ self._beyond[low:high] / (centred @ centred)
