"""What a LiDAR is like, from a few of its scans: how dense, how it looks around, how it sits."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.measurements import LidarScan

_STEP = 0.05
"""Degrees of elevation; beams are 0.3 to 2 degrees apart."""
_FAR = 4.0
"""Metres; nearer, a beam's own origin shifts its elevation."""
_CREST = 0.15
"""Share of a strong beam's points that a weak one has at least."""
_ABOVE, _AROUND_BINS = 1.2, 7
"""How far a crest stands out from the mean of so many steps around it."""
_USUAL = (1, 4, 8, 16, 32, 40, 64, 80, 128)
_NEAR_USUAL = 0.2
_BINS = 72
_AROUND = 15.0
"""Metres around the LiDAR in which the ground is looked for."""


@dataclass(frozen=True, slots=True)
class LidarShape:
    """A LiDAR as its scans show it.

    Attributes:
        points: usable points of a scan, median.
        beams: about so many elevations, 0 where they are no beams.
        near: metres within which the nearest hundredth of the points is.
        far: metres within which all but a hundredth are.
        turn: share of the directions around it in which it sees anything.
        tilt: degrees between its upward axis and the car's.
        height: metres above the ground around it, None where it is tilted.
        timed: whether its points have times.
    """

    points: int
    beams: int
    near: float
    far: float
    turn: float
    tilt: float
    height: float | None
    timed: bool


def lidar_shape(scans: Sequence[LidarScan], T_base_lidar: NDArray[np.float64]) -> LidarShape | None:
    """Look at some scans of a LiDAR.

    Args:
        scans: some of them.
        T_base_lidar: its pose on the car (4, 4).

    Returns:
        What they show; None where there are none.
    """
    if not scans:
        return None
    fullest = sorted(scans, key=lambda scan: len(scan.points))[len(scans) // 2]
    points = fullest.points.astype(np.float64)
    ranges = np.linalg.norm(points, axis=1)
    near, far = np.quantile(ranges, [0.01, 0.99])
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    index = ((azimuth / (2.0 * np.pi) + 0.5) * _BINS).astype(int) % _BINS
    tilt = float(np.degrees(np.arccos(np.clip(T_base_lidar[2, 2], -1.0, 1.0))))
    level = tilt < 10.0
    around = points[ranges < _AROUND, 2]
    return LidarShape(
        points=len(points),
        beams=_beams(points[ranges > _FAR]),
        near=float(near),
        far=float(far),
        turn=float((np.bincount(index, minlength=_BINS) > 0).mean()),
        tilt=tilt,
        height=float(-np.quantile(around, 0.05)) if level and len(around) else None,
        timed=fullest.point_times is not None,
    )


def _beams(points: NDArray[np.float64]) -> int:
    """How many elevations the points crowd at; the usual number that is near, if there is one."""
    if len(points) < 100:
        return 0
    elevation = np.degrees(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])))
    edges = np.arange(elevation.min() - 1.0, elevation.max() + 1.0, _STEP)
    counts = np.convolve(np.histogram(elevation, edges)[0], [0.25, 0.5, 0.25], 'same')
    strong = float(np.quantile(counts[counts > 0], 0.9))
    inside = counts[1:-1]
    around = np.convolve(counts, np.full(_AROUND_BINS, 1.0 / _AROUND_BINS), 'same')[1:-1]
    crest = (inside > counts[:-2]) & (inside >= counts[2:]) & (inside > _CREST * strong)
    crest &= inside > _ABOVE * around
    found = int(crest.sum())
    usual = min(_USUAL, key=lambda number: abs(number - found))
    return usual if abs(usual - found) <= _NEAR_USUAL * usual else found
