"""The evidence of a map for the rules that judge it: what was solved, and from what.

``judge_map`` looks at a whole map once. ``FitWatch`` looks at the newest stretch of a growing one
now and then, so that a user of the node need not wait for the end.
"""

import logging
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.bends import bend_findings
from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.checks.fixes import hardly_trusted
from incremental_mapper.checks.ground import GroundLook, ground_findings
from incremental_mapper.checks.lidar_ways import way_findings
from incremental_mapper.checks.motions import (
    Motions,
    Track,
    distance_findings,
    motion_findings,
)
from incremental_mapper.checks.outcome import Outcome
from incremental_mapper.checks.residuals import Residuals, fit_findings
from incremental_mapper.checks.speed import speed_findings
from incremental_mapper.config import Config, MatchNoise
from incremental_mapper.frontend.match_noise import WEAK, weak_directions
from incremental_mapper.graph.factors import Factor, FactorKind
from incremental_mapper.mapping.statistics import Totals
from incremental_mapper.mapping.stretches import stretches
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.selection.window_record import WindowRecord
from incremental_mapper.smoothing.graph_state import GraphState, PlacedFix, PlacedScan
from incremental_mapper.variables import pose_key

LOGGER = logging.getLogger('incremental_mapper')
PERIOD = 5 * NANOSECONDS
"""Between two looks at a growing map, in the time of its measurements."""
CLOUDS = 5
"""Clouds of each LiDAR in which the ground is looked for."""
NEWEST = 600
"""Matches of each LiDAR that a look at a growing map takes in: a minute at 10 Hz."""
THINNED = 3
"""Of so many matches, or IMU spans, one is judged: medians of 5 s have enough of them."""
GROUND_LOOKS = 2
"""Looks for the ground under a growing map; extrinsics do not change."""
ROTATION = {FactorKind.ODOMETRY: slice(0, 3), FactorKind.IMU: slice(0, 3)}
TRANSLATION = {
    FactorKind.ODOMETRY: slice(3, 6),
    FactorKind.IMU: slice(3, 6),
    FactorKind.GNSS: slice(0, 3),
}
"""Where rotation and translation stand in a residual."""


def judged(factors: Iterable[Factor]) -> list[Factor]:
    """The factors whose residuals are looked at: all fixes, and some of the matches and spans."""
    chosen: list[Factor] = []
    seen: Counter[tuple[FactorKind, str | None]] = Counter()
    for factor in factors:
        if factor.kind is FactorKind.GNSS:
            chosen.append(factor)
        elif factor.kind in TRANSLATION:
            seen[factor.kind, factor.sensor] += 1
            if seen[factor.kind, factor.sensor] % THINNED == 0:
                chosen.append(factor)
    return chosen


def residuals(factors: Iterable[Factor], values: gtsam.Values) -> list[Residuals]:
    """Residuals of odometry, fixes and IMU spans by kind and sensor.

    Args:
        factors: Of these kinds, in any order; ``judged`` chooses them.
        values: Values of all their variables.
    """
    groups: dict[tuple[FactorKind, str], list[tuple[int, float, float, float]]] = {}
    for factor in factors:
        kind = factor.kind
        measured: Any = factor.factor
        error = measured.unwhitenedError(values)
        groups.setdefault((kind, factor.sensor or ''), []).append(
            (
                factor.stamps[-1],
                _squared(factor, error, values) / len(error),
                float(np.linalg.norm(error[TRANSLATION[kind]])),
                float(np.linalg.norm(error[ROTATION[kind]])) if kind in ROTATION else 0.0,
            )
        )
    return [_group(kind, sensor, rows) for (kind, sensor), rows in groups.items()]


def _squared(factor: Factor, error: NDArray[np.float64], values: gtsam.Values) -> float:
    """Squared whitened residual, without the robust loss that fixes have."""
    if factor.kind is FactorKind.GNSS:
        covariance = np.array(factor.data['covariance'])
        return float(error @ np.linalg.solve(covariance, error))
    measured: Any = factor.factor
    whitened = measured.whitenedError(values)
    return float(whitened @ whitened)


