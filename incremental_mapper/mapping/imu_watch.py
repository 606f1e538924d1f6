"""Evidence on the IMU: its samples as they came, and the matches of scans beside them."""

import sys
from collections.abc import Sequence

import gtsam
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding
from incremental_mapper.checks.imu_beside_lidar import check_motion
from incremental_mapper.checks.imu_gravity import (
    FIRST,
    LATE,
    SOON,
    check_gravity,
    measure_gravity,
)
from incremental_mapper.checks.imu_holes import check_holes
from incremental_mapper.checks.imu_motion import FEWEST, MotionEvidence
from incremental_mapper.checks.imu_noise import check_noise
from incremental_mapper.checks.imu_range import check_range
from incremental_mapper.checks.lidar_clock import lidar_clock_findings
from incremental_mapper.checks.slow_imu import check_slow
from incremental_mapper.config import Config, Tree
from incremental_mapper.frontend.front_end import Prepared
from incremental_mapper.frontend.prepared_scan import PreparedScan
from incremental_mapper.measurements import NANOSECONDS, ImuSample, Vector

MOST_SAMPLES = 20_000
"""Samples that are kept: 50 s at 400 Hz."""
MOST_MATCHES = 500
"""Matches of each LiDAR that are kept: 50 s."""
WAITING = 256
"""Samples, or matches, that are put beside the others in one go."""
EACH = 150
"""Matches after which each LiDAR's clock is looked at by itself, once beside at the end."""
GROWTH = 2.5
"""The rules are asked again when there is so many times the evidence."""
MARGIN = 0.05
"""Seconds beyond a decision's time, for samples that are not quite regular."""
AT_ONCE = ('imu_in_deg', 'imu_rate_unit', 'imu_gyro_frozen')
"""Rules on the motion whose word counts at once. The others are asked twice: a lag or the axes that
few turns have in common with others may be chance."""
ALIKE = 0.03
"""Seconds, or parts of a quaternion, by which the two answers may differ."""
SENSIBLE = 1e7
"""Numbers beyond it, of any unit, are no evidence."""
FASTEST = 400.0
"""Nor are rates beyond it, be they in rad/s or in deg/s: no vehicle turns once in a second."""
SPIKE = 20.0
"""Nor are samples that are so many times further off those around them than 99 of 100 are off the
middle of all: one of them would outweigh all turns of a drive."""
STRONGEST = 40.0
"""Nor are samples that are further off those around them than ``imu.max_rate`` or
``imu.max_acceleration`` (or so many times the usual acceleration, where the unit is another),
however many of them there are: where each tenth sample is absurd, 99 of 100 are far off."""
AROUND = 5
"""Samples of which the median says what is usual around the middle one."""
OFF: Tree = {'imu': {'enabled': False}}
"""What a finding sets that takes the whole IMU for wrong."""
MOST_KNOCKED = 0.5
"""Share of the matches beside which samples may be wrong before the IMU is."""
NEAR = 300 * NANOSECONDS
"""Nor are stamps that are so far from most."""
_LIMITS = np.array([FASTEST] * 3 + [SENSIBLE] * 3)


