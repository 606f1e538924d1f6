"""LiDAR odometry: a LiDAR's raw scans in, points in base_link with their odometry out.

Each LiDAR has a chain of matched scans. The chain deskews and matches, and decides what to do
with bad matches; it knows nothing of other sensors.
"""

from collections import Counter
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.candidates.model import CoreKind, CoreMeasurement
from incremental_mapper.config import Config, OdometrySettings
from incremental_mapper.errors import MeasurementError
from incremental_mapper.frontend.gap_matching import LONG
from incremental_mapper.frontend.match_noise import WEAK, carried, weak_directions
from incremental_mapper.frontend.preprocessing import STANDING, Sweep, Twist, deskew, to_base
from incremental_mapper.frontend.registration import Match, make_matcher
from incremental_mapper.measurements import NANOSECONDS, LidarScan
from incremental_mapper.voxels import thin, voxel_means

MAX_SURPRISE = 1.5
"""Metres between two scans that a match may differ from steady motion: no car brakes like that."""
BRAKING, AT_ONCE = 4.0, 0.3
"""m/s^2 by which a vehicle may change its speed beside, where scans are further apart than so many
seconds."""
MAX_REJECTED = 3
"""After so many bad matches in a row it is the scan they were held against that was bad."""
RESTARTS = 4
"""Rounds in which the first two scans and their motion are brought to agree."""
FEWEST_PLACES = 10
"""Places, voxels with points, below which a cloud is no scan of anything: it cannot be matched
whatever the settings (``odometry.min_points``), and what it adds to a map is not worth a pose."""
MATCHING_SHARE = 0.3
"""Scans are thinned for the map before they are thinned again for matching: at most to this
share of the matcher's voxels, or a coarse map would cost odometry."""


@dataclass(frozen=True, slots=True, eq=False)
class PreparedScan:
    """A scan with its odometry.

    ``thinned`` (N, 3) are its points in base_link for the map, in the map's single precision; it
    is (N, 4) with their intensities where the LiDAR measures them. ``sparse`` (M, 3) are the points
    for scoring, metres.
    ``T_previous_current`` links it to the scan of the same LiDAR at ``previous``; both are None
    where there is no odometry. ``covariance`` (6, 6) is that of this motion, in the frame of the
    scan and in GTSAM's order, rotation before translation; None where the matcher does not tell.
    ``usable`` says that the next scan may link to this one.
    """

    core: CoreMeasurement
    thinned: NDArray[np.float32]
    sparse: NDArray[np.float64]
    previous: int | None
    T_previous_current: gtsam.Pose3 | None
    usable: bool = True
    covariance: NDArray[np.float64] | None = None


class ScanPreparer:
    """Thins, matches and deskews the scans of one LiDAR, in their order.

    It knows nothing of other sensors: what it takes and gives can be pickled, so it may as well
    live in a process of its own.
    """

    def __init__(self, name: str, config: Config, notes: Counter[str]) -> None:
        """Make ready for the LiDAR ``name``; ``notes`` counts what was used, but not in full."""
        lidar = config.lidars.get(name)
        self._odometry = config.odometry
        self._T_base_lidar = np.eye(4) if lidar is None else lidar.matrix()
        self._map_voxel = config.map.voxel_size
        self._sparse_voxel = config.mom.voxel_size
        self._voxel = min(self._map_voxel, MATCHING_SHARE * config.odometry.voxel_size)
        self._chain = LidarChain(name, config.odometry, notes)

    def prepare(self, scan: LidarScan) -> PreparedScan:
        """The next scan with its odometry.

        Args:
            scan: As the message has it.

        Returns:
            Its points in base_link and how it lies to the scan before.

        Raises:
            MeasurementError: No point is in range, or the points are in hardly any place.
        """
        odometry = self._odometry
        sweep = to_base(
            scan,
            self._T_base_lidar,
            odometry.min_range,
            odometry.max_range,
            self._voxel,
            odometry.deskew,
        )
        if len(sweep) == 0:
            raise MeasurementError(
                'no_points_in_range', f'{scan.sensor} at {scan.stamp}: no point within range'
            )
        if len(sweep) < FEWEST_PLACES:
            raise MeasurementError(
                'too_few_points',
                f'{scan.sensor} at {scan.stamp}: {len(scan.points)} points in {len(sweep)} places '
                f'within range, {FEWEST_PLACES} are the least',
            )
        link = self._chain.add(sweep)
        rows = link.points.T
        if sweep.intensities is not None:
            rows = np.vstack([rows, sweep.intensities])
        if self._map_voxel > self._voxel:
            rows = voxel_means(rows, self._map_voxel)
        return PreparedScan(
            core=CoreMeasurement(scan.stamp, scan.sensor, CoreKind.LIDAR),
            thinned=rows.T.astype(np.float32, order='C'),
            sparse=thin(rows[:3].T, self._sparse_voxel),
            previous=link.previous,
            T_previous_current=link.T_previous_current,
            usable=link.usable,
            covariance=link.covariance,
        )


