"""Fixes that agree with each other: how a fix is held against odometry and the fixes before it.

Two fixes agree where both say about the same of the way between them as odometry does. Fixes that
agree make a track. A receiver that changes its datum, or that reflections mislead for a while,
makes a second one beside the first.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.frontend.gnss import Datum, align_track
from incremental_mapper.frontend.odometry_track import Place
from incremental_mapper.measurements import GnssFix

SLACK = 1.0
"""Metres by which two fixes may disagree with odometry in any case. A second apart, the two differ
by up to 0.65 m on KITTI 0013, 0.34 m on the simulated KAIST drives."""
NOISES = 5.0
"""Standard deviations of the two fixes by which they may disagree beside."""
DRIFT = 0.15
"""Metres more for every metre of way. Generalised ICP is 0.05 m off on KITTI and less on simulated
drives; vertically a hill of 15 % is no disagreement, since odometry begins level with the car."""
ACCELERATION = 4.0
"""m/s^2 that a car may brake or speed up where nothing was seen of its motion."""
TOP_SPEED = 60.0
"""m/s; nothing that carries a LiDAR drives faster."""
STEADY_SECONDS = 3.0
"""Seconds over which the motion of the fixes themselves may be followed."""
CLIMB_CHANGE = 1.0
"""m/s^2 by which the climb of a car changes; it crosses a kerb of 0.1 m in a tenth of a second."""
TURN = 0.15
"""Radians, and share of the way, by which two tracks differ where both are right."""
LOST = 0.3
"""Radians of turning that odometry has not seen, after which older members tell no yaw."""
MEMBERS = 20
"""Newest fixes of a track that tell its yaw."""
LEVELS = 4
"""Heights that a receiver may change between."""


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
    """A fix and where odometry puts it.

    Attributes:
        fix: The fix; an unknown altitude is that of the fix before.
        place: The antenna by odometry.
        sigma: Horizontal standard deviation, metres.
        sigma_up: Vertical one; NaN where the vertical is not known.
    """

    fix: GnssFix
    place: Place
    sigma: float
    sigma_up: float


@dataclass(frozen=True, slots=True, eq=False)
class Member:
    """A fix of a track: its position (3,) around the track's datum, at the track's first height."""

    enu: NDArray[np.float64]
    entry: Entry


@dataclass(slots=True)
class Level:
    """A height of the fixes above that of the track's first ones, metres, and how many have it."""

    offset: float
    count: int = 1


