"""The gate for fixes: which of them are used, and around which datum.

A fix is used where it agrees with the fixes before it and with odometry. Fixes that agree with
each other, but not with those before, are no jump but a step: they are used too, moved back by the
step, and the datum is that of the larger part. At the start nobody knows which are right. Until
three fixes agree that saw the car move, all are used, but hardly trusted; those that turn out
wrong leave the graph.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding
from incremental_mapper.checks.fixes import (
    FEWEST,
    REFUSED,
    TOO_FAR,
    DatumStep,
    Suspicion,
    far_datum,
    fixes_elsewhere,
    judged_fixes,
    scatter,
    too_certain,
)
from incremental_mapper.config import GnssSettings, OdometryMethod
from incremental_mapper.errors import MeasurementError
from incremental_mapper.frontend.antenna_watch import AntennaWatch
from incremental_mapper.frontend.fix_shape_watch import ShapeWatch
from incremental_mapper.frontend.fix_tracks import MEMBERS, Entry, Track, alike, unseen
from incremental_mapper.frontend.gnss import Datum, align_track
from incremental_mapper.frontend.odometry_track import OdometryTrack, Place
from incremental_mapper.frontend.prepared_scan import PreparedScan
from incremental_mapper.measurements import NANOSECONDS, NO_VERTICAL_SIGMA, GnssFix

SETTLED = 3
"""So many fixes that agree and saw the car move tell the datum."""
STEP = 5
"""So many that agree with each other alone make a step; reflections seldom last that long."""
TRACKS = 4
"""Tracks that are followed at once."""
START = 50
"""Fixes of the start, among which a receiver may still converge: they are held against older ones
too, and what comes after them may prove them wrong. Later, odometry drifts as well."""
FROZEN_DISTANCE = 2.0
"""Metres that the car moves while a position repeats bit for bit, before it counts as frozen."""
FROZEN_CREEP = 0.05
"""Metres a second by which odometry may move while the car stands."""


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """A fix that is used: position (3,) and covariance (3, 3) in the frame of the gate, metres.

    ``doubtful`` ones may turn out wrong.
    """

    enu: NDArray[np.float64]
    covariance: NDArray[np.float64]
    doubtful: bool


class FixGate:
    """Takes fixes and scans in time order, and says which fixes are used."""

    def __init__(
        self,
        settings: GnssSettings,
        lever_arm: NDArray[np.float64],
        method: OdometryMethod,
        fixed: Datum | None = None,
        time_offset: float = 0.0,
        scales: Mapping[str, float] = {},
    ) -> None:
        """Begin without a fix.

        Args:
            settings: Those of the fixes.
            lever_arm: The antenna in base_link (3,), metres.
            method: How scans are matched.
            fixed: The datum where it is given; else the fixes tell it.
            time_offset: Seconds that are added to their stamps already.
            scales: What the points of each LiDAR are multiplied by already.
        """
        # Point-to-point matching reads 8 m of 14 m too little where a car speeds up.
        self._exact = method is OdometryMethod.GICP
        self._settings = settings
        self._odometry = OdometryTrack(lever_arm)
        self._tracks: list[Track] = []  # the first one is the one that is believed
        self._fixed = fixed
        self._farthest = (0.0, 0)  # metres from a fixed datum, and the first stamp that was too far
        self._frame: Datum | None = None
        self._altitude = math.nan  # of the newest fix that has one
        self._repeated: tuple[float, float, Place] | None = None
        self._asked = 0  # fixes that were left out when deviations were doubted last
        self._abandoned: set[int] = set()  # handed on, but their track is followed no more
        self.sensor = 'gnss'
        self.received = 0
        self.suspicions: dict[str, Suspicion] = {}
        self.steps: list[DatumStep] = []
        self._recent: deque[Entry] = deque(maxlen=MEMBERS)  # all but frozen ones
        self._shape = ShapeWatch(settings, time_offset, scales)
        self._antenna = AntennaWatch(lever_arm)

    # --- what it is asked

    @property
    def datum(self) -> Datum | None:
        """Origin of the frame as the larger part of the fixes has it, None before the first."""
        if self._frame is None or self._fixed is not None:
            return self._frame
        joined = [track for track in self._tracks if track.origin is not None]
        best = max(joined, key=lambda track: track.count, default=self._tracks[0])
        origin = np.zeros(3) if best.origin is None else best.origin
        level = max(best.levels, key=lambda one: one.count).offset
        if not origin.any() and level == 0.0:
            return best.datum
        return best.datum.geodetic(np.array([0.0, 0.0, level]) - origin)

    @property
    def refuted(self) -> frozenset[int]:
        """Stamps (ns) of fixes that were handed on and proved wrong since.

        Empty as long as nobody knows.
        """
        if not self._settled:
            return frozenset()
        others = (track.stamps for track in self._tracks[1:] if track.origin is None)
        return frozenset(self._abandoned.union(*others))

    @property
    def certain(self) -> bool:
        """Whether the fixes that are in the graph may tell where it lies on the earth."""
        main = self._tracks[0] if self._tracks else None
        return main is not None and main.origin is not None and (self._settled or self._single)

    def findings(self) -> tuple[Finding, ...]:
        """What was found wrong with the fixes so far."""
        found = judged_fixes(self.sensor, self.received, self.suspicions, self.steps)
        return (*found, *far_datum(self.sensor, *self._farthest), *self._elsewhere())

    def misshapen(self, last: bool = False) -> Finding | None:
        """Whether the track of the fixes is not odometry's in shape, size or time.

        Asked now and then.

        Args:
            last: Whether no more will come.
        """
        return self._shape.finding(self.sensor, last)

    def misplaced(self, last: bool = False) -> Finding | None:
        """Whether the antenna is elsewhere on the car; asked now and then, ``last`` as above."""
        return self._antenna.finding(self.sensor, last)

    def too_certain(self) -> Finding | None:
        """Whether the newest fixes scatter far more than they say; asked where some are left out.

        Costs next to nothing as long as all are used.
        """
        reasons = ('gnss_jump', 'datum_outlier')
        refused = sum(self.suspicions[one].count for one in reasons if one in self.suspicions)
        refused += len(self._abandoned)
        refused += sum(len(track.stamps) for track in self._tracks[1:] if track.origin is None)
        if refused < max(REFUSED, 2 * self._asked):
            return None
        if len(self._recent) < FEWEST:
            return None
        self._asked = refused
        datum = self._tracks[0].datum
        enu = np.array([datum.enu(entry.fix) for entry in self._recent])
        local = np.array([entry.place.position for entry in self._recent])
        reported = float(np.median([entry.sigma for entry in self._recent]))
        far = np.hypot(*(local - local[0])[:, :2].T).max()
        yaw = align_track(enu, local)[0] if far > self._settings.min_distance else None
        return too_certain(self.sensor, len(enu), reported, scatter(enu, local, yaw))

    # --- what it is told

    def refound(self) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
        """Make the datum of the fixes that agree the frame's; refuted ones are no more handed on.

        Returns:
            What moves a position (3,) from the frame so far to the new one, metres.
        """
        old, main = self._frame, self._tracks[0]
        assert old is not None
        for track in self._tracks[1:]:
            if track.origin is None:
                far = float(np.hypot(*main.datum.enu_of(track.datum)[:2]))
                for stamp in track.stamps:
                    self._suspect('datum_outlier', stamp, far)
                track.stamps.clear()
        for stamp in self._abandoned:
            self._suspect('datum_outlier', stamp, 0.0)
        self._abandoned.clear()
        if main.datum == old:
            return lambda enu: enu
        new = self._frame = main.datum
        main.origin = np.zeros(3)
        return lambda enu: new.enu_of(old.geodetic(enu))

    def scan(self, scan: PreparedScan) -> None:
        """Follow odometry."""
        self._odometry.add(scan)
        self._shape.pass_by(scan, self._odometry)

    def fix(self, fix: GnssFix, covariance: NDArray[np.float64]) -> Judged:
        """Judge the next fix.

        Args:
            fix: A usable fix.
            covariance: Its covariance (3, 3), east, north, up.

        Returns:
            The fix in the frame, with what is believed of it.

        Raises:
            MeasurementError: It is not to be believed.
        """
        self.sensor = fix.sensor
        self.received += 1
        fix = self._shape.corrected(fix)
        if self._fixed is not None:
            self._check_distance(fix, self._fixed)
        fix = self._with_altitude(fix)
        up = float(np.sqrt(covariance[2, 2]))
        entry = Entry(
            fix=fix,
            place=self._odometry.at(fix.stamp),
            sigma=float(np.sqrt(max(covariance[0, 0], covariance[1, 1]))),
            sigma_up=up if up < 0.5 * NO_VERTICAL_SIGMA else math.nan,
        )
        self._shape.take(entry)
        self._check_frozen(entry)
        self._recent.append(entry)
        if self._frame is None:
            self._frame = self._origin_at(fix)
        track, apart = self._track_of(entry)
        above, level = track.height(entry)
        lowered = track.add(entry, above, level)
        self._rank(track)
        if level != 0:
            self._suspect('altitude_jump', fix.stamp, abs(above))
            if level is None or track.levels[level].count < SETTLED:
                covariance = _without_vertical(covariance)
        if track.origin is not None:
            if track is self._tracks[0] and not (track.moved and track.count > STEP):
                track.stamps.append(fix.stamp)
            if self._exact and track is self._tracks[0]:
                self._antenna.take(entry)
            enu = track.datum.enu(fix) - np.array([0.0, 0.0, lowered])
            return Judged(enu + track.origin, covariance, doubtful=False)
        if self._settled and track is not self._tracks[0]:
            self._suspect('gnss_jump', fix.stamp, apart)
            raise MeasurementError(
                'gnss_jump',
                f'{fix.sensor} at {fix.stamp}: the fix is {apart:.1f} m from where odometry and '
                'the fixes before it say',
            )
        track.stamps.append(fix.stamp)
        return Judged(self._frame.enu(fix), covariance, doubtful=True)

    # --- inside

    @property
    def _settled(self) -> bool:
        """Whether it is known where the datum is."""
        main = self._tracks[0] if self._tracks else None
        return main is not None and main.moved and main.count >= SETTLED

    @property
    def _single(self) -> bool:
        """Whether all fixes agree so far."""
        return len(self._tracks) == 1 and not self._abandoned

    def _with_altitude(self, fix: GnssFix) -> GnssFix:
        """The fix with the newest known altitude, if its own is not; NaN before the first."""
        if math.isnan(fix.altitude):
            # The newest altitude is the best guess; its deviation says that it is no more.
            return replace(fix, altitude=self._altitude)
        if math.isnan(self._altitude) and self._frame is not None and self._fixed is None:
            # Fixes without altitude came before: they were at height 0, and so is this one.
            self._frame = replace(self._frame, altitude=fix.altitude)
            for track in self._tracks:
                track.datum = replace(track.datum, altitude=fix.altitude)
        self._altitude = fix.altitude
        return fix

    def _origin_at(self, fix: GnssFix) -> Datum:
        """The fixed datum, else that of a track which begins with a fix."""
        if self._fixed is not None:
            return self._fixed
        altitude = 0.0 if math.isnan(fix.altitude) else fix.altitude
        return Datum(fix.latitude, fix.longitude, altitude)

    def _check_distance(self, fix: GnssFix, datum: Datum) -> None:
        """Raise where a flat frame at a fixed datum does not reach as far as a fix."""
        east, north, _ = datum.enu(fix)
        far = float(np.hypot(east, north))
        most, first = self._farthest
        self._farthest = max(most, far), first
        if far > TOO_FAR:
            self._farthest = max(most, far), first or fix.stamp
            raise MeasurementError(
                'far_from_datum',
                f'{fix.sensor} at {fix.stamp}: the fix is {far / 1000.0:.0f} km from the datum of '
                'the settings',
            )

    def _check_frozen(self, entry: Entry) -> None:
        """Raise where the position repeats bit for bit although the car moves."""
        fix, place = entry.fix, entry.place
        same = self._repeated
        if same is None or (fix.latitude, fix.longitude) != same[:2]:
            self._repeated = fix.latitude, fix.longitude, place
            return
        seconds = (fix.stamp - same[2].stamp) / NANOSECONDS
        moved = float(np.hypot(*(place.position - same[2].position)[:2]))
        allowed = FROZEN_DISTANCE + FROZEN_CREEP * seconds + unseen(same[2], place)
        if moved > allowed:
            self._suspect('frozen_fix', fix.stamp, moved)
            raise MeasurementError(
                'frozen_fix',
                f'{fix.sensor} at {fix.stamp}: the position repeats bit for bit for '
                f'{seconds:.1f} s, in which the car moved {moved:.1f} m',
            )

    def _track_of(self, entry: Entry) -> tuple[Track, float]:
        """The track that a fix belongs to, maybe a new one, and how far it is off the main one."""
        starting = not self._tracks or self._tracks[0].count <= START
        main_yaw = None if starting else self._tracks[0].yaw()
        apart, crept = 0.0, False
        for number, track in enumerate(self._tracks):
            own = track.yaw()
            yaw = main_yaw if own is None else own
            off, allowed = track.disagreement(entry, yaw)
            apart = apart if number else off
            if off > allowed:
                continue
            if not starting or not self._exact or not track.creeps(entry, yaw):
                return track, apart
            crept = True
        fix = entry.fix
        if len(self._tracks) == TRACKS:
            weakest = min(self._tracks[1:], key=lambda one: (one.origin is not None, one.weight))
            self._abandoned.update(weakest.stamps)
            self._tracks.remove(weakest)
        datum = self._origin_at(fix)
        origin = None if self._tracks else np.zeros(3)
        made = Track(datum, self._settings.min_distance, origin, crept=crept)
        self._tracks.append(made)
        return made, apart

    def _rank(self, track: Track) -> None:
        """Believe a track in place of the main one, or beside it, where it has earned that."""
        main = self._tracks[0]
        if track is main or track.origin is not None:
            return
        start = main.count <= START and (track.crept or (self._exact and not alike(main, track)))
        weak = main.count < STEP or not main.moved or start
        more = track.count > main.count and track.moved >= main.moved
        if weak and (more or (track.moved and not main.moved and track.count >= SETTLED)):
            self._tracks.remove(track)
            self._tracks.insert(0, track)
            main.origin = None
            if track.datum == self._frame:
                track.origin = np.zeros(3)
        elif not start and track.count >= STEP and track.moved and main.moved:
            track.origin = self._origin(track)
            self._abandoned.update(track.stamps)
            track.stamps.clear()
            first = track.members[0].entry.fix.stamp
            shift = main.datum.enu_of(track.datum) - track.origin
            east, north, up = (float(value) for value in shift)
            before, after = main.members[-1].entry, track.members[0].entry
            broken = after.place.blind > before.place.blind or not alike(main, track)
            self.steps.append(DatumStep(first, (east, north, up), broken))

    def _origin(self, track: Track) -> NDArray[np.float64]:
        """Where the datum of a track lies in the frame (3,), by odometry from the main one."""
        main = self._tracks[0]
        assert main.origin is not None
        (before, local_before), (after, local_after) = main.positions(), track.positions()
        # Each set around its own middle: what is between them is what is asked for.
        enu = np.vstack([before - before.mean(axis=0), after - after.mean(axis=0)])
        local = np.vstack(
            [local_before - local_before.mean(axis=0), local_after - local_after.mean(axis=0)]
        )
        yaw, _ = align_track(enu, local)
        cosine, sine = np.cos(yaw), np.sin(yaw)
        turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        near = slice(-SETTLED, None)
        way = turn @ (local_after.mean(axis=0) - local_before[near].mean(axis=0))
        origin: NDArray[np.float64] = (
            main.origin + before[near].mean(axis=0) + way - after.mean(axis=0)
        )
        return origin

    def _elsewhere(self) -> tuple[Finding, ...]:
        """Whether the newest fixes agree with each other, and nobody follows them."""
        if not self._settled:
            return ()
        main = self._tracks[0]
        for track in self._tracks[1:]:
            newest = track.members[-1].entry
            later = newest.fix.stamp > main.members[-1].entry.fix.stamp
            if later and track.origin is None and track.moved and track.count >= STEP:
                apart, _ = main.disagreement(newest, main.yaw())
                first = track.members[0].entry.fix.stamp
                return (fixes_elsewhere(self.sensor, track.count, first, apart),)
        return ()

    def _suspect(self, reason: str, stamp: int, metres: float) -> None:
        known = self.suspicions.setdefault(reason, Suspicion(0, stamp, 0.0))
        known.count += 1
        known.most = max(known.most, metres)


def _without_vertical(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """The covariance (3, 3) of a fix whose height is not to be believed, m^2."""
    flat = np.zeros((3, 3))
    flat[:2, :2] = covariance[:2, :2]
    flat[2, 2] = NO_VERTICAL_SIGMA**2
    return flat
