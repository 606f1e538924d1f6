"""Whether a LiDAR's points are as far away as something around a vehicle is."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.constant_range import ranges_of
from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.measurements import Points

SHARES = (0.02, 0.5, 0.98)
"""Shares of the points of which the ranges are looked at."""
FARTHEST = (12.0, 30.0, 200.0)
"""Metres for these shares that nothing around a vehicle reaches, all three at once. Real clouds
(VLP-16, HDL-64E, OS1-64, OS1-128) have 2 to 6, 6 to 15 and 39 to 84; in decimetres they are beyond
all three. From an aircraft the ground may be as far, which is why it is no error."""
FEWEST = 50
"""Points that make a judgement."""
CLOUDS = 5
"""Clouds that make one; most of them must say so."""


def point_ranges(points: Points) -> NDArray[np.float64] | None:
    """Ranges (3,) of the ``SHARES`` of a cloud's points, metres; None where they are few.

    Args:
        points: Points (N, 3) in the LiDAR's frame, metres.
    """
    ranges = ranges_of(points[:: max(len(points) // 2000, 1)])
    ranges = ranges[np.isfinite(ranges) & (ranges > 0.0)]
    return np.quantile(ranges, SHARES) if len(ranges) >= FEWEST else None


def far_points(lidar: str, looks: Sequence[NDArray[np.float64]]) -> Finding | None:
    """Say where a LiDAR's points are too far away to be in metres.

    Args:
        lidar: Name of the LiDAR.
        looks: What ``point_ranges`` returned for ``CLOUDS`` clouds.

    Returns:
        ``points_far_away``, or None.
    """
    near, middle, far = np.median(np.array(looks), axis=0).tolist()
    if not all(own > most for own, most in zip((near, middle, far), FARTHEST, strict=True)):
        return None
    return Finding(
        'points_far_away',
        Severity.WARNING,
        lidar,
        f'98 of 100 of its points are more than {near:.0f} m away, half of them more than '
        f'{middle:.0f} m, and the farthest beyond {far:.0f} m: nothing around a vehicle is, they '
        'are hardly in metres',
        f'lidars.{lidar}.scale: 0.1 if they are in decimetres, 0.01 in centimetres, 0.001 in '
        'millimetres; right from an aircraft',
    )
