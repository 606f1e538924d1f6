"""Pieces of a drive by motion, as in the paper's table: zero speed, acceleration and so on.

Positions are taken as they come from the truth or from an estimate, so speeds are smoothed: the
speed at a time is the distance between the positions half of ``SMOOTHING`` before and after it,
over that time, and the acceleration the same of the speed.
"""

from dataclasses import dataclass
from enum import StrEnum
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.trajectory import Trajectory

SMOOTHING = 1.0
"""Seconds over which speeds and accelerations are taken."""
STEP = 0.1
"""Seconds between the times that are looked at."""
STANDING = 0.3
"""A car slower than this, in m/s, stands: jitter of the truth stays below, driving does not."""
CHANGING = 0.3
"""Accelerations beyond this, in m/s^2, are meant; the paper's constant speed (18 to 22 km/h over
seven seconds and more) stays below, its accelerations (0 to 20 km/h in as long) above."""
SHORTEST = 1.0
"""Seconds; a shorter piece goes to its longer neighbour."""
EDGE = 1.0
"""Seconds before the first and after the last pose that still belong to the nearest piece."""


class Motion(StrEnum):
    """The paper's four motions, in its order."""

    ZERO = 'zero_speed'
    ACCELERATION = 'acceleration'
    CONSTANT = 'constant_speed'
    DECELERATION = 'deceleration'


@dataclass(frozen=True, slots=True)
class Segment:
    """A piece of a drive from ``start`` (ns, included) to ``end`` (ns, not included)."""

    motion: Motion
    start: int
    end: int

    @property
    def seconds(self) -> float:
        """Length in seconds."""
        return (self.end - self.start) / NANOSECONDS


def motion_of_name(sequence: str) -> tuple[Motion | None, str]:
    """Motion and rest of a name such as ``zero_speed_urban-26``; None where it tells none."""
    for motion in Motion:
        if sequence.startswith(f'{motion}_'):
            return motion, sequence.removeprefix(f'{motion}_')
    return None, sequence


def segment_by_motion(trajectory: Trajectory) -> tuple[Segment, ...]:
    """Cut a trajectory into pieces of one motion each, without gaps between them.

    Args:
        trajectory: The truth, or an estimate.

    Returns:
        The pieces in the order of time; none where the trajectory is shorter than ``SHORTEST``.
    """
    if len(trajectory) < 2 or trajectory.stamps[-1] - trajectory.stamps[0] < SHORTEST * NANOSECONDS:
        return ()
    first = int(trajectory.stamps[0])
    length = (trajectory.stamps[-1] - first) / NANOSECONDS
    times = np.arange(0.0, length + STEP / 2, STEP)
    speeds, accelerations = _smoothed(trajectory, np.minimum(times, length))
    labels = np.where(np.abs(accelerations) < CHANGING, 0, np.sign(accelerations)).astype(int)
    motions = {0: Motion.CONSTANT, 1: Motion.ACCELERATION, -1: Motion.DECELERATION}
    found = [
        Motion.ZERO if speed < STANDING else motions[label]
        for speed, label in zip(speeds.tolist(), labels.tolist(), strict=True)
    ]
    runs = [(motion, len(list(group))) for motion, group in groupby(found)]
    edges = [first]
    runs = _without_short_ones(runs, round(SHORTEST / STEP))
    for total in np.cumsum([count for _, count in runs]).tolist():
        # A sample stands for the time around it, so a piece ends between two samples.
        edges.append(first + round((total - 0.5) * STEP * NANOSECONDS))
    edges[-1] = int(trajectory.stamps[-1])
    return tuple(
        Segment(motion, start, end)
        for (motion, _), start, end in zip(runs, edges[:-1], edges[1:], strict=True)
    )


def segment_indices(stamps: NDArray[np.int64], segments: tuple[Segment, ...]) -> NDArray[np.int64]:
    """Which piece of a drive each stamp lies in.

    Args:
        stamps: Nanoseconds (M,).
        segments: Pieces that follow each other.

    Returns:
        Indices (M,), -1 for none. Stamps up to ``EDGE`` outside lie in the first and the last one.
    """
    if not segments:
        return np.full(len(stamps), -1)
    edge = round(EDGE * NANOSECONDS)
    starts = np.array([segment.start for segment in segments])
    starts[0] -= edge
    indices = np.searchsorted(starts, stamps, side='right') - 1
    indices[stamps > segments[-1].end + edge] = -1
    return indices


def _smoothed(
    trajectory: Trajectory, times: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Speeds m/s and accelerations m/s^2 at ``times`` (M,), seconds since the first pose."""
    own = (trajectory.stamps - trajectory.stamps[0]) / NANOSECONDS
    low = np.maximum(times - SMOOTHING / 2, 0.0)
    high = np.minimum(times + SMOOTHING / 2, own[-1])
    before, after = (
        np.stack([np.interp(t, own, trajectory.positions[:, i]) for i in range(3)], axis=1)
        for t in (low, high)
    )
    speeds = np.linalg.norm(after - before, axis=1) / (high - low)
    # Near the ends the times that speeds stand for are closer together than SMOOTHING.
    middles = (low + high) / 2
    gains = np.interp(high, middles, speeds) - np.interp(low, middles, speeds)
    spans = np.interp(high, middles, middles) - np.interp(low, middles, middles)
    return speeds, gains / spans


def _without_short_ones(runs: list[tuple[Motion, int]], shortest: int) -> list[tuple[Motion, int]]:
    """Give runs of fewer than ``shortest`` samples to their longer neighbour, shortest first."""
    runs = list(runs)
    while len(runs) > 1:
        index = min(range(len(runs)), key=lambda i: runs[i][1])
        if runs[index][1] >= shortest:
            break
        neighbours = [i for i in (index - 1, index + 1) if 0 <= i < len(runs)]
        heir = max(neighbours, key=lambda i: runs[i][1])
        runs[index] = (runs[heir][0], runs[index][1])
        merged: list[tuple[Motion, int]] = []
        for motion, group in groupby(runs, key=lambda run: run[0]):
            merged.append((motion, sum(count for _, count in group)))
        runs = merged
    return runs
