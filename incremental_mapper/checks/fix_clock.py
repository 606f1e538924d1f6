"""Whether fixes are where odometry says that the car was then, or a while before or after.

A receiver's clock that is off shifts the track of the fixes along itself. On a straight road at one
speed that is a shift like any other; where the car turns or changes its speed, only one lag lays
the two tracks on each other.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.checks.fix_shape import metres, misfit
from incremental_mapper.measurements import NANOSECONDS

FEWEST = 10
"""Fixes that are compared at every lag."""
MOST, STEP = 3.0, 0.05
"""Seconds by which the clock is looked for, before and after, and between two lags."""
SHARE = 0.2
"""Share of the time of the fixes by which they may be shifted at most, for what is left must do."""
LEAST = 0.1
"""Seconds of which a user is told. Sound drives: at most 0.05 s wherever the lag shows at all."""
BETTER, EITHER = 0.4, 0.7
"""Share of the misfit that is left with the lag, of all fixes and of either half of them."""
NOISE = 3.0
"""So many deviations of the fixes the misfit is at least without the lag, and ..."""
OFF = 0.3
"""... metres: less is what odometry drifts."""


@dataclass(frozen=True, slots=True, eq=False)
class TimedTracks:
    """Fixes, and the way of the antenna by odometry.

    Attributes:
        stamps: Stamps of the fixes (K,), ns, ascending.
        degrees: Their latitude and longitude (K, 2).
        sigma: Their median horizontal deviation, metres.
        moments: Stamps of the places (N,), ns, ascending.
        places: Places (N, 2) by odometry, metres.
    """

    stamps: NDArray[np.int64]
    degrees: NDArray[np.float64]
    sigma: float
    moments: NDArray[np.int64]
    places: NDArray[np.float64]


def clock_finding(sensor: str, tracks: TimedTracks, time_offset: float) -> Finding | None:
    """Look for the lag at which the fixes lie on odometry's way.

    Args:
        sensor: Name of the receiver.
        tracks: Of a few hundred metres, over which odometry hardly drifts.
        time_offset: Seconds that are added to the receiver's stamps already.

    Returns:
        ``gnss_clock``, mended; None where the fixes lie on it as they are, or at no lag.
    """
    if len(tracks.stamps) < FEWEST or len(tracks.moments) < FEWEST:
        return None
    origin = int(tracks.moments[0])
    moments = (tracks.moments - origin) / NANOSECONDS
    at = (tracks.stamps - origin) / NANOSECONDS
    most = round(min(MOST, SHARE * float(np.ptp(at))) / STEP)
    # The same fixes at every lag.
    inside = (at - most * STEP >= moments[0]) & (at + most * STEP <= moments[-1])
    if inside.sum() < FEWEST:
        return None
    at, enu = at[inside], metres(tracks.degrees[inside])

    def off(lag: float, part: slice = slice(None), scaled: bool = True) -> float:
        there = [np.interp(at[part] + lag, moments, column) for column in tracks.places.T]
        return misfit(enu[part], np.stack(there, axis=1), scaled)

    # Odometry of thin clouds reads some per cent too little, which a lag may seem to make good: the
    # size of its track is no matter here, but the lag is found without that freedom.
    now = off(0.0)
    if now < max(OFF, NOISE * tracks.sigma):
        return None
    lags = STEP * np.arange(-most, most + 1)
    best = int(np.argmin([off(float(lag), scaled=False) for lag in lags]))
    lag = float(lags[best])
    left = off(lag)
    if abs(lag) < LEAST or best in (0, len(lags) - 1) or left > BETTER * now:
        return None
    halves = (slice(None, len(at) // 2), slice(len(at) // 2, None))
    if any(off(lag, half) > max(EITHER * off(0.0, half), tracks.sigma) for half in halves):
        return None
    offset = round(time_offset + lag, 3)
    return Finding(
        'gnss_clock',
        Severity.MENDED,
        sensor,
        f"its clock is {abs(lag):.2f} s {'behind' if lag > 0.0 else 'ahead of'} the LiDARs': "
        f'{len(at)} fixes are off the way of odometry by {now:.1f} m as they are, and by '
        f'{left:.1f} m with that put right',
        f'shifted; gnss.time_offset: {offset:g}',
        {'gnss': {'time_offset': offset}},
    )
