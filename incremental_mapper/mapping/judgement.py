"""The evidence of a map for the rules that judge it: what was solved, and from what."""

import logging
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
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
from incremental_mapper.checks.planar_scanner import planar_findings
from incremental_mapper.checks.residuals import Residuals, fit_findings
from incremental_mapper.checks.speed import speed_findings
from incremental_mapper.config import Config, MatchNoise
from incremental_mapper.frontend.match_noise import weak_directions
from incremental_mapper.graph.factors import Factor, FactorKind
from incremental_mapper.mapping.stretches import stretches
from incremental_mapper.smoothing.graph_state import GraphState, PlacedFix, PlacedScan
from incremental_mapper.variables import pose_key

LOGGER = logging.getLogger('incremental_mapper')
CLOUDS = 5
"""Clouds of each LiDAR in which the ground is looked for."""
THINNED = 3
"""Of so many matches, or IMU spans, one is judged: medians of 5 s have enough of them."""
ROTATION = {FactorKind.ODOMETRY: slice(0, 3), FactorKind.IMU: slice(0, 3)}
TRANSLATION = {
    FactorKind.ODOMETRY: slice(3, 6),
    FactorKind.IMU: slice(3, 6),
    FactorKind.GNSS: slice(0, 3),
}
"""Where rotation and translation stand in a residual."""
UNSETTLED = 0.005
"""Metres, deviation of the way between two poses of a map that grows: each keeps the estimate with
which it left the smoother's lag, and the next one has left it with another. The spans of an IMU
claim to know that way to 0.06 mm. Up to 7 mm in a sound drive one of whose LiDARs was silent."""


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
    if factor.kind is FactorKind.IMU:
        covariance = measured.noiseModel().covariance()
        way = TRANSLATION[factor.kind]
        covariance[way, way] += UNSETTLED**2 * np.eye(3)
        return float(error @ np.linalg.solve(covariance, error))
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
        looks.append(GroundLook(sensor, lidar_place(config, sensor), clouds))
    return looks


def lidar_place(config: Config, sensor: str) -> NDArray[np.float64]:
    """Position of a LiDAR in base_link (3,), metres."""
    lidar = config.lidars.get(sensor)
    return np.zeros(3) if lidar is None else lidar.matrix()[:3, 3]


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
    fit += bends(factors, values, first, config)
    placed = sorted(state.clusters, key=lambda item: item.cluster.stamp)
    fixes = track(state.fixes)
    looks = ground_looks(state.scans, config)
    return [
        *speed_findings(
            np.array([item.cluster.stamp for item in placed], dtype=np.int64),
            np.array([values.atPose3(pose_key(item.id)).translation() for item in placed]),
        ),
        *distance_findings(driven, fixes),
        *_distrusted(state, values),
        *ground_findings(looks),
        *planar_findings(looks),
        *causes(fit, moving(driven, fixes)),
    ]


def bends(
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


def moving(driven: Sequence[Motions], fixes: Track) -> list[Finding]:
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