@dataclass(frozen=True, slots=True, eq=False)
class ChainLink:
    """A scan at its stamp in base_link and its odometry.

    ``points`` (N, 3) are in metres. ``previous``, ``T_previous_current`` and ``covariance`` are as
    in PreparedScan. ``usable`` says that the next scan may be matched to this one.
    """

    points: NDArray[np.float64]
    previous: int | None = None
    T_previous_current: gtsam.Pose3 | None = None
    usable: bool = True
    covariance: NDArray[np.float64] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Motion from stamp to stamp that is believed, and its covariance, see ``PreparedScan``."""

    pose: gtsam.Pose3
    covariance: NDArray[np.float64] | None


class LidarChain:
    """Matches the scans of one LiDAR; remembers its last good scan and the motion then.

    Scans are matched at the middle of their sweeps. At the stamp, an error of the twist would
    shift the cloud; the shift would be taken for motion and would never quite die out.
    """

    def __init__(self, name: str, settings: OdometrySettings, notes: Counter[str]) -> None:
        self._name = name
        self._settings = settings
        self._notes = notes
        self._begin()

    def _begin(self) -> None:
        self._matcher = make_matcher(self._settings)
        self._twist = STANDING
        self._moment = 0.0  # middle of the last sweep, seconds after its stamp
        self._stamp: int | None = None
        self._first: Sweep | None = None  # until the motion is known
        self._matched = False
        self._rejected = 0

    def add(self, sweep: Sweep) -> ChainLink:
        """Match the next scan to the last good one."""
        settings = self._settings
        if len(sweep) < settings.min_points:
            self._note('too few points to match')
            return ChainLink(self._at_stamp(sweep), usable=False)
        gap = None if self._stamp is None else (sweep.stamp - self._stamp) / NANOSECONDS
        if gap is not None and not 0.0 < gap <= settings.max_gap:
            self._note('gap too long to match')
            self._begin()
            gap = None
        if gap is None:
            return self._start(sweep)
        if gap > LONG:
            return self._match_over_gap(sweep, gap)
        if not self._matched:
            return self._first_match(sweep, gap)
        return self._next_match(sweep, gap)

    def _start(self, sweep: Sweep) -> ChainLink:
        """The scan to which the next one will be matched."""
        self._matcher.match(deskew(sweep, self._twist, sweep.middle), gtsam.Pose3())
        self._stamp, self._moment, self._first = sweep.stamp, sweep.middle, sweep
        return ChainLink(self._at_stamp(sweep))

    def _first_match(self, sweep: Sweep, gap: float) -> ChainLink:
        """Nobody knows the motion yet: deskewing and matching take turns until they agree."""
        first = self._first
        assert first is not None
        motion = self._accept(sweep, gap)
        for _ in range(RESTARTS if sweep.times is not None else 0):
            if motion is None:
                break
            before = motion
            self._matcher = make_matcher(self._settings)
            self._matcher.match(deskew(first, self._twist, first.middle), gtsam.Pose3())
            motion = self._accept(sweep, gap)
            if motion is not None and before.pose.equals(motion.pose, 0.005):
                break
        if motion is None:
            return self._reject(sweep)
        return self._continue(sweep, motion)

    def _next_match(self, sweep: Sweep, gap: float) -> ChainLink:
        motion = self._accept(sweep, gap)
        return self._reject(sweep) if motion is None else self._continue(sweep, motion)

    def _match_over_gap(self, sweep: Sweep, gap: float) -> ChainLink:
        """Link scans that are seconds apart where that is certain, else start anew."""
        moment = sweep.middle
        gap += moment - self._moment
        guess = self._twist.over(gap)
        match = self._matcher.match_over_gap(deskew(sweep, self._twist, moment), guess)
        motion = None if match is None else self._believe(match, gap, moment)
        if motion is None:
            self._note('no certain match over a gap')
            self._begin()
            return self._start(sweep)
        return self._continue(sweep, motion)

    def _accept(self, sweep: Sweep, gap: float) -> Motion | None:
        """Match a scan; None where the match is not to be believed, else the twist follows it."""
        moment = sweep.middle
        gap += moment - self._moment
        match = self._matcher.match(deskew(sweep, self._twist, moment), self._twist.over(gap))
        if match is None or match.overlap < self._settings.min_overlap:
            return None
        return self._believe(match, gap, moment)

    def _believe(self, match: Match, gap: float, moment: float) -> Motion | None:
        """The motion from stamp to stamp; None where no vehicle makes it."""
        tangent = gtsam.Pose3.Logmap(match.T_previous_current) / gap
        twist = Twist(linear=tangent[3:], angular=tangent[:3])
        surprise = float(np.linalg.norm(twist.linear - self._twist.linear)) * gap
        allowed = MAX_SURPRISE + 0.5 * BRAKING * max(gap - AT_ONCE, 0.0) ** 2
        if self._matched and surprise > allowed:
            return None
        before, self._twist = self._twist if self._matched else twist, twist
        start, end = before.over(self._moment), twist.over(-moment)
        return Motion(
            start.compose(match.T_previous_current).compose(end),
            None if match.covariance is None else carried(match.covariance, end.inverse()),
        )

    def _continue(self, sweep: Sweep, motion: Motion) -> ChainLink:
        previous, self._stamp, self._moment = self._stamp, sweep.stamp, sweep.middle
        self._matched, self._rejected, self._first = True, 0, None
        if motion.covariance is not None and weak_directions(motion.covariance):
            self._note(WEAK)
        return ChainLink(self._at_stamp(sweep), previous, motion.pose, covariance=motion.covariance)

    def _reject(self, sweep: Sweep) -> ChainLink:
        """Start anew at this scan, with the motion that was known before."""
        self._note('match rejected')
        twist, matched, rejected = self._twist, self._matched, self._rejected + 1
        self._begin()
        if rejected < MAX_REJECTED:
            self._twist, self._matched, self._rejected = twist, matched, rejected
        return self._start(sweep)

    def _at_stamp(self, sweep: Sweep) -> NDArray[np.float64]:
        return deskew(sweep, self._twist, 0.0)

    def _note(self, text: str) -> None:
        self._notes[f'{self._name}: {text}'] += 1