def _group(
    kind: FactorKind, sensor: str, rows: Sequence[tuple[int, float, float, float]]
) -> Residuals:
    order = sorted(rows)
    stamps, squared, metres, radians = zip(*order, strict=True)
    return Residuals(
        kind=str(kind),
        sensor=sensor,
        stamps=np.array(stamps, dtype=np.int64),
        squared=np.array(squared),
        metres=np.array(metres),
        radians=np.array(radians),
    )


Match = tuple[int, int, NDArray[np.float64]]
"""Stamps of two scans (ns) and the translation (3,) between them in base_link, metres."""


def matches(factors: Iterable[Factor]) -> dict[str, list[Match]]:
    """The matches of each LiDAR, in the order of the factors.

    Those that the scans hold weakly are left out: where they say that the car went tells nothing of
    how the LiDARs stand on it.
    """
    found: dict[str, list[Match]] = {}
    for factor in factors:
        if factor.kind is FactorKind.ODOMETRY:
            measured: Any = factor.factor
            if weak_directions(measured.noiseModel().covariance()):
                continue
            start, end = factor.stamps
            moved = (start, end, measured.measured().translation())
            found.setdefault(factor.sensor or '', []).append(moved)
    return found


def motions(found: Mapping[str, Iterable[Match]]) -> list[Motions]:
    """The same as arrays, in time order."""
    made = []
    for sensor, items in sorted(found.items()):
        starts, ends, moves = zip(*sorted(items, key=lambda item: item[:2]), strict=True)
        made.append(
            Motions(
                sensor,
                np.array(starts, dtype=np.int64),
                np.array(ends, dtype=np.int64),
                np.array(moves),
            )
        )
    return made


def track(fixes: Sequence[PlacedFix]) -> Track:
    """The fixes of a map."""
    ordered = sorted(fixes, key=lambda fix: fix.stamp)
    return Track(
        np.array([fix.stamp for fix in ordered], dtype=np.int64),
        np.array([fix.enu for fix in ordered]).reshape(-1, 3),
        np.sqrt([fix.covariance[0, 0] for fix in ordered]),
    )


def ground_looks(scans: Sequence[PlacedScan], config: Config) -> list[GroundLook]:
    """Some clouds of each LiDAR, spread over a map."""
    by_sensor: dict[str, list[PlacedScan]] = {}
    for scan in scans:
        by_sensor.setdefault(scan.sensor, []).append(scan)
    looks = []
    for sensor, own in sorted(by_sensor.items()):
        places = np.unique(np.linspace(0, len(own) - 1, CLOUDS).astype(int))
        clouds = [own[place].points for place in places]
        looks.append(GroundLook(sensor, lidar_height(config, sensor), clouds))
    return looks


def lidar_height(config: Config, sensor: str) -> float:
    """Z of a LiDAR in base_link, metres."""
    lidar = config.lidars.get(sensor)
    return 0.0 if lidar is None else float(lidar.matrix()[2, 3])


def judge_map(state: GraphState, values: gtsam.Values, config: Config) -> list[Finding]:
    """Judge a whole map.

    Args:
        state: G(t).
        values: Its solution.
        config: All settings.

    Returns:
        What does not fit.
    """
    if not state.clusters:
        return []
    with undisturbed() as found:
        found += _judge(state, values, config)
    return found


def _judge(state: GraphState, values: gtsam.Values, config: Config) -> list[Finding]:
    factors = state.factors.unpacked()
    driven = motions(matches(factors))
    first = state.clusters[0].cluster.stamp
    fit = fit_findings(residuals(judged(factors), values), first)
    fit += _bends(factors, values, first, config)
    placed = sorted(state.clusters, key=lambda item: item.cluster.stamp)
    fixes = track(state.fixes)
    return [
        *speed_findings(
            np.array([item.cluster.stamp for item in placed], dtype=np.int64),
            np.array([values.atPose3(pose_key(item.id)).translation() for item in placed]),
        ),
        *distance_findings(driven, fixes),
        *_distrusted(state, values),
        *ground_findings(ground_looks(state.scans, config)),
        *causes(fit, _moving(driven, fixes)),
    ]