@dataclass(slots=True, eq=False)
class Track:
    """Fixes that agree with each other and with odometry.

    Attributes:
        datum: The first of them.
        min_distance: Metres after which the fixes tell the yaw.
        origin: Where the datum lies in the ENU frame of the graph (3,), metres; None where the
            fixes of this track are not in it.
        members: The newest ones.
        count: How many there are.
        stamps: Those of them that are in the graph, as long as they may have to leave it.
        levels: The heights that its fixes have had, the first one first.
        moved: Whether fixes and odometry have seen the car move.
        crept: Whether it went on from another track, step by step, until the two were apart.
    """

    datum: Datum
    min_distance: float
    origin: NDArray[np.float64] | None = None
    members: deque[Member] = field(default_factory=lambda: deque(maxlen=MEMBERS))
    count: int = 0
    stamps: list[int] = field(default_factory=list)
    levels: list[Level] = field(default_factory=lambda: [Level(0.0, 0)])
    moved: bool = False
    crept: bool = False

    def disagreement(self, entry: Entry, yaw: float | None) -> tuple[float, float]:
        """How far the way since the newest fix is off.

        Args:
            entry: The next fix.
            yaw: From odometry's frame to ENU, radians, None where it is not known.

        Returns:
            Horizontal metres, and how many of them may be.
        """
        newest = self.members[-1]
        apart, longer, allowed = self._apart(newest, entry, yaw)
        if longer <= 0.0:
            return apart, allowed
        # Scan matching may read hardly any motion; fixes that move steadily are right then.
        return min(apart, self._from_steady_motion(entry)), allowed

    def creeps(self, entry: Entry, yaw: float | None) -> bool:
        """Whether a fix that agrees with the newest one disagrees with older ones.

        Args:
            entry: The next fix.
            yaw: From odometry's frame to ENU, radians, None where it is not known.
        """
        older = self.members[0], self.members[len(self.members) // 2]
        for member in older:
            apart, _, allowed = self._apart(member, entry, yaw)
            if apart > allowed and _joined(member.entry.place, entry.place):
                return True
        return False

    def _apart(self, member: Member, entry: Entry, yaw: float | None) -> tuple[float, float, float]:
        """How far the way since a member is off, how much longer it is, and what may be."""
        by_fixes = (self.datum.enu(entry.fix) - member.enu)[:2]
        by_odometry = (entry.place.position - member.entry.place.position)[:2]
        allowed = _allowed(member.entry, entry, np.hypot(member.entry.sigma, entry.sigma))
        longer = float(np.hypot(*by_fixes) - np.hypot(*by_odometry))
        if yaw is None:
            return abs(longer), longer, allowed
        cosine, sine = np.cos(yaw), np.sin(yaw)
        turned = np.array([[cosine, -sine], [sine, cosine]]) @ by_odometry
        return float(np.hypot(*(by_fixes - turned))), longer, allowed

    def _from_steady_motion(self, entry: Entry) -> float:
        """Metres by which the way since the newest fix differs from that of a steady car."""
        if len(self.members) < 2:
            return np.inf
        older, newest = self.members[-2], self.members[-1]
        before = _seconds(older.entry, newest.entry)
        passed = _seconds(newest.entry, entry)
        if not (0.0 < before <= STEADY_SECONDS and 0.0 < passed <= STEADY_SECONDS):
            return np.inf
        velocity = (newest.enu - older.enu)[:2] / before
        if np.hypot(*velocity) > TOP_SPEED:
            return np.inf
        way = (self.datum.enu(entry.fix) - newest.enu)[:2]
        freedom = 0.5 * ACCELERATION * passed * (passed + before)
        return max(float(np.hypot(*(way - velocity * passed))) - freedom, 0.0)

    def height(self, entry: Entry) -> tuple[float, int | None]:
        """How far a fix is above where it should be, and which level that is, if it is a known one.

        Args:
            entry: A fix that agrees horizontally.

        Returns:
            Metres above the first level, and the place in ``levels``.
        """
        known = [member for member in self.members if not np.isnan(member.entry.sigma_up)]
        if not known or np.isnan(entry.sigma_up):
            return 0.0, 0
        newest = known[-1]
        by_odometry = entry.place.position[2] - newest.entry.place.position[2]
        above = float(self.datum.enu(entry.fix)[2] - newest.enu[2] - by_odometry)
        allowed = _allowed(newest.entry, entry, np.hypot(newest.entry.sigma_up, entry.sigma_up))
        for number, level in enumerate(self.levels):
            if abs(above - level.offset) <= allowed:
                return above, number
        # Odometry that has lost its level says that the car climbs; fixes go on as they did.
        return (0.0, 0) if self._climbs_on(known, entry) else (above, None)

    def _climbs_on(self, known: Sequence[Member], entry: Entry) -> bool:
        """Whether a fix is as high as a car is that climbs on as between the two before."""
        if len(known) < 2:
            return False
        older, newest = known[-2], known[-1]
        before, passed = _seconds(older.entry, newest.entry), _seconds(newest.entry, entry)
        if not (0.0 < before <= STEADY_SECONDS and 0.0 < passed <= STEADY_SECONDS):
            return False
        climb = float(newest.enu[2] - older.enu[2]) / before
        noise = np.hypot(older.entry.sigma_up, np.hypot(newest.entry.sigma_up, entry.sigma_up))
        freedom = 0.5 * CLIMB_CHANGE * passed * (passed + before) + NOISES * noise
        off = float(self.datum.enu(entry.fix)[2] - newest.enu[2]) - climb * passed
        return bool(abs(off) <= freedom)

    def add(self, entry: Entry, above: float, level: int | None) -> float | None:
        """Take a fix in.

        Args:
            entry: A fix that agrees horizontally.
            above: Metres above the first level.
            level: Which level that is, None for one of its own.

        Returns:
            Metres by which its height is to be lowered to that of the first level.
        """
        if level is None:
            if len(self.levels) == LEVELS:
                self.levels.remove(min(self.levels[1:], key=lambda one: one.count))
            self.levels.append(Level(above))
            level = len(self.levels) - 1
        else:
            known = self.levels[level]
            known.count += 1
            if level:
                known.offset += (above - known.offset) / known.count
        lowered = self.levels[level].offset
        enu = self.datum.enu(entry.fix) - np.array([0.0, 0.0, lowered])
        self.members.append(Member(enu, entry))
        self.count += 1
        self.moved = self.moved or self.yaw() is not None
        return lowered

    def yaw(self) -> float | None:
        """Yaw from odometry's frame to ENU, radians; None as long as the car has not moved."""
        if len(self.members) < 2:
            return None
        enu, local = self.positions()
        if len(enu) < 2:
            return None
        sigma = max(member.entry.sigma for member in self.members)
        far = max(self.min_distance, NOISES * np.sqrt(2.0) * sigma)
        if min(_extent(enu), _extent(local)) < far:
            return None
        return align_track(enu, local)[0]

    @property
    def weight(self) -> tuple[int, int]:
        """How many fixes it has, and the stamp of the newest one."""
        return self.count, self.members[-1].entry.fix.stamp

    def positions(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The newest fixes (K, 3) around the datum, and the same by odometry, metres.

        Those alone between which odometry was there and kept its heading.
        """
        newest = self.members[-1].entry.place
        known = [one for one in self.members if _joined(one.entry.place, newest)]
        enu = np.array([member.enu for member in known])
        local = np.array([member.entry.place.position for member in known])
        return enu, local


def alike(one: Track, other: Track) -> bool:
    """Whether odometry is turned and stretched alike in two tracks; not so while fixes converge."""
    yaws = one.yaw(), other.yaw()
    if yaws[0] is None or yaws[1] is None:
        return True
    turn = float(np.angle(np.exp(1j * (yaws[1] - yaws[0]))))
    stretches, noise = [], 0.0
    for track in (one, other):
        enu, local = track.positions()
        stretches.append(_extent(enu) / _extent(local))
        noise += NOISES * max(member.entry.sigma for member in track.members) / _extent(local)
    return abs(turn) <= TURN + noise and abs(stretches[1] - stretches[0]) <= TURN + noise


def _extent(positions: NDArray[np.float64]) -> float:
    """Largest horizontal distance from the first position, metres."""
    return float(np.hypot(*(positions - positions[0])[:, :2].T).max())


def _seconds(first: Entry, second: Entry) -> float:
    return (second.fix.stamp - first.fix.stamp) / 1e9


def unseen(first: Place, second: Place) -> float:
    """Metres that the car may have gone otherwise where no scan was matched."""
    unknown = max(second.unknown - first.unknown, 0.0)
    blind = second.blind - first.blind + first.ahead + second.ahead + unknown
    before = min(second.speed, TOP_SPEED) * unknown
    return min(before + 0.5 * ACCELERATION * blind**2, TOP_SPEED * blind)


def _joined(first: Place, second: Place) -> bool:
    """Whether odometry tells where the second place lies as seen from the first."""
    return first.unknown == second.unknown and second.lost - first.lost < LOST


def _allowed(first: Entry, second: Entry, noise: float) -> float:
    """Metres by which two fixes may disagree with odometry."""
    way = second.place.way - first.place.way
    by_chance = NOISES * np.sqrt(max(second.place.loose - first.place.loose, 0.0))
    # Weak matches may all lean to one side. LiDARs that saw 90 degrees of a bend made sound fixes
    # doubtful after 12 s: ATE 5.8 m, and 0.02 m with the fixes.
    loose = max(float(by_chance), second.place.looser - first.place.looser)
    return SLACK + NOISES * noise + DRIFT * way + loose + unseen(first.place, second.place)