class ImuWatch:
    """Keeps some of the IMU's samples and of the matches, and asks the rules now and then."""

    def __init__(self, config: Config) -> None:
        self._settings = config.imu
        self._noise = config.preintegration
        self._gravity = config.preintegration.gravity
        self._samples = _Newest(MOST_SAMPLES)  # rates and accelerations
        self._matches: dict[str, _Newest] = {}  # rotation vectors and translations, by LiDAR
        self._offsets = {name: lidar.time_offset for name, lidar in config.lidars.items()}
        self._each = EACH  # matches at which the LiDARs' clocks are looked at
        self._enabled = config.imu.enabled
        self._due: int | None = None  # stamp at which gravity is looked at
        self._span = FIRST + MARGIN  # seconds of samples then
        self._enough = 2 * FEWEST  # matches at which the motion is looked at
        self._count = 0
        self._before: Sequence[Finding] = ()  # of the last look at the motion
        self._max_gap = round(config.preintegration.max_gap * NANOSECONDS)
        self._holes = _Holes(self._max_gap)
        self._contradicted: NDArray[np.int64] = np.zeros(0, dtype=np.int64)  # stamps

    def sample(self, sample: ImuSample) -> Sequence[Finding]:
        """Keep a sample, as the message has it; now and then look at gravity."""
        if not self._enabled:
            return ()
        stamp = sample.stamp
        self._samples.append(stamp, stamp, sample.gyro, sample.acceleration)
        if self._due is None:
            self._due = stamp + round(self._span * NANOSECONDS)
        if stamp < self._due:
            return ()
        start = self._due - round(self._span * NANOSECONDS)
        later = [at + MARGIN for at in (SOON, LATE) if at > self._span]
        self._span = later[0] if later else 3.0 * self._span
        self._due = start + round(self._span * NANOSECONDS)
        return self._look_at_gravity()

    def used(self, samples: Sequence[ImuSample]) -> None:
        """Look for holes in the samples of a window: those that were not left out."""
        self._holes.pass_by([sample.stamp for sample in samples])

    def contradicted(self, stamps: NDArray[np.int64]) -> None:
        """Keep the stamps (ns) of samples that are left out for the matches beside them."""
        self._contradicted = np.concatenate([self._contradicted, stamps])[-MOST_SAMPLES:]

    def matches(self, prepared: Sequence[Prepared]) -> Sequence[Finding]:
        """Keep the matches of a window; now and then hold the IMU against them."""
        if not self._enabled:
            return ()
        for item in prepared:
            if isinstance(item, PreparedScan) and item.previous and item.T_previous_current:
                moved = item.T_previous_current
                turned = gtsam.Rot3.Logmap(moved.rotation())
                own = self._matches.setdefault(item.core.sensor, _Newest(MOST_MATCHES))
                own.append(item.previous, item.core.stamp, turned, moved.translation())
                self._count += 1
        if self._count < self._enough:
            return ()
        self._enough = round(GROWTH * self._count)
        return self._look_at_motion(last=False)

    def end(self) -> Sequence[Finding]:
        """Look once more: nothing more will come."""
        if not self._enabled:
            return ()
        return [
            *self._look_at_gravity(),
            *self._look_at_motion(last=True),
            *self._look_at_holes(),
        ]

    def _look_at_gravity(self) -> Sequence[Finding]:
        if len(self._samples) == 0:
            return ()
        stamps, gyro, force = self._arrays()
        found = measure_gravity(stamps, force, gyro)
        finding = None if found is None else check_gravity(found, self._settings, self._gravity)
        # In another unit, or the other way up, even the end of the range would be told wrongly.
        if finding is None:
            finding = check_range(stamps, gyro, force, self._settings, self._gravity)
        if finding is None:
            finding = check_noise(stamps, gyro, force, self._noise)
        if finding is None:
            finding = check_slow(stamps, gyro, force, self._noise)
        return () if finding is None else (finding,)

    def _look_at_motion(self, last: bool) -> Sequence[Finding]:
        if self._count < FEWEST or len(self._samples) < 2 * FEWEST:
            return ()
        stamps, gyro, force = self._arrays()
        if len(stamps) < 2 * FEWEST:
            return ()
        turn = self._settings.matrix()[:3, :3].T
        gyro, force = gyro @ turn, force @ turn

        def beside(spans: NDArray[np.int64], moved: NDArray[np.float64]) -> MotionEvidence:
            turns, shifts = moved[:, :3], moved[:, 3:]
            return MotionEvidence(spans, turns, shifts, stamps, gyro, force, self._gravity)

        if len(self._matches) > 1 and (last or self._count >= self._each):
            self._each = sys.maxsize
            each = {name: beside(own.stamps(), own.rows()) for name, own in self._matches.items()}
            late = lidar_clock_findings(each, self._offsets)
            if late:
                return late
        kept = self._matches.values()
        evidence = beside(
            np.vstack([own.stamps() for own in kept]), np.vstack([own.rows() for own in kept])
        )
        found = check_motion(evidence, self._settings, last)
        calm = _without(evidence, self._contradicted)
        if any(one.settings == OFF for one in found) and calm is not None:
            # A knock costs its own span, and not the IMU: it must be wrong beside it, too.
            found = check_motion(calm, self._settings, last)
        before, self._before = self._before, found
        return [one for one in found if last or one.rule in AT_ONCE or _repeated(one, before)]

    def _look_at_holes(self) -> Sequence[Finding]:
        if self._holes.last == 0 or len(self._samples) < 2:
            return ()
        holes = self._holes
        last = max((int(own.stamps()[-1, 1]) for own in self._matches.values()), default=0)
        behind = max(last - holes.last, 0)
        silent = behind if behind > self._max_gap else 0
        gaps = np.diff(self._samples.stamps()[:, 0]) / NANOSECONDS
        finding = check_holes(
            (holes.total + silent) / NANOSECONDS,
            (max(last, holes.last) - holes.first) / NANOSECONDS,
            max(holes.longest, silent) / NANOSECONDS,
            float(np.percentile(gaps, 90.0)),
            self._max_gap / NANOSECONDS,
        )
        return () if finding is None else (finding,)

    def _arrays(self) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
        """Stamps, rates and accelerations in time order, scaled, without absurd and frozen ones."""
        stamps, rows = self._samples.stamps()[:, 0], self._samples.rows()
        order = np.argsort(stamps, kind='stable')
        sensible = np.all(np.abs(rows) < _LIMITS, axis=1)
        sensible[1:] &= (rows[1:] != rows[:-1]).any(axis=1)  # what is frozen says nothing
        # The median: the one that came in the middle may be a stray itself.
        sensible &= np.abs(stamps - stamps[order[len(order) // 2]]) < NEAR
        keep = order[sensible[order]]
        keep = keep[~_spikes(rows[keep], self._most(rows[keep, 3:]))]
        settings = self._settings
        return (
            stamps[keep],
            settings.rate_scale * rows[keep, :3],
            settings.acceleration_scale * rows[keep, 3:],
        )

    def _most(self, force: NDArray[np.float64]) -> NDArray[np.float64]:
        """How far (6,) a sample may be off those around it, in the unit of the messages."""
        settings = self._settings
        usual = float(np.median(np.linalg.norm(force, axis=1))) if len(force) else 0.0
        strong = max(
            settings.max_acceleration / abs(settings.acceleration_scale), STRONGEST * usual
        )
        return np.array([settings.max_rate / abs(settings.rate_scale)] * 3 + [strong] * 3)


def _without(evidence: MotionEvidence, contradicted: NDArray[np.int64]) -> MotionEvidence | None:
    """The evidence without some samples (stamps, ns) and the matches beside them.

    Returns:
        None where that is all of it, or too little is left.
    """
    spans, wrong = evidence.spans, np.sort(contradicted)
    beside = np.diff(np.searchsorted(wrong, spans), axis=1)[:, 0] > 0
    if not beside.any() or len(spans) - beside.sum() < max(FEWEST, MOST_KNOCKED * len(spans)):
        return None
    keep = ~np.isin(evidence.stamps, wrong)
    return MotionEvidence(
        spans=spans[~beside],
        turns=evidence.turns[~beside],
        shifts=evidence.shifts[~beside],
        stamps=evidence.stamps[keep],
        gyro=evidence.gyro[keep],
        force=evidence.force[keep],
        gravity=evidence.gravity,
    )


def _spikes(rows: NDArray[np.float64], most: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which rows (K, C) are far off those around them, by their own measure or by ``most`` (C,)."""
    if len(rows) < AROUND:
        return np.zeros(len(rows), dtype=bool)
    with np.errstate(over='ignore', invalid='ignore'):
        usual = np.quantile(np.abs(rows - np.median(rows, axis=0)), 0.99, axis=0)
        far = np.minimum(SPIKE * usual, most)
        # Who is so far off the median of five is as far off one of the two beside it; mostly none
        # is, and the filter takes ten times as long as all else here.
        if not (np.abs(np.diff(rows, axis=0)) > far).any():
            return np.zeros(len(rows), dtype=bool)
        beyond = np.pad(rows, ((AROUND // 2, AROUND // 2), (0, 0)), mode='edge')
        usual_there = np.median(sliding_window_view(beyond, AROUND, axis=0), axis=-1)
        spikes: NDArray[np.bool_] = np.any(np.abs(rows - usual_there) > far, axis=1)
    return spikes


def _repeated(finding: Finding, before: Sequence[Finding]) -> bool:
    """Whether the last look said the same."""
    values = finding.settings['imu']
    for other in before:
        others = other.settings['imu']
        if other.rule == finding.rule and others.keys() == values.keys():
            return all(np.allclose(others[key], values[key], atol=ALIKE) for key in values)
    return False


class _Newest:
    """The newest of a stream: two stamps (ns) and two vectors (3,) each.

    Kept as arrays, since the rules ask for all of them again and again, and a sample as Python has
    it takes six times the memory; the newest wait in a list, since each sample of an IMU comes by
    here.
    """

    def __init__(self, most: int) -> None:
        self._stamps = np.zeros((0, 2), dtype=np.int64)
        self._rows = np.zeros((0, 6))
        self._most = most
        self._waiting: list[tuple[int, int, Vector, Vector]] = []

    def __len__(self) -> int:
        return len(self._stamps) + len(self._waiting)

    def append(self, first: int, last: int, one: Vector, other: Vector) -> None:
        """Keep one more; ``most`` are kept, and those that wait."""
        self._waiting.append((first, last, one, other))
        if len(self._waiting) == WAITING:
            self._join()

    def stamps(self) -> NDArray[np.int64]:
        """Both stamps of each (N, 2)."""
        self._join()
        return self._stamps

    def rows(self) -> NDArray[np.float64]:
        """Both vectors of each (N, 6)."""
        self._join()
        return self._rows

    def _join(self) -> None:
        if not self._waiting:
            return
        firsts, lasts, ones, others = zip(*self._waiting, strict=True)
        self._waiting.clear()
        stamps = np.column_stack([firsts, lasts])
        rows = np.hstack([np.array(ones), np.array(others)])
        self._stamps = np.vstack([self._stamps, stamps])[-self._most :]
        self._rows = np.vstack([self._rows, rows])[-self._most :]


class _Holes:
    """Sums of the holes between samples, ns; ``first`` and ``last`` are stamps."""

    def __init__(self, max_gap: int) -> None:
        self.total = self.longest = self.first = self.last = 0
        self._max_gap = max_gap

    def pass_by(self, stamps: Sequence[int]) -> None:
        """The next samples."""
        if self.last == 0 and stamps:
            self.first = self.last = stamps[0]
        last = self.last
        for stamp in stamps:
            gap = stamp - last
            if 0 < gap < NEAR:  # neither out of order nor a leap
                last = stamp
                if gap > self._max_gap:
                    self.total += gap
                    self.longest = max(self.longest, gap)
        self.last = last
