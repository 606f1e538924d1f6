"""From a window's raw measurements to what factors are made of."""

from collections import Counter
from dataclasses import dataclass
from typing import TypeAlias

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.candidates.clusters import CoreKind, CoreMeasurement
from incremental_mapper.config import Config
from incremental_mapper.errors import MeasurementError
from incremental_mapper.frontend.clouds import STANDING, BaseScan, Twist, thin, to_base
from incremental_mapper.frontend.geodesy import Datum, checked_covariance
from incremental_mapper.frontend.odometry import ScanMatcher, make_matcher
from incremental_mapper.measurements import Drops, GnssFix, LidarScan
from incremental_mapper.trajectory import NANOSECONDS
from incremental_mapper.windows.buffer import CoreInput

MAX_SURPRISE = 1.5
"""Metres between two scans that a match may differ from steady motion: no car brakes like that."""


@dataclass(frozen=True, slots=True, eq=False)
class PreparedScan:
    """A scan with its odometry.

    ``thinned`` (N, 3) are its points in base_link for the map, ``sparse`` (M, 3) those for
    scoring, metres.
    ``T_previous_current`` links it to the scan of the same LiDAR at ``previous``; both are None
    where there is no odometry.
    """

    core: CoreMeasurement
    thinned: NDArray[np.float64]
    sparse: NDArray[np.float64]
    previous: int | None
    T_previous_current: gtsam.Pose3 | None


@dataclass(frozen=True, slots=True, eq=False)
class PreparedFix:
    """A fix as antenna position (3,) and covariance (3, 3) in local ENU, metres."""

    core: CoreMeasurement
    enu: NDArray[np.float64]
    covariance: NDArray[np.float64]


Prepared: TypeAlias = PreparedScan | PreparedFix


@dataclass(slots=True)
class _Chain:
    """One LiDAR's matcher, its last scan's stamp, and its motion then."""

    matcher: ScanMatcher
    stamp: int | None = None
    twist: Twist = STANDING
    matched: bool = False


class FrontEnd:
    """Scan matching per LiDAR, and fixes in local ENU around the first one used."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._chains: dict[str, _Chain] = {}
        self._T_base_lidar = {name: lidar.matrix() for name, lidar in config.lidars.items()}
        self.datum: Datum | None = None
        self.drops: Drops = Counter()
        self.notes: Counter[str] = Counter()  # what was used, but not in full

    def prepare(self, core: tuple[CoreInput, ...]) -> list[Prepared]:
        """Prepare a window's core measurements in time order; the unusable are counted."""
        prepared: list[Prepared] = []
        for measurement in core:
            try:
                if isinstance(measurement, LidarScan):
                    prepared.append(self._scan(measurement))
                else:
                    prepared.append(self._fix(measurement))
            except MeasurementError as error:
                self.drops[measurement.sensor, error.reason] += 1
        return prepared

    def _fix(self, fix: GnssFix) -> PreparedFix:
        covariance = checked_covariance(fix, self._config.fixes)
        if self.datum is None:
            self.datum = Datum(fix.latitude, fix.longitude, fix.altitude)
        core = CoreMeasurement(fix.stamp, fix.sensor, CoreKind.GNSS)
        return PreparedFix(core, self.datum.enu(fix), covariance)

    def _scan(self, scan: LidarScan) -> PreparedScan:
        settings = self._config.odometry
        chain = self._chains.get(scan.sensor)
        if chain is None:
            chain = self._chains[scan.sensor] = _Chain(make_matcher(settings))
        base = to_base(
            scan,
            self._T_base_lidar.get(scan.sensor, np.eye(4)),
            settings.min_range,
            settings.max_range,
            chain.twist if settings.deskew else None,
        )
        if len(base.points) == 0:
            raise MeasurementError(
                'no_points_in_range', f'{scan.sensor} at {scan.stamp}: no point within range'
            )
        thinned = thin(base.points, self._config.map.voxel_size)
        previous, motion = self._match(chain, base, len(thinned))
        core = CoreMeasurement(scan.stamp, scan.sensor, CoreKind.LIDAR)
        sparse = thin(thinned, self._config.mom.voxel_size)
        return PreparedScan(core, thinned, sparse, previous, motion)

    def _match(
        self, chain: _Chain, scan: BaseScan, useful: int
    ) -> tuple[int | None, gtsam.Pose3 | None]:
        settings = self._config.odometry
        if useful < settings.min_points:
            # The next scan is matched to the one before this, so the chain stays whole.
            self.notes[f'{scan.sensor}: too few points to match'] += 1
            return None, None
        gap = None if chain.stamp is None else (scan.stamp - chain.stamp) / NANOSECONDS
        if gap is not None and not 0.0 < gap <= settings.max_gap:
            self.notes[f'{scan.sensor}: gap too long to match'] += 1
            chain.matcher, chain.twist, chain.matched = make_matcher(settings), STANDING, False
            gap = None
        guess = gtsam.Pose3.Expmap(
            np.concatenate([chain.twist.angular, chain.twist.linear]) * (gap or 0.0)
        )
        match = chain.matcher.match(scan.points, guess)
        previous, chain.stamp = chain.stamp, scan.stamp
        if match is None or gap is None:
            return None, None
        tangent = gtsam.Pose3.Logmap(match.T_previous_current) / gap
        twist = Twist(linear=tangent[3:], angular=tangent[:3])
        surprise = float(np.linalg.norm(twist.linear - chain.twist.linear)) * gap
        if not np.isfinite(tangent).all() or (chain.matched and surprise > MAX_SURPRISE):
            self.notes[f'{scan.sensor}: match rejected'] += 1
            chain.matcher, chain.twist, chain.matched = make_matcher(settings), STANDING, False
            chain.matcher.match(scan.points, gtsam.Pose3())
            return None, None
        chain.twist, chain.matched = twist, True
        return previous, match.T_previous_current
