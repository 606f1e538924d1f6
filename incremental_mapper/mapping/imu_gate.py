"""IMU samples that contradict the matches of scans beside them: a knocked or disturbed sensor.

A single wrong sample, or a few tenths of a second of them, would bend the map for good: their
spans are believed as all others are. Matches know nothing of the IMU, so they can tell.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.frontend.front_end import Prepared
from incremental_mapper.frontend.imu_preintegration import EMPTY_SERIES, ImuSeries
from incremental_mapper.frontend.prepared_scan import PreparedScan
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.quantiles import median_row

LONGEST = NANOSECONDS // 2
"""Nanoseconds; a match over more time says little of a single sample."""
RATE, MEAN_RATE = 3.0, 1.0
"""rad/s by which a sample, and the mean over a match, are off its turn. The drives here turn
by 0.7 rad/s at most. Vibration may be as strong, but not its mean."""
FORCE, MEAN_FORCE = 50.0, 10.0
"""m/s^2 by which a sample is off the usual force, and the mean over a match. A kerb gives 30 to 50
for a moment; no wheels speed a vehicle up by 10 for as long as a scan takes."""
LASTING_FORCE, LASTING = 30.0, NANOSECONDS // 10
"""m/s^2 that are too much, gravity and all, for the mean over so many nanoseconds, whichever way
up the IMU is. The samples of it that are off by ``MEAN_FORCE`` make it."""
LASTING_RATE = 10.0
"""rad/s that are too much for the mean over ``LASTING``: a turn and a half each second."""
FEWEST = 5
"""Samples of which a mean says that something lasts."""
USUAL = 50
"""Windows whose medians tell which force is usual."""


@dataclass(frozen=True, slots=True, eq=False)
class Gated:
    """The samples that are used, and those that were left out."""

    series: ImuSeries
    refused: ImuSeries


class ImuGate:
    """Gates the samples of one window after the other, and knows what force is usual."""

    def __init__(self) -> None:
        self._forces = np.zeros((USUAL, 3))  # medians of the last windows, in no order
        self._windows = 0
        self._refused = EMPTY_SERIES  # of the window before

    def take(
        self, series: ImuSeries, prepared: Sequence[Prepared], R_base_imu: NDArray[np.float64]
    ) -> Gated:
        """As ``gate``, for the samples and core measurements of the next window."""
        usual = median_row(self._forces[: self._windows]) if self._windows else None
        gated = gate(series, prepared, R_base_imu, usual, self._refused)
        self._refused = gated.refused
        if len(gated.series.stamps):
            self._forces[self._windows % USUAL] = median_row(gated.series.acceleration)
            self._windows += 1
        return gated


def gate(
    series: ImuSeries,
    prepared: Sequence[Prepared],
    R_base_imu: NDArray[np.float64],
    usual: NDArray[np.float64] | None = None,
    before: ImuSeries = EMPTY_SERIES,
) -> Gated:
    """Leave out samples that no vehicle can have made while scans matched as they did.

    Args:
        series: IMU samples that are not used yet, in the IMU's frame.
        prepared: Core measurements beside them.
        R_base_imu: Rotation (3, 3) of the IMU in base_link.
        usual: Acceleration (3,) that samples have most of the time, m/s^2; None takes the median of
            these samples, which a knock of a tenth of a second may be the most of.
        before: Samples that were left out before these; what they began goes on.

    Returns:
        The other samples. What a match vouches for stays, whatever another one says. Where no
        match tells, what no vehicle does for so long is left out.
    """
    if len(series.stamps) == 0:
        return Gated(series, EMPTY_SERIES)
    middle = median_row(series.acceleration) if usual is None else usual
    forces = series.acceleration - middle
    fast = np.linalg.norm(series.gyro, axis=1) > RATE
    unusual = np.linalg.norm(forces, axis=1) > MEAN_FORCE
    both = before.since(int(series.stamps[0]) - LASTING).joined_series(series)
    lasting, goes_on = _lasting(both.stamps, both.acceleration, unusual, LASTING_FORCE)
    whirling, _ = _lasting(both.stamps, both.gyro, fast, LASTING_RATE)
    strong = (np.linalg.norm(forces, axis=1) > FORCE) | lasting
    if not (fast.any() or strong.any()):
        return Gated(series, EMPTY_SERIES)
    rates = series.gyro @ R_base_imu.T
    condemned = np.zeros(len(series.stamps), dtype=bool)
    vouched, judged = condemned.copy(), condemned.copy()
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
        judged[span] = True
        vouched[span] |= fast[span] & ~turned
        if np.linalg.norm(off.mean(axis=0)) > MEAN_RATE:
            condemned[span] |= fast[span] & turned
        if np.linalg.norm(forces[span].mean(axis=0)) > MEAN_FORCE:
            condemned[span] |= strong[span]
    condemned |= goes_on | ((lasting | whirling) & ~judged)
    condemned = _whole(condemned, lasting)
    keep = ~(condemned & ~(vouched & ~strong))
    unsure = _unsure((fast | strong) & keep, judged)
    if keep.all() and unsure is None:
        return Gated(series, EMPTY_SERIES)
    return Gated(series.chosen(keep, unsure), series.chosen(~keep))


def _unsure(unusual: NDArray[np.bool_], judged: NDArray[np.bool_]) -> int | None:
    """Position of the first unusual sample behind the last match: a knock may begin there."""
    behind = unusual & ~np.maximum.accumulate(judged[::-1])[::-1]
    return int(behind.argmax()) if judged.any() and behind.any() else None


def _lasting(
    stamps: NDArray[np.int64],
    values: NDArray[np.float64],
    unusual: NDArray[np.bool_],
    most: float,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which unusual samples are of what no vehicle feels so long, and go on from before.

    Args:
        stamps: Of the samples, and of some that were left out before them.
        values: Theirs, (N, 3).
        unusual: Which of the samples may be.
        most: What the mean of the values over ``LASTING`` may be.
    """
    none = np.zeros(len(unusual), dtype=bool)
    earlier = len(stamps) - len(unusual)
    if not unusual.any() or np.abs(values[earlier:]).max() * np.sqrt(3.0) <= most:
        return none, none
    ends = np.searchsorted(stamps, stamps + LASTING)
    count = ends - np.arange(len(stamps))
    sums = np.vstack([np.zeros(3), np.cumsum(values, axis=0)])
    mean = np.linalg.norm(sums[ends] - sums[:-1], axis=1) / count
    begins = np.flatnonzero((mean > most) & (count >= FEWEST))
    change = np.zeros(len(stamps) + 1)
    np.add.at(change, begins, 1.0)
    np.add.at(change, ends[begins], -1.0)
    lasts = (np.cumsum(change[:-1]) > 0.0)[earlier:] & unusual
    first = none.copy()
    first[0] = earlier > 0
    return lasts, lasts & first


def _whole(some: NDArray[np.bool_], runs: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """``some`` samples, and those of ``runs`` that go on from one of them without a break."""
    number = np.cumsum(np.diff(runs, prepend=False))
    return some | runs & np.isin(number, number[some & runs])