def _bends(
    factors: Iterable[Factor], values: gtsam.Values, first: int, config: Config
) -> list[Finding]:
    """Where the map does not follow matches that tell how certain they are."""
    if config.odometry.noise is MatchNoise.CONSTANT:
        return []
    return bend_findings(stretches(factors, values), first)


def _distrusted(state: GraphState, values: gtsam.Values) -> tuple[Finding, ...]:
    """Fixes that are in a map which is laid out by others, and have no weight in it."""
    if not state.georeferenced or not state.fixes:
        return ()
    every = state.factors.unpacked()
    factors = [every[fix.factor] for fix in state.fixes]
    measured: list[Any] = [factor.factor for factor in factors]
    return hardly_trusted(
        factors[-1].sensor or 'gnss',
        np.array([fix.covariance[0, 0] for fix in state.fixes]),
        np.array([factor.data['covariance'][0][0] for factor in factors]),
        np.array([np.hypot(*one.unwhitenedError(values)[:2]) for one in measured]),
        np.array([fix.stamp for fix in state.fixes], dtype=np.int64),
    )


def _moving(driven: Sequence[Motions], fixes: Track) -> list[Finding]:
    """What the motions of the LiDARs say; of those that drive apart, no more than that."""
    return motion_findings(driven) or way_findings(driven, fixes)


@contextmanager
def undisturbed() -> Iterator[list[Finding]]:
    """Findings of a block that may raise: a map is worth more than what is said of it."""
    try:
        yield []
    # Evidence is made of what strangers recorded, and the libraries raise what they like.
    except Exception:
        LOGGER.warning('a check of the map failed and is left out', exc_info=True)


def causes(fit: Sequence[Finding], moving: Sequence[Finding]) -> list[Finding]:
    """Leave out what only follows: LiDARs that drive apart fit neither each other nor the fixes.

    Args:
        fit: What does not fit the solved graph.
        moving: What the motions of the LiDARs say.
    """
    apart = any(
        item.rule == 'lidars_disagree' and item.severity is Severity.ERROR for item in moving
    )
    return [*(() if apart else fit), *moving]


def _newest() -> deque[Match]:
    return deque(maxlen=NEWEST)


def _few_clouds() -> deque[NDArray[np.float32]]:
    # A LiDAR that falls silent early never has enough of them; the others' must not pile up.
    return deque(maxlen=CLOUDS)


