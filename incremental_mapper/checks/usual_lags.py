"""How late a sensor's messages are recorded all along, so that those with another lag are stray."""

from collections.abc import Sequence

import numpy as np

from incremental_mapper.checks.clocks import MOST_LATENCY
from incremental_mapper.checks.sensor_clocks import SensorClock
from incremental_mapper.measurements import NANOSECONDS

_ALIKE, _ENDS = 4, 3
"""Messages with the same lag that make a usual one; it is among so many first, and last, ones."""
_STEEP = 0.3
"""Seconds a second by which latencies may grow; where record times run otherwise they do more."""


def usual_lags(clocks: Sequence[SensorClock]) -> dict[str, int]:
    """Lags that sensors have from the beginning to the end of a recording.

    Args:
        clocks: some stamps of every sensor, spread over the recording.

    Returns:
        Nanoseconds from stamp to record time, by sensor; without those whose clock is set in the
        recording, or of which nobody knows.
    """
    usual: dict[str, int] = {}
    for clock in clocks:
        if clock.received is None or not len(clock.stamps):
            continue
        order = np.argsort(clock.received, kind='stable')
        lags = (clock.received - clock.stamps)[order]
        middle = int(np.median(lags))
        near = np.flatnonzero(np.abs(lags - middle) < MOST_LATENCY * NANOSECONDS)
        # A clock that is set in the recording has the usual lag before or after it only.
        lasting = len(near) and near[0] < _ENDS and near[-1] >= len(lags) - _ENDS
        if not lasting or len(near) < max(_ALIKE, 0.5 * len(lags)):
            continue
        # In a second even the lags of a bag that is played ten times as fast are near each other.
        times = clock.received[order][near]
        slope = np.polyfit(times - times[0], lags[near] - middle, 1)[0] if np.ptp(times) else 1.0
        if abs(slope) < _STEEP:
            usual[clock.sensor] = middle
    return usual
