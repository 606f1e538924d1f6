"""What the local maps of two sessions say of how they lie to each other.

The search over pairs of sessions has no state and needs nothing but the pair, so that it runs
anywhere; what comes of it enters the one solve of all.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.closures.candidate_pairs import Known, Relative
from incremental_mapper.closures.local_maps import LocalMap
from incremental_mapper.closures.search import Found, find_closures
from incremental_mapper.closures.verification import Closure
from incremental_mapper.config import ClosureSettings, Config, MapSettings
from incremental_mapper.geometry import transform_points
from incremental_mapper.graph.factors import Factor, closure_factor
from incremental_mapper.mapping.result import MapResult
from incremental_mapper.results.sessions.numbering import numbered
from incremental_mapper.smoothing.relative_covariance import RelativeCovariances
from incremental_mapper.variables import pose_key
from incremental_mapper.voxels import thin

SHORTER, NEARER = 0.5, 0.6
"""Local maps of sessions are so much smaller than those of loops, in way and range: where one
session begins as another ends, they share little way and hardly any points far ahead, and yet a
closure must be confirmed by another one. What is nearer tells more of the shape of the way; with
half of the range house fronts hold a match along the street three times worse."""
SURER = 0.4
"""Of the floors of a closure's deviations: fixes keep sessions from drift, and their closures are
0.02 to 0.03 m and 0.05 degrees off (``benchmarks/sessions.py joint``)."""
LESS_OVERLAP = 0.5
"""There, what both show is less: one sees the fronts of things, and the other one their backs. The
fixes confirm it besides."""
UNCONFIRMED_OVERLAP = 0.8
"""The same where the fixes are not believed."""
CANDIDATES = 2
"""Local maps of the other session that one is compared with, at most: they lie twice as dense as
those of loops."""
DISAGREE = 3
"""So many closures that agree with each other, and not with the fixes, prove the fixes wrong."""


@dataclass(frozen=True, slots=True, eq=False)
class Tie:
    """A place that two sessions show, as a cluster of each and its pose in that of the first.

    ``covariance`` (6, 6) is that of ``T_first_second`` (4, 4) in the frame of the second, rotation
    first; ``stamps`` are those of the clusters, ns.
    """

    first: int
    second: int
    T_first_second: NDArray[np.float64]
    covariance: NDArray[np.float64]
    stamps: tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class Ties:
    """What was found of two sessions.

    Attributes:
        found: The places that both show.
        searched: Pairs of local maps that were compared.
        apart: Metres by which the fixes of the two disagree with what they show; 0 where they do
            not.
    """

    found: tuple[Tie, ...] = ()
    searched: int = 0
    apart: float = 0.0


def find_ties(first: MapResult, second: MapResult, config: Config) -> Ties:
    """Find the places that two sessions show.

    Args:
        first: A session.
        second: Another one, in the same frame by its fixes.
        config: All settings; ``closure.enabled`` is obeyed.

    Returns:
        What was found; nothing where they do not come near each other.
    """
    settings = config.closure
    if not settings.enabled:
        return Ties()
    finer = settings.model_copy(
        update={
            'map_length': SHORTER * settings.map_length,
            'max_range': NEARER * settings.max_range,
            'min_overlap': LESS_OVERLAP * settings.min_overlap,
            'candidates': min(CANDIDATES, settings.candidates),
            'floor_translation': SURER * settings.floor_translation,
            'floor_rotation': SURER * settings.floor_rotation,
        }
    )
    maps = [
        *_near(first, second, finer, config.map, 0),
        *_near(second, first, finer, config.map, 1),
    ]
    if len({one.run for one in maps}) < 2:
        return Ties()
    before = len(first.clusters)
    both = [numbered(first, 0, 0), numbered(second, before, 0)]
    values = gtsam.Values(both[0].values)
    values.insert(both[1].values)
    factors = [factor.factor for part in both for factor in part.factors]
    try:
        covariances = RelativeCovariances(factors, values)
    except RuntimeError:
        return Ties()  # without knowing what is known, no closure can be held against it

    def known(one: LocalMap, other: LocalMap) -> Known:
        keys = [pose_key(item.cluster + before * item.run) for item in (one, other)]
        covariance = covariances.relative(keys[0], keys[1])
        return Known(one.T_map_base.between(other.T_map_base), covariance)

    found = _between(maps, known, finer, config)
    # Local maps that overlap have the same points, and so the same errors: all of them together
    # say as much as one.
    shared = _shared(maps, found.closures, finer.max_range)
    ties = tuple(
        Tie(
            maps[one.first].cluster,
            maps[one.second].cluster,
            one.T_first_second.matrix(),
            one.covariance * count,
            (maps[one.first].stamp, maps[one.second].stamp),
        )
        for one, count in zip(found.closures, shared, strict=True)
    )
    apart = 0.0
    if found.refused['improbable'] > len(ties):
        update = {'min_overlap': UNCONFIRMED_OVERLAP * settings.min_overlap}
        apart = _apart(maps, finer.model_copy(update=update), config)
    return Ties(ties, found.candidates, apart)


def disagreement(first: str, second: str, metres: float) -> Finding:
    """What tells that the fixes of two sessions contradict what both show.

    Args:
        first: Name of a session.
        second: Name of the other one.
        metres: How far they are apart.
    """
    text = (
        f'what {first} and {second} show of one place lies {metres:.2f} m apart by their fixes: '
        'one of them is wrong'
    )
    remedy = 'the map has such places twice; see whether both used the same reference station'
    return Finding('sessions_disagree', Severity.ERROR, '', text, remedy)


def tie_factors(ties: Ties, before: tuple[int, int], settings: ClosureSettings) -> list[Factor]:
    """The factors of what was found of two sessions of a joint map.

    Args:
        ties: What was found.
        before: How many clusters of other sessions come before those of each.
        settings: Those of closures.
    """
    return [
        closure_factor(
            (pose_key(tie.first + before[0]), pose_key(tie.second + before[1])),
            gtsam.Pose3(tie.T_first_second),
            tie.covariance,
            settings.robust_threshold,
            tie.stamps,
        )
        for tie in ties.found
    ]


def _between(
    maps: Sequence[LocalMap], known: Relative, settings: ClosureSettings, config: Config
) -> Found:
    """Closures between two sessions; those within one are its own business."""
    found = find_closures(maps, known, settings, config.odometry)
    across = [one for one in found.closures if maps[one.first].run != maps[one.second].run]
    return Found(tuple(across), found.candidates, found.refused)


def _apart(maps: Sequence[LocalMap], settings: ClosureSettings, config: Config) -> float:
    """Metres between where fixes put two sessions and where what they show does; 0 unless sure."""
    found = _between(maps, lambda _, __: None, settings, config).closures
    if len(found) < DISAGREE:
        return 0.0
    moved = [
        maps[one.first].T_map_base.between(maps[one.second].T_map_base).translation()
        - one.T_first_second.translation()
        for one in found
    ]
    return float(np.median(np.linalg.norm(moved, axis=1)))


def _near(
    own: MapResult, other: MapResult, settings: ClosureSettings, thinning: MapSettings, run: int
) -> list[LocalMap]:
    """Local maps of a session where it comes near another one's way.

    Of a saved session the scans are gone, so both are cut from maps: what its map shows around it.
    """
    way, others = (
        np.array([part.values.atPose3(pose_key(one.id)).translation() for one in part.clusters])
        for part in (own, other)
    )
    steps = np.linalg.norm(np.diff(way, axis=0), axis=1)
    travelled = np.append(0.0, np.cumsum(steps))
    centres = np.arange(0.5 * settings.map_length, travelled[-1], settings.map_length)
    ends = {0, len(way) - 1}
    all_middles = sorted({*ends, *(int(np.abs(travelled - centre).argmin()) for centre in centres)})
    far = settings.radius + settings.map_length
    apart = KDTree(others[:, :2]).query(way[:, :2], distance_upper_bound=far)[0]
    middles = [middle for middle in all_middles if apart[middle] <= far]
    if not middles:
        return []
    cloud = own.cloud(thinning, []).points[:, :3].astype(np.float64)
    points = thin(cloud, settings.voxel_size)
    tree = KDTree(points[:, :2])
    made: list[LocalMap] = []
    for middle in middles:
        placed = own.clusters[middle]
        pose = own.values.atPose3(pose_key(placed.id))
        # Where a session ends and another begins, each sees the other's way from its end alone.
        reach = settings.max_range / (NEARER if middle in ends else 1.0)
        around = tree.query_ball_point(way[middle][:2], reach)
        seen = transform_points(pose.inverse().matrix(), points[around]).astype(np.float32)
        stamp = placed.cluster.stamp
        made.append(LocalMap(placed.id, stamp, pose, float(travelled[middle]), seen, run))
    return made


def _shared(maps: Sequence[LocalMap], found: Sequence[Closure], reach: float) -> list[float]:
    """How many closures each one shares its points with, itself among them.

    One from the same place shares all of them, one that is ``reach`` away none.
    """
    ways = np.array([maps[one.first].travelled for one in found])
    return [float(np.maximum(1.0 - np.abs(ways - way) / reach, 0.0).sum()) for way in ways]
