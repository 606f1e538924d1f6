"""The unit of a LiDAR's points, by the way that the fixes say."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding, Severity

UNITS = {'feet': 0.3048, 'inches': 0.0254}
"""Metres of units that look like metres in a single cloud, or nearly."""
STRETCH = 5.0
"""Metres between two fixes that tell a distance."""
OUT_OF_NOISE = 10.0
"""How many of their standard deviations two fixes are apart at least, where they do."""
FEWEST = 3
"""Such distances that make a judgement."""
EXACT, SCATTER = 0.05, 0.15
"""Relative deviation of their median from a unit's, and of four of five of them from the median.
Simulated drives and KITTI read 0.93 to 1.01 times the way of the fixes with gicp."""


def way_ratios(
    ways: NDArray[np.float64], enu: NDArray[np.float64], sigma: float
) -> NDArray[np.float64]:
    """Way by odometry over way by the fixes (S,), for stretches that stand out from their noise.

    Args:
        ways: Way (K,) that odometry had come to at each fix, in the unit of the points.
        enu: East and north of the fixes (K, 2), metres.
        sigma: Their median deviation, metres.
    """
    ratios, last = [], 0
    for index in range(1, len(enu)):
        apart = float(np.hypot(*(enu[index] - enu[last])))
        if apart > max(STRETCH, OUT_OF_NOISE * sigma):
            ratios.append(float(ways[index] - ways[last]) / apart)
            last = index
    return np.array(ratios)


def unit_finding(
    lidars: Sequence[str], ratios: NDArray[np.float64], scales: Mapping[str, float]
) -> Finding | None:
    """Say whether the way is that of the fixes in another unit.

    Args:
        lidars: Names of the LiDARs that read the same way.
        ratios: What ``way_ratios`` returned.
        scales: What the points of each LiDAR are multiplied by already.

    Returns:
        ``point_unit``, mended, or None.
    """
    if len(ratios) < FEWEST or not lidars:
        return None
    ratio = float(np.median(ratios))
    if np.quantile(np.abs(ratios / ratio - 1.0), 0.8) > SCATTER:
        return None
    for name, metre in UNITS.items():
        if abs(ratio * metre - 1.0) < EXACT:
            tree = {lidar: {'scale': round(metre * scales.get(lidar, 1.0), 6)} for lidar in lidars}
            lines = [f'lidars.{lidar}.scale: {part["scale"]:g}' for lidar, part in tree.items()]
            return Finding(
                'point_unit',
                Severity.MENDED,
                ', '.join(lidars),
                f'odometry reads {ratio:.2f} times the way that the fixes say, over {len(ratios)} '
                f'stretches: the points are in {name}',
                f'converted; {", ".join(lines)}',
                {'lidars': tree},
            )
    return None
