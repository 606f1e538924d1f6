"""Several sessions as one map: in one frame, under one count of clusters, solved together.

Sessions whose maps are east-north-up meet in the frame of the first one: every fix ties a session
to the earth, and so to the others. What their local maps say besides enters the same solve.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from itertools import accumulate
from typing import Any

import gtsam
import numpy as np

from incremental_mapper.blas import single_threaded_blas
from incremental_mapper.checks.finding import Finding, Severity, ranked
from incremental_mapper.config import Config
from incremental_mapper.frontend.gnss import Datum
from incremental_mapper.graph.factors import Factor, FactorKind, gnss_factor
from incremental_mapper.mapping.final_solve import MOST_ITERATIONS
from incremental_mapper.mapping.georeferencing import turn_prior, turn_values
from incremental_mapper.mapping.loop_closing import solve_with_closures
from incremental_mapper.mapping.result import MapResult, Session, trajectory_of
from incremental_mapper.mapping.statistics import MapStatistics
from incremental_mapper.results.sessions.numbering import numbered
from incremental_mapper.settings import to_tree
from incremental_mapper.smoothing.batch import make_graph, optimize
from incremental_mapper.variables import cluster_of

FIXES, CLOSURES = 'fixes', 'closures'
"""What relates sessions: they know where on the earth they are, or show the same places."""
ARM = 1000.0
"""Metres from a datum to the places by which another one's axes are told."""


def between_datums(target: Datum, source: Datum) -> gtsam.Pose3:
    """From the east-north-up frame of one datum to that of another, by the ellipsoid.

    Args:
        target: The datum whose frame is wanted.
        source: That of the frame there is.

    Returns:
        T_target_source: both are frames of the same solid earth, so it is rigid.
    """
    if target == source:
        return gtsam.Pose3()
    origin = target.enu_of(source)
    axes = [target.enu_of(source.geodetic(ARM * axis)) - origin for axis in np.eye(3)]
    turn = gtsam.Rot3.ClosestTo(np.stack(axes, axis=1) / ARM)
    return gtsam.Pose3(turn, origin)


def turned(result: MapResult, T_target_map: gtsam.Pose3, config: Config) -> MapResult:
    """A session in another frame.

    Args:
        result: The session.
        T_target_map: From the frame of its map.
        config: All settings.

    Returns:
        The same graph there. ``trajectory`` and ``fixes`` are those of before: ``joined`` makes
        them anew.
    """
    if T_target_map.equals(gtsam.Pose3(), 0.0):
        return result
    rotation = T_target_map.rotation().matrix()
    factors: list[Factor] = []
    for factor in result.factors:
        if factor.kind is not FactorKind.GNSS:
            factors.append(turn_prior(factor, T_target_map, config))
            continue
        data = factor.data
        factors.append(
            gnss_factor(
                factor.keys[0],
                T_target_map.transformFrom(np.array(data['position'])),
                rotation @ np.array(data['covariance']) @ rotation.T,
                np.array(data['lever_arm']),
                config.fixes.robust_threshold,
                factor.sensor or 'gnss',
                factor.stamps[0],
            )
        )
    values = turn_values(result.values, T_target_map)
    return replace(result, factors=tuple(factors), values=values)


