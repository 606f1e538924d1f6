"""When each point of a cloud was measured: unit and origin of its time field."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.measurements import NANOSECONDS, Points, Remark

TIME_FIELDS = (
    'time',
    't',
    'timestamp',
    'time_stamp',
    'offset_time',
    'time_offset',
    'time_offset_ns',
    'ts',
)

_UNITS = {'s': 1.0, 'ms': 1e-3, 'us': 1e-6, 'ns': 1e-9}
# A sweep takes 0.05 s to 0.2 s. The bounds are wider, and their ratio of 1000 leaves one unit.
_MIN_SWEEP = 5e-4
_MAX_SWEEP = 0.5
# Times between or next to which the header stamp lies count from it: a tenth or a fifth of a second
# are between it and a part of a sweep that has the stamp of the whole. What is further off is on a
# clock of its own that has just begun, or begun anew.
_BESIDE = 0.25
# Times that are nearer to the header stamp than this many seconds are of its clock.
_SAME_CLOCK = 1.0
# The share of times at either end that may be absurd, and how far the others reach beyond the
# rest, in spans of it: a sweep of constant speed reaches 0.06. So many times tell the span.
_ABSURD_SHARE = 0.05
_REACH = 1.0
_ABSURD_SAMPLE = 10_000
# Where the largest gap between times is more than this share of their span, they are not those of
# one sweep; a sweep without half of its turn has no gap, for nothing is measured meanwhile.
_GAP = 0.6
_GAP_POINTS, _GAP_SAMPLE = 20, 500
# The share of points on the smaller side of the gap that may be left out.
_MOST_APART = 0.25
# Mean step from point to point, as a share of the sweep, above which times are noise: drawn by
# chance they have 0.33; four recordings of 16 to 128 beams have 0.0001 to 0.0044.
_NOISE = 0.25
_NOISE_POINTS = 2000


@dataclass(frozen=True, slots=True, eq=False)
class PointTimes:
    """Time of every point in seconds after the header stamp, or None; ``note`` says why.

    The times of single points that are absurd are NaN. ``remarks`` are what is wrong with them.
    """

    seconds: NDArray[np.float64] | None
    note: str
    remarks: tuple[Remark, ...] = ()


def point_times(table: NDArray[np.void], stamp: int, points: Points) -> PointTimes:
    """Find each point's time; unit and origin follow from the values of the usable points.

    ``stamp`` is the header stamp in nanoseconds, ``points`` what ``cloud_points`` returned. Times
    that count from neither the header nor the epoch (a sensor's own clock) are taken from the
    first point of the sweep.
    """
    name = next((name for name in TIME_FIELDS if name in (table.dtype.names or ())), None)
    if name is None:
        return PointTimes(None, 'no time of the points')
    values = table[name].astype(np.float64)
    # Points without a return often carry a time of zero; they say nothing about the sweep.
    with np.errstate(over='ignore', invalid='ignore'):  # signalling NaNs
        distance = np.abs(points[:, 0]) + np.abs(points[:, 1]) + np.abs(points[:, 2])
    usable = np.isfinite(distance) & (distance > 0.0) & np.isfinite(values)
    if not usable.any():
        return _unusable(f'field {name!r} holds no usable time')
    values, remarks = _without_absurd(name, values, usable)
    if remarks:
        usable &= np.isfinite(values)
    values, apart = _without_gap(values, usable)
    if apart:
        usable &= np.isfinite(values)
    if apart > _MOST_APART:
        return _unusable(f'field {name!r} falls into two parts, which is no sweep')
    if apart and not remarks:
        text = f'field {name!r}: {apart:.0%} of the times lie apart; these points are left out'
        remarks = (Remark('absurd_times', text),)
    times = _of(values, usable)
    if _noise(times, points, usable):
        return _unusable(f'field {name!r} is noise: neighbours in the cloud have any times')
    low, high = float(times.min()), float(times.max())
    if low == high:
        return _unusable(f'field {name!r} is constant, points are not de-skewed')
    unit = next((u for u, s in _UNITS.items() if _MIN_SWEEP < (high - low) * s <= _MAX_SWEEP), None)
    if unit is None:
        return _unusable(f'field {name!r} spans {high - low:g}, which is no sweep')
    scale = _UNITS[unit]
    if max(low, -high) * scale <= _BESIDE:
        note = f'field {name!r} in {unit} from the header stamp'
        return PointTimes(values * scale, note, remarks)
    # Doubles resolve today's epoch to 0.3 us, in every unit.
    header = stamp / NANOSECONDS / scale
    if max(abs(low - header), abs(high - header)) * scale <= _SAME_CLOCK:
        note = f'field {name!r} in {unit} of the epoch'
        return PointTimes((values - header) * scale, note, remarks)
    return PointTimes(
        (values - low) * scale,
        f'field {name!r} in {unit} on a clock of its own, taken from the first point',
        remarks,
    )


def _of(values: NDArray[Any], usable: NDArray[np.bool_]) -> NDArray[Any]:
    """The usable ones of (N, ...) values, where most often all are: then nothing is copied."""
    return values if usable.all() else values[usable]


def _without_gap(
    values: NDArray[np.float64], usable: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], float]:
    """Times with NaN for the smaller side of a gap that no sweep has, and that side's share."""
    times = _of(values, usable)
    if len(times) < _GAP_POINTS:
        return values, 0.0
    sample = np.sort(times[:: max(len(times) // _GAP_SAMPLE, 1)])
    gaps = np.diff(sample)
    widest = int(gaps.argmax())
    if gaps[widest] <= _GAP * (sample[-1] - sample[0]):
        return values, 0.0
    late = values > (sample[widest] + sample[widest + 1]) / 2.0
    smaller = late if late[usable].mean() < 0.5 else ~late
    return np.where(smaller, np.nan, values), float(smaller[usable].mean())


def _noise(times: NDArray[np.float64], points: Points, usable: NDArray[np.bool_]) -> bool:
    """Whether times have nothing to do with the order of the points, nor with their directions.

    ``times`` are those of the usable points.

    A cloud that somebody shuffled has them in no order, but neighbours by direction still agree.
    """
    span = float(np.ptp(times))
    if len(times) < _GAP_POINTS or span == 0.0:
        return False
    limit = _NOISE * span
    if float(np.abs(np.diff(times[:_NOISE_POINTS])).mean()) < limit:
        return False
    seen = _of(points, usable)
    around = np.argsort(np.arctan2(seen[:, 1], seen[:, 0]))
    return float(np.abs(np.diff(times[around])).mean()) >= limit


def _unusable(note: str) -> PointTimes:
    return PointTimes(None, note, (Remark('not_deskewed', note),))


def _without_absurd(
    name: str, values: NDArray[np.float64], usable: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], tuple[Remark, ...]]:
    """Point times with NaN for the few that lie far off the others, which make up the sweep."""
    times = _of(values, usable)
    sample = times[:: max(len(times) // _ABSURD_SAMPLE, 1)]
    early, late = np.quantile(sample, [_ABSURD_SHARE, 1.0 - _ABSURD_SHARE])
    reach = _REACH * (late - early)
    low, high = early - reach, late + reach
    # Without a span there is nothing to measure by; the time is constant, or next to it.
    if reach == 0.0 or (low <= times.min() and times.max() <= high):
        return values, ()
    absurd = usable & ((values < low) | (values > high))
    text = (
        f'field {name!r}: {int(absurd.sum())} of {int(usable.sum())} points have times far from '
        'all others, such as '
        f'{values[absurd][0]:g} where those are from {early:g} to {late:g}; these points are left '
        'out'
    )
    return np.where(absurd, np.nan, values), (Remark('absurd_times', text),)
