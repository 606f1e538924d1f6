"""IMU samples that contradict the matches of scans beside them: a knocked or disturbed sensor.

A single wrong sample, or a few tenths of a second of them, would bend the map for good: their
spans are believed as all others are. Matches know nothing of the IMU, so they can tell.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.frontend.front_end import Prepared
from incremental_mapper.frontend.imu_preintegration import ImuSeries
from incremental_mapper.frontend.lidar_odometry import PreparedScan
from incremental_mapper.measurements import NANOSECONDS

LONGEST = NANOSECONDS // 2
"""Nanoseconds; a match over more time says little of a single sample."""
RATE, MEAN_RATE = 3.0, 1.0
"""rad/s by which a sample, and the mean over a match, are off its turn. The drives here turn
by 0.7 rad/s at most. Vibration may be as strong, but not its mean."""
FORCE, MEAN_FORCE = 50.0, 10.0
"""m/s^2 by which a sample is off the usual force, and the mean over a match. A kerb gives 30 to 50
for a moment; no wheels speed a vehicle up by 10 for as long as a scan takes."""


USUAL = 50
"""Windows whose medians tell which force is usual."""


@dataclass(frozen=True, slots=True, eq=False)
class Gated:
    """The samples that are used, and the stamps (R,) of those that were left out, ns."""

    series: ImuSeries
    left_out: NDArray[np.int64]

    @property
    def refused(self) -> int:
        """How many were left out."""
        return len(self.left_out)


_NONE = np.zeros(0, dtype=np.int64)


class ImuGate:
    """Gates the samples of one window after the other, and knows what force is usual."""

    def __init__(self) -> None:
        self._forces: deque[NDArray[np.float64]] = deque(maxlen=USUAL)

    def take(
        self, series: ImuSeries, prepared: Sequence[Prepared], R_base_imu: NDArray[np.float64]
    ) -> Gated:
        """As ``gate``, for the samples and core measurements of the next window."""
        usual = np.median(self._forces, axis=0) if self._forces else None
        gated = gate(series, prepared, R_base_imu, usual)
        if len(gated.series.stamps):
            self._forces.append(np.median(gated.series.acceleration, axis=0))
        return gated


def gate(
    series: ImuSeries,
    prepared: Sequence[Prepared],
    R_base_imu: NDArray[np.float64],
    usual: NDArray[np.float64] | None = None,
) -> Gated:
    """Leave out samples that no vehicle can have made while scans matched as they did.

    Args:
        series: IMU samples that are not used yet, in the IMU's frame.
        prepared: Core measurements beside them.
        R_base_imu: Rotation (3, 3) of the IMU in base_link.
        usual: Acceleration (3,) that samples have most of the time, m/s^2; None takes the median of
            these samples, which a knock of a tenth of a second may be the most of.

    Returns:
        The other samples. What a match vouches for stays, whatever another one says.
    """
    if len(series.stamps) == 0:
        return Gated(series, _NONE)
    middle = np.median(series.acceleration, axis=0) if usual is None else usual
    forces = series.acceleration - middle
    fast = np.linalg.norm(series.gyro, axis=1) > RATE
    strong = np.linalg.norm(forces, axis=1) > FORCE
    if not (fast.any() or strong.any()):
        return Gated(series, _NONE)
    rates = series.gyro @ R_base_imu.T
    condemned = np.zeros(len(series.stamps), dtype=bool)
    vouched = condemned.copy()
    for item in prepared:
        if not isinstance(item, PreparedScan) or item.previous is None:
            continue
        assert item.T_previous_current is not None
        passed = item.core.stamp - item.previous
        low, high = np.searchsorted(series.stamps, (item.previous, item.core.stamp))
        span = slice(int(low), int(high))
        if high == low or passed > LONGEST:
            continue
        turn = gtsam.Rot3.Logmap(item.T_previous_current.rotation()) * (NANOSECONDS / passed)
        off = rates[span] - turn
        turned = np.linalg.norm(off, axis=1) > RATE
        vouched[span] |= fast[span] & ~turned
        if np.linalg.norm(off.mean(axis=0)) > MEAN_RATE:
            condemned[span] |= fast[span] & turned
        if np.linalg.norm(forces[span].mean(axis=0)) > MEAN_FORCE:
            condemned[span] |= strong[span]
    keep = ~(condemned & ~(vouched & ~strong))
    if keep.all():
        return Gated(series, _NONE)
    kept = ImuSeries(series.stamps[keep], series.gyro[keep], series.acceleration[keep])
    return Gated(kept, series.stamps[~keep])
