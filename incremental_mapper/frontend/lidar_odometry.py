"""LiDAR odometry: a LiDAR's thinned sweeps in, each with its motion since the one before out.

Each LiDAR has a chain of matched scans. The chain deskews and matches, and decides what to do
with bad matches; it knows nothing of other sensors.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.config import Config
from incremental_mapper.frontend.gap_matching import LONG
from incremental_mapper.frontend.imu_guide import ImuGuide, Momentum, squares
from incremental_mapper.frontend.imu_preintegration import ImuSeries
from incremental_mapper.frontend.inertial_motion import Strip
from incremental_mapper.frontend.match_noise import WEAK, carried, loosest_shift, weak_directions
from incremental_mapper.frontend.preprocessing import (
    STANDING,
    BodyMotion,
    Sweep,
    Twist,
    deskew,
)
from incremental_mapper.frontend.registration import Match, make_matcher
from incremental_mapper.measurements import NANOSECONDS

MAX_SURPRISE = 1.5
"""Metres between two scans that a match may differ from steady motion: no car brakes like that."""
BRAKING, AT_ONCE = 4.0, 0.3
"""m/s^2 by which a vehicle may change its speed beside, where scans are further apart than so many
seconds."""
SURE_SURPRISE, SURE_SPEED = 0.5, 2.0
"""Metres, and m/s between the scans, that a match may differ from what the IMU says."""
SURE_TURN, SURE_RATE = 0.1, 0.5
"""Radians, and rad/s between the scans, that its rotation may."""
BETTER = 0.05
"""Share of the points more that must find a partner by steady motion, where the IMU is doubted."""
ASTRAY = 2.0
"""m/s, beside braking and three deviations of both, by which the first two motions of a chain may
differ. The first began to match from standing still, however fast the car was, and where it ended
astray the second match ends sure and wrong between the two scans."""
APART, ANY_SPEED = 0.25, 5.0
"""Seconds between a chain's first two scans from which on their match may end anywhere, and m/s by
which it may be off then: cars of 5 m/s were found to stand, for 0.2 m of certain."""
MAX_REJECTED = 3
"""After so many bad matches in a row it is the scan they were held against that was bad."""
RESTARTS = 4
"""Rounds in which the first two scans and their motion are brought to agree."""


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
    """Motion from stamp to stamp that is believed, and its covariance, see ``PreparedScan``.

    ``around`` is how base_link moves around the scan. ``momenta`` are the IMU's at the middles of
    the two sweeps, None where it tells nothing.
    """

    pose: gtsam.Pose3
    covariance: NDArray[np.float64] | None
    around: BodyMotion
    momenta: tuple[Momentum, Momentum] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """What is expected of the motion to a scan, before it is matched.

    ``guess`` is T_previous_current between the middles of the two sweeps, ``around`` the motion
    around the scan. By the IMU ``inertial`` has the integrals of its samples, and its momentum at
    the middle of the sweep before; None where motion is steady.
    """

    guess: gtsam.Pose3
    around: BodyMotion
    inertial: tuple[Strip, Momentum] | None = None


class LidarChain:
    """Matches the scans of one LiDAR; remembers its last good scan and the motion then.

    Scans are matched at the middle of their sweeps. At the stamp, an error of the twist would
    shift the cloud; the shift would be taken for motion and would never quite die out.
    """

    def __init__(self, name: str, config: Config, notes: Counter[str]) -> None:
        self._name = name
        self._settings = config.odometry
        self._notes = notes
        self._guide = ImuGuide(config)
        self._begin()

    def _begin(self) -> None:
        self._matcher = make_matcher(self._settings)
        self._twist = STANDING
        self._spread = 0.0  # its deviation, m/s
        self._moment = 0.0  # middle of the last sweep, seconds after its stamp
        self._stamp: int | None = None
        self._first: Sweep | None = None  # until the motion is known
        self._matched = False
        self._proven = False  # by a second match
        self._rejected = 0
        self._momentum: Momentum | None = None  # at the middle of the last sweep
        self._to_middle: gtsam.Pose3 | None = None  # from the last stamp

    def take(self, imu: ImuSeries) -> None:
        """Take in the IMU's samples up to the end of the next scan."""
        if len(imu.stamps):
            newest = int(imu.stamps[-1]) if self._stamp is None else self._stamp
            self._guide.take(imu, newest - NANOSECONDS)

    def add(self, sweep: Sweep) -> ChainLink:
        """Match the next scan to the last good one."""
        settings = self._settings
        if len(sweep) < settings.min_points:
            self._note('too few points to match')
            return ChainLink(deskew(sweep, self._alone(sweep), 0.0), usable=False)
        gap = None if self._stamp is None else (sweep.stamp - self._stamp) / NANOSECONDS
        if gap is not None and not 0.0 < gap <= settings.max_gap:
            self._note('gap too long to match')
            self._begin()
            gap = None
        if gap is None:
            return self._start(sweep, self._alone(sweep))
        if gap > LONG:
            return self._match_over_gap(sweep, gap)
        if not self._matched:
            return self._first_match(sweep, gap)
        return self._next_match(sweep, gap)

    def _start(self, sweep: Sweep, around: BodyMotion) -> ChainLink:
        """The scan to which the next one will be matched."""
        self._matcher.match(deskew(sweep, around, sweep.middle), gtsam.Pose3())
        self._stamp, self._moment, self._first = sweep.stamp, sweep.middle, sweep
        self._to_middle = around.between(0.0, sweep.middle) if self._matched else None
        return ChainLink(deskew(sweep, around, 0.0))

    def _first_match(self, sweep: Sweep, gap: float) -> ChainLink:
        """Nobody knows the motion yet: deskewing and matching take turns until they agree."""
        first = self._first
        assert first is not None
        course = self._course(sweep, gap)
        motion = self._accept(sweep, gap, [course])
        for _ in range(RESTARTS if sweep.times is not None else 0):
            if motion is None:
                break
            before = motion
            around: BodyMotion = self._twist
            if motion.momenta is not None and course.inertial is not None:
                self._momentum = course.inertial[1].at_first(motion.momenta[0])
                around = self._alone(first)
            self._to_middle = around.between(0.0, first.middle)
            self._matcher = make_matcher(self._settings)
            self._matcher.match(deskew(first, around, first.middle), gtsam.Pose3())
            course = self._course(sweep, gap)
            motion = self._accept(sweep, gap, [course])
            if motion is not None and before.pose.equals(motion.pose, 0.005):
                break
        if motion is None:
            return self._reject(sweep, gap)
        if gap > APART and motion.covariance is not None:
            unsure = np.diag([0.0] * 3 + [(ANY_SPEED * gap) ** 2] * 3)
            motion = replace(motion, covariance=motion.covariance + unsure)
        return self._continue(sweep, motion)

    def _next_match(self, sweep: Sweep, gap: float) -> ChainLink:
        courses = [self._course(sweep, gap)]
        if courses[0].inertial is not None:
            courses.append(self._steady(gap + sweep.middle - self._moment))
        before, spread = self._twist, self._spread
        motion = self._accept(sweep, gap, courses)
        if motion is not None and not self._proven:
            changed = float(np.linalg.norm(self._twist.linear - before.linear))
            noise = float(np.hypot(spread, self._spread))
            if changed > ASTRAY + BRAKING * gap + 3.0 * noise:
                self._note('first motions disagree')
                self._begin()
                return self._start(sweep, self._alone(sweep))
            self._proven = True
        return self._reject(sweep, gap) if motion is None else self._continue(sweep, motion)

    def _match_over_gap(self, sweep: Sweep, gap: float) -> ChainLink:
        """Link scans that are seconds apart where that is certain, else start anew."""
        course = self._course(sweep, gap)
        moment = sweep.middle
        match = self._matcher.match_over_gap(deskew(sweep, course.around, moment), course.guess)
        passed = gap + moment - self._moment
        motion = None if match is None else self._believe(match, sweep, passed, course)
        if motion is None:
            self._note('no certain match over a gap')
            self._begin()
            return self._start(sweep, self._alone(sweep))
        return self._continue(sweep, motion)

    def _alone(self, sweep: Sweep) -> BodyMotion:
        """How base_link moves around a sweep, without a look at the one before."""
        strip = self._guide.strip(sweep) if self._guide.trusted else None
        if strip is None:
            return self._twist
        momentum = self._momentum
        if momentum is None or sweep is not self._first:
            momentum = self._guide.begin(strip, sweep.middle, self._known_twist)
        return strip.motion(sweep.middle, momentum.velocity, momentum.gravity)

    @property
    def _known_twist(self) -> Twist | None:
        return self._twist if self._matched else None

    def _steady(self, passed: float) -> Course:
        """Motion goes on as it was, for so many seconds."""
        return Course(self._twist.over(passed), self._twist)

    def _course(self, sweep: Sweep, gap: float) -> Course:
        """The motion to a scan by the IMU where it is to be believed, else steady."""
        before = self._moment - gap
        strip = self._guide.strip(sweep, before)
        if strip is None or not self._guide.trusted:
            return self._steady(sweep.middle - before)
        momentum = self._momentum
        if momentum is None:
            momentum = self._guide.begin(strip, before, self._known_twist)
        now = momentum.carried(strip.leap(before, sweep.middle))
        around = strip.motion(sweep.middle, now.velocity, now.gravity)
        return Course(around.between(before, sweep.middle), around, (strip, momentum))

    def _accept(self, sweep: Sweep, gap: float, courses: Sequence[Course]) -> Motion | None:
        """Match a scan; None where no match is to be believed, else the motion follows it."""
        passed = gap + sweep.middle - self._moment
        if len(courses) == 2 and not _near(courses[0].guess, courses[1].guess, passed):
            courses = self._by_the_scan(sweep, courses)
        overlap = 0.0
        for number, course in enumerate(courses):
            if number:
                if not self._matcher.undo():
                    break
                self._note('steady motion tried instead of the IMU')
            points = deskew(sweep, course.around, sweep.middle)
            match = self._matcher.match(points, course.guess)
            if match is None:
                return None
            if match.overlap >= max(self._settings.min_overlap, overlap):
                motion = self._believe(match, sweep, passed, course)
                if motion is not None:
                    return motion
            overlap = match.overlap + BETTER
        return None

    def _by_the_scan(self, sweep: Sweep, courses: Sequence[Course]) -> Sequence[Course]:
        """The IMU's course and steady motion, the one first that a scan speaks for.

        Where they are far apart one of them is wrong, and a match that begins there may end where
        it is wrong as well, but plausible by its own guess.
        """
        matches = []
        for course in courses:
            match = self._matcher.match(deskew(sweep, course.around, sweep.middle), course.guess)
            if match is None or not self._matcher.undo():
                return courses
            matches.append(match)
        by_imu, by_steady = matches
        more = by_steady.overlap - by_imu.overlap
        if _near(by_imu.T_previous_current, by_steady.T_previous_current, 0.0):
            # Both ended at one place, and the one that began nearer to it was right.
            off = [
                np.sqrt(squares(match.T_previous_current, course.guess))
                / [SURE_TURN, SURE_SURPRISE]
                for match, course in zip(matches, courses, strict=True)
            ]
            steadier = bool(off[1].max() < off[0].max())
        elif abs(more) >= BETTER:
            steadier = more > 0.0
        else:
            steadier = by_steady.misfit < by_imu.misfit
        return courses[::-1] if steadier else courses

    def _believe(self, match: Match, sweep: Sweep, passed: float, course: Course) -> Motion | None:
        """The motion from stamp to stamp; None where no vehicle makes it."""
        moment, found = sweep.middle, match.T_previous_current
        tangent = gtsam.Pose3.Logmap(found) / passed
        twist = Twist(linear=tangent[3:], angular=tangent[:3])
        believed = not self._matched or self._plausible(found, twist, passed, course)
        self._judge(sweep, passed, found, course)
        if not believed:
            return None
        around, momenta = self._learned(sweep, passed, match, twist, course)
        start = self._to_middle
        if start is None:
            start = twist.over(self._moment)
        self._twist = twist
        if match.covariance is not None:
            self._spread = float(np.sqrt(loosest_shift(match.covariance))) / passed
        end = around.between(moment, 0.0)
        return Motion(
            start.compose(found).compose(end),
            None if match.covariance is None else carried(match.covariance, end.inverse()),
            around,
            momenta,
        )

    def _plausible(self, found: gtsam.Pose3, twist: Twist, passed: float, course: Course) -> bool:
        """Whether a vehicle moves as a match says, by what was expected."""
        if course.inertial is None:
            surprise = float(np.linalg.norm(twist.linear - self._twist.linear)) * passed
            return surprise <= MAX_SURPRISE + 0.5 * BRAKING * max(passed - AT_ONCE, 0.0) ** 2
        return _near(course.guess, found, passed)

    def _judge(self, sweep: Sweep, passed: float, found: gtsam.Pose3, course: Course) -> None:
        """Hold what the IMU expects, believed or not, against a match."""
        if not self._matched:
            return
        expected = course.guess
        if course.inertial is None:
            before = sweep.middle - passed
            strip = self._guide.strip(sweep, before)
            if strip is None:
                return
            momentum = self._guide.begin(strip, before, self._twist)
            motion = strip.motion(before, momentum.velocity, momentum.gravity)
            expected = motion.between(before, sweep.middle)
        self._guide.judge(found, expected, self._twist.over(passed))

    def _learned(
        self, sweep: Sweep, passed: float, match: Match, twist: Twist, course: Course
    ) -> tuple[BodyMotion, tuple[Momentum, Momentum] | None]:
        """How base_link moves around a matched scan, and the momenta of the IMU."""
        if course.inertial is None:
            return twist, None
        strip, momentum = course.inertial
        leap = strip.leap(sweep.middle - passed, sweep.middle)
        found = match.T_previous_current
        momenta = self._guide.follow(momentum, leap, found, match.covariance)
        now = momenta[1]
        return strip.motion(sweep.middle, now.velocity, now.gravity), momenta

    def _continue(self, sweep: Sweep, motion: Motion) -> ChainLink:
        previous, self._stamp, self._moment = self._stamp, sweep.stamp, sweep.middle
        self._matched, self._rejected, self._first = True, 0, None
        self._momentum = None if motion.momenta is None else motion.momenta[1]
        self._to_middle = motion.around.between(0.0, sweep.middle)
        if motion.covariance is not None and weak_directions(motion.covariance):
            self._note(WEAK)
        points = deskew(sweep, motion.around, 0.0)
        return ChainLink(points, previous, motion.pose, covariance=motion.covariance)

    def _reject(self, sweep: Sweep, gap: float) -> ChainLink:
        """Start anew at this scan, with the motion that was known before."""
        self._note('match rejected')
        twist, matched, rejected = self._twist, self._matched, self._rejected + 1
        course, momentum = self._course(sweep, gap), None
        if course.inertial is not None:
            strip, before = course.inertial
            momentum = before.carried(strip.leap(self._moment - gap, sweep.middle))
        self._begin()
        if rejected < MAX_REJECTED:
            self._twist, self._matched, self._rejected = twist, matched, rejected
            self._proven = matched
            self._momentum = momentum
        return self._start(sweep, course.around)

    def _note(self, text: str) -> None:
        self._notes[f'{self._name}: {text}'] += 1


def _near(expected: gtsam.Pose3, found: gtsam.Pose3, passed: float) -> bool:
    """Whether a motion over some seconds may differ so much from what the IMU says."""
    turned, shifted = np.sqrt(squares(found, expected)).tolist()
    return bool(
        turned <= SURE_TURN + SURE_RATE * passed and shifted <= SURE_SURPRISE + SURE_SPEED * passed
    )