@dataclass(slots=True)
class FitWatch:
    """Judges the newest stretch of a growing map every ``PERIOD``, and counts what is in it."""

    config: Config
    _found: dict[tuple[str, str], Finding] = field(default_factory=dict)
    _next: int | None = None
    _matches: dict[str, deque[Match]] = field(default_factory=dict)
    _matched: int = 0
    _enough: int = 0
    _driven: list[Finding] = field(default_factory=list)
    _clouds: dict[str, deque[NDArray[np.float32]]] = field(default_factory=dict)
    _before: int = 0
    _looked: int = 0
    _looks: int = 0
    _factors: int = 0
    _scans: int = 0
    _scans_of: Counter[str] = field(default_factory=Counter)
    _matched_of: Counter[str] = field(default_factory=Counter)
    _farthest: float = 0.0

    @property
    def found(self) -> tuple[Finding, ...]:
        """What the looks so far have found, the newest of each rule and sensor."""
        return tuple(self._found.values())

    def window(self, state: GraphState) -> None:
        """Look at the map after a window, if it is time.

        Args:
            state: G(t), which is not empty.
        """
        stamp = state.frontier.newest_stamp
        if self._next is None:
            self._next = stamp + PERIOD
        if stamp < self._next:
            return
        self._next = stamp + PERIOD
        before, known = self._before, self._looked
        self._before, self._looked = known, len(state.factors)
        self._count(state)
        for sensor, made in matches(state.factors[known:]).items():
            self._matches.setdefault(sensor, _newest()).extend(made)
            self._matched += len(made)
        # Fixes of two periods, so that a receiver of 1 Hz has enough of them.
        older = (factor for factor in state.factors[before:known] if factor.kind is FactorKind.GNSS)
        recent = judged([*older, *state.factors[known:]])
        first = state.clusters[0].cluster.stamp
        with undisturbed() as found:
            fit = fit_findings(residuals(recent, _values(state, recent)), first)
            matched = [
                factor for factor in state.factors[before:] if factor.kind is FactorKind.ODOMETRY
            ]
            fit += _bends(matched, _values(state, matched), first, self.config)
            if self._matched >= self._enough:
                # Neither do these extrinsics change: twice the matches may say more.
                self._enough = self._matched + min(self._matched, NEWEST)
                self._driven = _moving(motions(self._matches), track(state.fixes))
            found += causes(fit, self._driven)
            found += self._ground(state)
        self._found.update({(finding.rule, finding.sensor): finding for finding in found})

    def outcome(
        self,
        state: GraphState,
        totals: Totals,
        notes: Mapping[str, int],
        records: Sequence[WindowRecord],
    ) -> Outcome:
        """Numbers of the map as it stands, for the rules on a whole map.

        Args:
            state: G(t).
            totals: Sums over the windows.
            notes: Counts of what was used but not in full.
            records: Inputs of failed windows.
        """
        self._count(state)
        reasons: dict[str, list[str]] = {}
        for text, count in notes.items():
            sensor, _, why = text.partition(': ')
            if why != WEAK:  # a match all the same
                reasons.setdefault(sensor, []).append(f'{count} {why}')
        return Outcome(
            clusters=len(state.clusters),
            bridges=totals.bridges,
            windows=totals.windows,
            failed=totals.failed_windows,
            carried=totals.carried_windows,
            scans=dict(self._scans_of),
            matched=dict(self._matched_of),
            reasons={sensor: ', '.join(lines) for sensor, lines in reasons.items()},
            fixes=len(state.fixes),
            georeferenced=state.georeferenced,
            farthest=self._farthest,
            records=tuple(record.name for record in records),
        )

    def _count(self, state: GraphState) -> None:
        """Count what is new in the map."""
        new = state.factors[self._factors :]
        self._matched_of.update(
            factor.sensor or '' for factor in new if factor.kind is FactorKind.ODOMETRY
        )
        self._scans_of.update(scan.sensor for scan in state.scans[self._scans :])
        self._factors, self._scans = len(state.factors), len(state.scans)
        newest = state.frontier.newest
        if newest is not None:
            start, end = state.pose(0).translation(), state.pose(newest).translation()
            self._farthest = max(self._farthest, float(np.linalg.norm(end - start)))

    def _ground(self, state: GraphState) -> list[Finding]:
        """Keep the newest cloud of each LiDAR; look at them once there are enough of all."""
        if self._looks >= GROUND_LOOKS:
            return []
        for sensor, scan in {scan.sensor: scan for scan, _ in state.recent}.items():
            self._clouds.setdefault(sensor, _few_clouds()).append(scan.points)
        if any(len(clouds) < CLOUDS for clouds in self._clouds.values()):
            return []
        looks = [
            GroundLook(sensor, lidar_height(self.config, sensor), list(clouds))
            for sensor, clouds in self._clouds.items()
        ]
        self._clouds = {}
        self._looks += 1
        return ground_findings(looks)


def _values(state: GraphState, factors: Iterable[Factor]) -> gtsam.Values:
    """Newest estimates of what some factors touch; the cost does not grow with the drive."""
    keys = {key for factor in factors for key in factor.keys}
    held = state.prior.values
    values = state.values.extract([key for key in keys if state.values.exists(key)])
    values.insert(held.extract([key for key in keys if held.exists(key)]))
    return values
