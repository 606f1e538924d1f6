"""The chain of matched scans of one LiDAR: matching, deskewing, and what to do with bad matches."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import gtsam
import numpy as np

from incremental_mapper.config import OdometrySettings
from incremental_mapper.frontend.clouds import STANDING, BaseScan, Twist
from incremental_mapper.frontend.odometry import make_matcher
from incremental_mapper.measurements import LidarScan
from incremental_mapper.trajectory import NANOSECONDS

MAX_SURPRISE = 1.5
"""Metres between two scans that a match may differ from steady motion: no car brakes like that."""
MAX_REJECTED = 3
"""After so many bad matches in a row it is the scan they were held against that was bad."""
RESTARTS = 4
"""Rounds in which the first two scans and their motion are brought to agree."""

Placer = Callable[[LidarScan, Twist, bool], BaseScan]
"""Moves a raw scan into base_link, deskewed by a twist, at its stamp or at its sweep's middle."""


@dataclass(frozen=True, slots=True, eq=False)
class ChainLink:
    """A scan in base_link and its odometry.

    ``previous`` and ``T_previous_current`` are None without odometry. ``usable`` says that the
    next scan may be matched to this one.
    """

    base: BaseScan
    previous: int | None = None
    T_previous_current: gtsam.Pose3 | None = None
    usable: bool = True


class LidarChain:
    """Matches the scans of one LiDAR; remembers its last good scan and the motion then.

    Scans are matched at the middle of their sweeps. At the stamp, an error of the twist would
    shift the cloud; the shift would be taken for motion and would never quite die out.
    """

    def __init__(
        self, name: str, settings: OdometrySettings, place: Placer, notes: Counter[str]
    ) -> None:
        self._name = name
        self._settings = settings
        self._place = place
        self._notes = notes
        self._begin()

    def _begin(self) -> None:
        self._matcher = make_matcher(self._settings)
        self._twist = STANDING
        self._moment = 0.0  # middle of the last sweep, seconds after its stamp
        self._stamp: int | None = None
        self._first: LidarScan | None = None  # until the motion is known
        self._matched = False
        self._rejected = 0

    def add(self, scan: LidarScan) -> ChainLink:
        """Match the next scan to the last good one."""
        settings = self._settings
        base = self._place(scan, self._twist, False)
        if len(base.thinned) < settings.min_points:
            if len(base.points):
                self._note('too few points to match')
            return ChainLink(self._at_stamp(scan, base), usable=False)
        gap = None if self._stamp is None else (scan.stamp - self._stamp) / NANOSECONDS
        if gap is not None and not 0.0 < gap <= settings.max_gap:
            self._note('gap too long to match')
            self._begin()
            gap, base = None, self._place(scan, self._twist, False)
        if gap is None:
            self._matcher.match(base.points, gtsam.Pose3())
            self._stamp, self._moment, self._first = scan.stamp, base.moment, scan
            return ChainLink(self._at_stamp(scan, base))
        if not self._matched:
            return self._first_match(scan, base, gap)
        return self._next_match(scan, base, gap)

    def _first_match(self, scan: LidarScan, base: BaseScan, gap: float) -> ChainLink:
        """Nobody knows the motion yet: deskewing and matching take turns until they agree."""
        assert self._first is not None
        motion = self._accept(base, gap)
        rounds = RESTARTS if self._settings.deskew and scan.point_times is not None else 0
        for _ in range(rounds):
            if motion is None:
                break
            before = motion
            self._matcher = make_matcher(self._settings)
            self._matcher.match(self._place(self._first, self._twist, False).points, gtsam.Pose3())
            base = self._place(scan, self._twist, False)
            motion = self._accept(base, gap)
            if motion is not None and before.equals(motion, 0.005):
                break
        if motion is None:
            return self._reject(scan)
        return self._continue(scan, base, motion)

    def _next_match(self, scan: LidarScan, base: BaseScan, gap: float) -> ChainLink:
        motion = self._accept(base, gap)
        return self._reject(scan) if motion is None else self._continue(scan, base, motion)

    def _accept(self, base: BaseScan, gap: float) -> gtsam.Pose3 | None:
        """Match a scan; None where the match is not to be believed, else the twist follows it."""
        gap += base.moment - self._moment
        match = self._matcher.match(base.points, self._twist.over(gap))
        if match is None or match.overlap < self._settings.min_overlap:
            return None
        tangent = gtsam.Pose3.Logmap(match.T_previous_current) / gap
        twist = Twist(linear=tangent[3:], angular=tangent[:3])
        surprise = float(np.linalg.norm(twist.linear - self._twist.linear)) * gap
        if self._matched and surprise > MAX_SURPRISE:
            return None
        before, self._twist = self._twist if self._matched else twist, twist
        start, end = before.over(self._moment), twist.over(-base.moment)
        return start.compose(match.T_previous_current).compose(end)

    def _continue(self, scan: LidarScan, base: BaseScan, motion: gtsam.Pose3) -> ChainLink:
        previous, self._stamp, self._moment = self._stamp, scan.stamp, base.moment
        self._matched, self._rejected, self._first = True, 0, None
        return ChainLink(self._at_stamp(scan, base), previous, motion)

    def _reject(self, scan: LidarScan) -> ChainLink:
        """Start anew at this scan, with the motion that was known before."""
        self._note('match rejected')
        twist, matched, rejected = self._twist, self._matched, self._rejected + 1
        self._begin()
        if rejected < MAX_REJECTED:
            self._twist, self._matched, self._rejected = twist, matched, rejected
        base = self._place(scan, self._twist, False)
        self._matcher.match(base.points, gtsam.Pose3())
        self._stamp, self._moment, self._first = scan.stamp, base.moment, scan
        return ChainLink(self._at_stamp(scan, base))

    def _at_stamp(self, scan: LidarScan, base: BaseScan) -> BaseScan:
        """The scan as its stamp has it; without point times that is how it was matched."""
        return base if scan.point_times is None else self._place(scan, self._twist, True)

    def _note(self, text: str) -> None:
        self._notes[f'{self._name}: {text}'] += 1
