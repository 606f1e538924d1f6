"""Holes in a recording: a sensor that is silent for longer than its rate allows."""

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.measurements import NANOSECONDS

SILENCE = 1.0
"""Seconds that a LiDAR or an IMU may be silent: over longer ones scans are not matched
(``odometry.max_gap``). The longest hole of a sound recording here is the 0.3 s of an IMU at 10 Hz
that lost two samples (KITTI, synced)."""
PERIODS = 10.0
"""Usual distances of its messages that it may be silent at least: keyframes come 0.4 s to 2 s
apart (MulRan), which is no hole."""


def silences(sensor: str, recorded: NDArray[np.int64]) -> list[Finding]:
    """Find holes in the times of a sensor's messages.

    Args:
        sensor: its name.
        recorded: when all its messages were recorded (N,), ns ascending.

    Returns:
        A warning with the longest hole, if there is any.
    """
    if len(recorded) < 3:
        return []
    steps = np.diff(recorded) / NANOSECONDS
    least = max(SILENCE, PERIODS * float(np.median(steps)))
    holes = steps > least
    if not holes.any():
        return []
    worst = int(np.argmax(steps))
    after = (recorded[worst] - recorded[0]) / NANOSECONDS
    count = int(holes.sum())
    text = f'nothing for {steps[worst]:.1f} s, {after:.1f} s after its first message'
    if count > 1:
        text += f', and {count - 1} more such holes, {float(steps[holes].sum()):.1f} s together'
    return [
        Finding(
            'silent_sensor',
            Severity.WARNING,
            sensor,
            text,
            'the map bridges it by the other sensors; see whether driver or recorder lost them',
        )
    ]