@single_threaded_blas()
def joined(
    parts: Sequence[MapResult],
    config: Config,
    ties: Sequence[Factor] = (),
    searched: int = 0,
    seams: Sequence[Factor] = (),
) -> MapResult:
    """Sessions that lie in one frame as one map, solved together.

    Args:
        parts: The sessions, in the order in which they are counted; each may be of several.
        config: All settings, of the newest.
        ties: Closures between poses of different sessions, under their numbers in the joint map:
            those of a session count on from the clusters of the sessions before it.
        searched: How many pairs of local maps were compared for them.
        seams: Other factors between them, under the same numbers; see ``seam_factors``.

    Returns:
        The map of all: every cluster, factor and scan of each.
    """
    clusters_before = list(accumulate((len(part.clusters) for part in parts), initial=0))
    windows_before = list(accumulate((len(part.rows) for part in parts), initial=0))
    parts_numbered = [
        numbered(part, clusters, windows)
        for part, clusters, windows in zip(parts, clusters_before, windows_before, strict=False)
    ]
    clusters = tuple(item for part in parts_numbered for item in part.clusters)
    factors = (*(item for part in parts_numbered for item in part.factors), *seams)
    values = gtsam.Values()
    for part in parts_numbered:
        values.insert(part.values)
    failed = False
    if config.graph.final_optimization:
        plain = [factor.factor for factor in factors]
        solution = optimize(make_graph(plain), values, MOST_ITERATIONS)
        values, failed = (values, True) if solution is None else (solution.values, False)
        closed = solve_with_closures(plain, tuple(ties), values)
        factors, values, ties = (*factors, *closed.factors), closed.values, closed.factors
    else:
        factors = (*factors, *ties)
    positions = [f.data['position'] for f in factors if f.kind is FactorKind.GNSS]
    return MapResult(
        clusters=clusters,
        factors=factors,
        values=values,
        trajectory=trajectory_of(clusters, values),
        scans=tuple(item for part in parts_numbered for item in part.scans),
        fixes=np.array(positions, dtype=np.float64).reshape(-1, 3),
        rows=tuple(item for part in parts_numbered for item in part.rows),
        statistics=_statistics(
            [part.statistics for part in parts], to_tree(config), searched, (*ties, *seams), failed
        ),
        findings=ranked(_worst_last(parts)),
        failed=tuple(item for part in parts_numbered for item in part.failed),
        sessions=_sessions(parts, clusters_before, ties),
    )


def alone(result: MapResult, where: str) -> MapResult:
    """A map as the only session that it is made of.

    Args:
        result: The map.
        where: Its input.
    """
    if result.sessions:
        return result
    drive = result.statistics.drive_s
    return replace(
        result, sessions=(Session(where, len(result.rows), len(result.clusters), drive),)
    )


def _worst_last(parts: Sequence[MapResult]) -> list[Finding]:
    """All findings; of two of one rule the last one is told."""
    found = [finding for part in parts for finding in part.findings]
    return sorted(found, key=lambda finding: finding.severity is Severity.ERROR)


def _sessions(
    parts: Sequence[MapResult], before: Sequence[int], ties: Sequence[Factor]
) -> tuple[Session, ...]:
    """The sessions of all, each with what relates it to those before."""
    tied = {cluster_of(key) for factor in ties for key in factor.keys}
    told: list[Session] = []
    for part, low, high in zip(parts, before[:-1], before[1:], strict=True):
        how = f'{FIXES} and {CLOSURES}' if any(low <= one < high for one in tied) else FIXES
        told += [
            replace(one, joined_by=one.joined_by or (how if told or place else ''))
            for place, one in enumerate(part.sessions)
        ]
    return tuple(told)


def _statistics(
    parts: Sequence[MapStatistics],
    settings: Mapping[str, Any],
    searched: int,
    between: Sequence[Factor],
    failed: bool,
) -> MapStatistics:
    """The counts of all, as if they had been counted together."""
    first, newest = parts[0], parts[-1]
    total = {
        item.name: _sum([getattr(part, item.name) for part in parts])
        for item in fields(MapStatistics)
        if item.name not in ('strategy', 'settings', 'verification', 'datum')
    }
    own = Counter(str(factor.kind) for factor in between)
    if searched:
        closures = {'candidates': searched, 'accepted': own[str(FactorKind.CLOSURE)]}
        total['closures'] = _sum([total['closures'], closures])
    total['factors'] += len(between)
    kinds = _sum([total['factors_by_kind'], own])
    total['factors_by_kind'] = dict(sorted(kinds.items()))
    total['solver_failures'] += int(failed)
    # Each hangs on the one before it by what relates them.
    total['components'] -= len(parts) - 1
    for name in ('vertices', 'factors', 'clusters'):
        base = total[f'base_{name}']
        share = 100.0 * (1.0 - total[name] / base) if base else 0.0
        total[f'compression_{name}_percent'] = share
    total['georeferenced'] = all(part.georeferenced for part in parts)
    return MapStatistics(
        **total,
        strategy=newest.strategy,
        settings=dict(settings),
        verification=newest.verification,
        datum=first.datum,
    )


def _sum(values: Sequence[Any]) -> Any:
    """Numbers, or numbers under the same names, added up."""
    if not isinstance(values[0], Mapping):
        return sum(values)
    names = dict.fromkeys(name for value in values for name in value)
    return {name: _sum([value[name] for value in values if name in value]) for name in names}
