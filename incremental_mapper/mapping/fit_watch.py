"""Judges the newest stretch of a growing map now and then, and counts what is in it.

A user of the node need not wait for the end.
"""

from collections import Counter, deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding
from incremental_mapper.checks.ground import GroundLook, ground_findings
from incremental_mapper.checks.outcome import Outcome
from incremental_mapper.checks.planar_scanner import planar_findings
from incremental_mapper.checks.residuals import fit_findings
from incremental_mapper.config import Config
from incremental_mapper.frontend.match_noise import WEAK
from incremental_mapper.graph.factors import Factor, FactorKind
from incremental_mapper.mapping.judgement import (
    CLOUDS,
    Match,
    bends,
    causes,
    judged,
    lidar_place,
    matches,
    motions,
    moving,
    residuals,
    track,
    undisturbed,
)
from incremental_mapper.mapping.statistics import Totals
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.selection.window_record import WindowRecord
from incremental_mapper.smoothing.graph_state import GraphState

PERIOD = 5 * NANOSECONDS
"""Between two looks at a growing map, in the time of its measurements."""
NEWEST = 600
"""Matches of each LiDAR that a look at a growing map takes in: a minute at 10 Hz."""
GROUND_LOOKS = 2
"""Looks for the ground under a growing map; extrinsics do not change."""


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
            fit += bends(matched, _values(state, matched), first, self.config)
            if self._matched >= self._enough:
                # Neither do these extrinsics change: twice the matches may say more.
                self._enough = self._matched + min(self._matched, NEWEST)
                self._driven = moving(motions(self._matches), track(state.fixes))
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
            GroundLook(sensor, lidar_place(self.config, sensor), list(clouds))
            for sensor, clouds in self._clouds.items()
        ]
        self._clouds = {}
        self._looks += 1
        return ground_findings(looks) + planar_findings(looks)


def _values(state: GraphState, factors: Iterable[Factor]) -> gtsam.Values:
    """Newest estimates of what some factors touch; the cost does not grow with the drive."""
    keys = {key for factor in factors for key in factor.keys}
    held = state.prior.values
    values = state.values.extract([key for key in keys if state.values.exists(key)])
    values.insert(held.extract([key for key in keys if held.exists(key)]))
    return values
