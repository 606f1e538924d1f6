"""Clouds that are parts of a sweep, gathered into whole sweeps."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.measurements import NANOSECONDS, LidarScan, Remark

NO_POINTS = ('empty_cloud', 'no_finite_points')
"""Reasons for which a sector is none, and its sweep is whole without it."""
LONGEST_SWEEP_S = 0.5
"""No LiDAR turns slower than twice a second."""
_TURN = 2.0 * math.pi


@dataclass(frozen=True, slots=True, eq=False)
class _Sector:
    """A part of a sweep, and the direction of its middle, in radians about the LiDAR's axis."""

    scan: LidarScan
    middle: float


class SectorGatherer:
    """Joins the sectors of one LiDAR into sweeps.

    A sweep ends where the next sector looks where the first one looked: after a turn, or, of a
    LiDAR that sees less than half a turn, after the jump back. It has the stamp of its last sector,
    so that it comes in order, and the time of every point relative to that. Points without times
    of their own are given them by their direction, as the LiDAR turns.
    """

    def __init__(self) -> None:
        self._sectors: list[_Sector] = []
        self._progress = 0.0
        self._trend = 0.0
        self._usual = 0

    def take(self, sector: LidarScan) -> LidarScan | None:
        """Take in the next sector; returns the sweep before it where it begins a new one."""
        horizontal = sector.points[:, :2]
        reach = np.linalg.norm(horizontal, axis=1)
        usable = horizontal[reach > 0.0] / reach[reach > 0.0, None]
        if not len(usable):
            return None
        east, north = usable.mean(axis=0)
        part = _Sector(sector, math.atan2(north, east))
        step = self._step(part)
        total = self._progress + step
        # Half a step may be missing: sectors need not divide the turn.
        ends = bool(self._sectors) and (
            self._looks_as_the_first(part)
            or total >= _TURN - step / 2.0
            or sector.stamp - self._sectors[0].scan.stamp > LONGEST_SWEEP_S * NANOSECONDS
        )
        sweep = self._join() if ends else None
        self._usual = len(self._sectors) if ends else self._usual
        if ends:
            self._sectors, total = [], 0.0
        self._progress = total
        self._sectors.append(part)
        return sweep

    def finish(self) -> LidarScan | None:
        """Give the sweep that has begun, where most of it is there, and forget it."""
        sweep = self._join() if 2 * len(self._sectors) > self._usual else None
        self._sectors, self._progress = [], 0.0
        return sweep

    def _join(self) -> LidarScan | None:
        """The sweep of the sectors that are waiting."""
        sectors = self._sectors
        if not sectors:
            return None
        last = sectors[-1].scan
        rate = self._rate(sectors)
        times = [_times(sector, last.stamp, rate) for sector in sectors]
        light = [sector.scan.intensities for sector in sectors]
        known = [part for part in light if part is not None]
        remarks: dict[str, Remark] = {}
        for sector in sectors:
            for remark in sector.scan.remarks:
                remarks.setdefault(remark.reason, remark)
        return replace(
            last,
            points=np.concatenate([sector.scan.points for sector in sectors]),
            point_times=np.concatenate(times),
            intensities=np.concatenate(known) if len(known) == len(sectors) else None,
            remarks=tuple(remarks.values()),
        )

    def _step(self, part: _Sector) -> float:
        """Radians from the sector before to this one, the way the LiDAR turns."""
        if not self._sectors:
            return 0.0
        difference = _wrapped(part.middle - self._sectors[-1].middle)
        # Of each sweep only the jump back goes the other way.
        self._trend = 0.9 * self._trend + math.copysign(1.0, difference)
        return float((difference if self._trend >= 0.0 else -difference) % _TURN)

    def _looks_as_the_first(self, part: _Sector) -> bool:
        """Whether a sector is nearer to the first one than half of any step so far."""
        if len(self._sectors) < 2:
            return False
        middles = np.array([sector.middle for sector in self._sectors])
        steps = np.abs(_wrapped(np.diff(middles)))
        return bool(abs(_wrapped(part.middle - middles[0])) < steps.min() / 2.0)

    def _rate(self, sectors: list[_Sector]) -> float:
        """Seconds for each radian about the axis, with its sign; 0 where nothing tells."""
        if len(sectors) < 3:
            return 0.0
        middles = np.unwrap([sector.middle for sector in sectors])
        stamps = np.array([sector.scan.stamp - sectors[0].scan.stamp for sector in sectors])
        turned = float(np.median(np.diff(middles)))
        passed = float(np.median(np.diff(stamps))) / NANOSECONDS
        return passed / turned if abs(turned) > 0.0 else 0.0


def _times(sector: _Sector, stamp: int, rate: float) -> NDArray[np.float32]:
    """Seconds of a sector's points after ``stamp``."""
    scan = sector.scan
    shift = (scan.stamp - stamp) / NANOSECONDS
    if scan.point_times is not None:
        return scan.point_times + np.float32(shift)
    azimuth = np.arctan2(scan.points[:, 1], scan.points[:, 0]) - sector.middle
    within = _wrapped(azimuth) * rate
    times: NDArray[np.float32] = (within + shift).astype(np.float32)
    return times


def _wrapped(angle: Any) -> Any:
    """An angle, or an array of them, between -pi and pi."""
    return (angle + math.pi) % _TURN - math.pi
