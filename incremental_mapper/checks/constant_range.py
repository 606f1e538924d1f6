"""Beams without a return that are written at one range: a sphere around the LiDAR is no surface."""

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.measurements import Points, Remark

NEAR = 1e-3
"""Metres about a range in which it is the same: coordinates in whole millimetres, and float32."""
SHARE = 0.02
"""Share of a cloud's points at one range that no surface explains. Real clouds (HDL-64E, VLP-16,
OS1-64, OS1-128) have 0.25 % of theirs at the most within a millimetre, simulated ones 0.23 %."""
FEWEST = 50
"""Points at one range that make a judgement."""
SPREAD = np.radians(1.5)
"""Angle that the middle eight of ten of them span in elevation, and in azimuth. Level ground
without noise is at one range along a ring, but then at one elevation; a wall is within a millimetre
of one range over 0.7 degrees at 10 m."""
SAMPLE = 4999
"""Points that are looked at; a prime, so that they are not all of one ring."""
FIRST, CROWD = 1000, 8
"""Points that are looked at first, and how many of them at one range make a closer look: 2 or 3 are
by chance, 20 where as many points are at one range as ``SHARE`` says."""
MOST_RANGES = 3
"""Ranges that a cloud is freed of: a driver has one for no return, or one for each kind of it."""


def without_constant_ranges(points: Points) -> tuple[Points, tuple[Remark, ...]]:
    """Leave out the points of a cloud that are at exactly one range in many directions.

    Args:
        points: Points (N, 3) in the LiDAR's frame, metres; not filtered.

    Returns:
        The points, NaN where they are left out, and what was wrong: ``constant_range``, or nothing.
    """
    found: list[tuple[float, int]] = []
    usable = 0
    while len(found) < MOST_RANGES:
        written = _constant_range(points)
        if written is None:
            break
        ranges = ranges_of(points)
        if not found:  # shares are told of the cloud as it came
            usable = int((np.isfinite(ranges) & (ranges > 0.0)).sum())
        at = np.abs(ranges - written) <= NEAR
        found.append((written, int(at.sum())))
        points = np.where(at[:, None], np.float32(np.nan), points)
    if not found:
        return points, ()
    told = ' and '.join(
        f'{count / usable:.0%} of the points at {written:.3f} m' for written, count in found
    )
    text = (
        f'{told} exactly, and in many directions: beams without a return, no surface; they are '
        'left out (let the driver write NaN for them)'
    )
    return points, (Remark('constant_range', text),)


def _constant_range(points: Points) -> float | None:
    """The range at which too many points are, metres."""
    if len(points) < FEWEST:
        return None
    if len(points) > FIRST and not _crowded(points):
        return None
    sample = points
    if len(points) > SAMPLE:
        sample = points[np.arange(SAMPLE) * len(points) // SAMPLE]
    ranges = ranges_of(sample)
    usable = np.isfinite(ranges) & (ranges > 0.0)
    sample, ranges = sample[usable], ranges[usable]
    fewest = max(FEWEST, int(np.ceil(SHARE * len(ranges))))
    if len(ranges) < fewest:
        return None
    ordered = np.sort(ranges)
    starts = np.arange(len(ordered) - fewest + 1)
    narrow = ordered[starts + fewest - 1] - ordered[starts] <= NEAR
    middles = ordered[starts[narrow] + fewest // 2]
    # Rings on level ground are met one by one; what is at one range all about is looked for.
    while len(middles):
        middle = float(middles[len(middles) // 2])
        if _all_about(sample[np.abs(ranges - middle) <= NEAR]):
            return middle
        middles = middles[np.abs(middles - middle) > NEAR]
    return None


def _crowded(points: Points) -> bool:
    """Whether some of a few points are at one range: most clouds are done with that."""
    ranges = ranges_of(points[np.arange(FIRST) * len(points) // FIRST])
    ranges = np.sort(ranges[(ranges > 0.0) & (ranges < np.inf)])
    if len(ranges) < CROWD:
        return False
    return bool((ranges[CROWD - 1 :] - ranges[: 1 - CROWD] <= NEAR).any())


def _all_about(points: Points) -> bool:
    """Whether points are in directions that no surface at one range has."""
    across = np.hypot(points[:, 0], points[:, 1])
    angles = np.arctan2(points[:, 2], across), np.arctan2(points[:, 1], points[:, 0])
    return all(np.ptp(np.quantile(part, (0.1, 0.9))) > SPREAD for part in angles)


def ranges_of(points: Points) -> NDArray[np.float64]:
    """Ranges (N,) of points (N, 3), metres; infinite or NaN where coordinates are absurd."""
    with np.errstate(over='ignore', invalid='ignore'):  # signalling NaNs, absurd coordinates
        wide = points.astype(np.float64)
        ranges: NDArray[np.float64] = np.sqrt(np.einsum('ij,ij->i', wide, wide))
    return ranges
