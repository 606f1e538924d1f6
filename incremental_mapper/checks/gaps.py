"""Holes in a recording: a sensor that is silent for longer than its rate allows."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding, Severity, listed
from incremental_mapper.measurements import NANOSECONDS

SILENCE = 1.0
"""Seconds that a LiDAR or an IMU may be silent: over longer ones scans are not matched
(``odometry.max_gap``). The longest hole of a sound recording here is the 0.3 s of an IMU at 10 Hz
that lost two samples (KITTI, synced)."""
PERIODS = 10.0
"""Usual distances of its messages that it may be silent at least: keyframes come 0.4 s to 2 s
apart (MulRan), which is no hole."""
UNEVEN = 2.0
"""How many times longer the longer ones of a sensor's steps are than the shorter ones (10 of 100
each) where it sends by the way that it went, not by time: then it is silent while the car stands.
Sensors that send by time have 1.0 to 1.2, keyframes of MulRan 2.0 with 6 s of silence."""
SHARE, FIX_SHARE = 0.2, 0.5
"""Share of the drive without a LiDAR or an IMU, without fixes, from which on it is told. All sound
recordings here have 0 to 0.07 of LiDAR and IMU (sensors that begin and end one after the other).
Tunnels cost fixes, so that half of them may be missing."""
LONGEST = 10.0
"""Seconds without a LiDAR or an IMU that are told whatever their share; an unaided IMU is off by
metres, a LiDAR alone by decimetres."""
LONGEST_PAUSE = 86_400.0
"""Seconds after which a drive that goes on is another one; a computer that starts without the time
is in 1970 until it learns it."""
SHORTEST_FIX_GAP, SHORT_DRIVE_GAP = 10.0, 2.0
"""Seconds without fixes that are nothing: a bridge, a row of trees; and where that would be most of
a short drive. Receivers send once a second."""


@dataclass(frozen=True, slots=True)
class Presence:
    """When one sensor was there; stamps in nanoseconds.

    Attributes:
        sensor: its name.
        first: its first stamp.
        last: its last.
        holes: beginning and end of each silence in between that is longer than its usual steps.
    """

    sensor: str
    first: int
    last: int
    holes: tuple[tuple[int, int], ...] = ()


def absence_findings(sensors: Sequence[Presence]) -> list[Finding]:
    """Say of which sensors a considerable part of the drive is missing.

    Args:
        sensors: those that sent at all, with stamps of one clock.

    Returns:
        ``sensor_absent``: a sensor that came late, died, or was away in between; ``clock_set``, an
        error, where time leaps by more than a day, and then nothing else.
    """
    lidars = [item for item in sensors if item.sensor not in ('imu', 'gnss')]
    if not lidars:
        return []
    leaps = [hole for item in lidars for hole in item.holes]
    longest = max(leaps, key=lambda hole: hole[1] - hole[0], default=(0, 0))
    if longest[1] - longest[0] > LONGEST_PAUSE * NANOSECONDS:
        return [_clock_set(*longest)]
    first, last = min(item.first for item in sensors), max(item.last for item in sensors)
    return [
        finding for item in sensors if (finding := _absence(item, first, last, lidars)) is not None
    ]


def _clock_set(before: int, after: int) -> Finding:
    days = (after - before) / NANOSECONDS / LONGEST_PAUSE
    return Finding(
        'clock_set',
        Severity.ERROR,
        '',
        f'time leaps by {days:.0f} days, from {before} to {after}: a computer that learned the '
        'time, or two drives in one recording; nothing tells how the map goes on there',
        'map the parts by themselves',
    )


def _absence(item: Presence, first: int, last: int, lidars: Sequence[Presence]) -> Finding | None:
    ends = [(first, item.first), (item.last, last)]
    seconds = (last - first) / NANOSECONDS
    fixes = item.sensor == 'gnss'
    most = max(SHORT_DRIVE_GAP, FIX_SHARE * seconds)
    least = min(SHORTEST_FIX_GAP, most) if fixes else SILENCE
    away = [
        (start, stop)
        for start, stop in sorted([*ends, *item.holes])
        if (stop - start) / NANOSECONDS >= least
    ]
    lengths = [(stop - start) / NANOSECONDS for start, stop in away]
    if sum(lengths) < (FIX_SHARE if fixes else SHARE) * seconds and (
        fixes or max(lengths, default=0.0) < LONGEST
    ):
        return None
    if not away:
        return None
    start, stop = away[int(np.argmax(lengths))]
    when = f'from {(start - first) / NANOSECONDS:.1f} s to {(stop - first) / NANOSECONDS:.1f} s'
    if stop == last:
        when = f'from {(start - first) / NANOSECONDS:.1f} s to the end'
    if len(away) > 1:
        when += f' and in {len(away) - 1} more holes'
    others = [other.sensor for other in lidars if other is not item]
    imu = item.sensor == 'imu'
    if fixes:
        remedy = 'the map hangs on its LiDARs there; see whether receiver or recorder lost them'
    elif imu:
        remedy = 'the map goes on without it there; see whether its driver lost messages'
    elif others:
        remedy = f'{listed(others)} alone map it there; see whether its driver lost messages'
    else:
        remedy = 'the way there is bridged and has no map; see whether its driver lost messages'
    return Finding(
        'sensor_absent',
        Severity.WARNING,
        item.sensor,
        f'{sum(lengths):.1f} of {seconds:.1f} s have no {"fix" if fixes else "message"} of it: '
        f'{when}',
        remedy,
    )


def is_uneven(steps: NDArray[np.float64]) -> bool:
    """Whether a sensor sends by the way that it went, so that its silences mean nothing.

    Args:
        steps: seconds from message to message (N,).
    """
    if len(steps) < 3:
        return False
    short, long = np.quantile(steps, (0.1, 0.9))
    return bool(long >= UNEVEN * short)


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
    if not holes.any() or is_uneven(steps[~holes]):
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
