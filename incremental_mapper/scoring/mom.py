"""The Mutually Orthogonal Metric of a window's candidates (paper, section Evaluation Metric).

The query points and their neighbourhoods are found once per window, at the poses of one
candidate. Each scan's part of a neighbourhood is kept as its moments, which any other candidate
only shifts and turns; neighbours that come or go are corrected one by one. ``direct_score``
searches the neighbourhoods of each candidate again, by other means.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from incremental_mapper.compiled import kernel
from incremental_mapper.config import MomSettings
from incremental_mapper.scoring.eigen import full_matrices, smallest_eigen
from incremental_mapper.scoring.moment_update import ROUNDING, largest_drifts, moved_covariances
from incremental_mapper.scoring.moments import covariances, sum_products
from incremental_mapper.scoring.neighbourhoods import (
    BoundaryPairs,
    Grid,
    find_boundary_pairs,
    make_grid,
    scan_moments,
    shared_neighbourhoods,
)
from incremental_mapper.scoring.plane_families import orthogonal_families, spread_positions

PLANE_VARIANCE = 'plane_variance'
BATCH = 32
"""Candidates that are scored together; it bounds the memory that they take."""


@dataclass(frozen=True, slots=True, eq=False)
class LocalMap:
    """What a window's candidates are judged on.

    ``fixed`` are points (F, 3) of recent scans, already placed in the map. ``moving`` are the
    scans (N_s, 3) in base_link whose poses differ between candidates; the first ``fresh`` of them
    are the window's new scans. ``poses`` (C, S, 4, 4) are their T_map_base in the candidates that
    will be judged; the first candidate is the reference. ``origin`` (3,) is a place near the car:
    numbers relative to it keep the moments exact.
    """

    fixed: NDArray[np.float64]
    moving: Sequence[NDArray[np.float64]]
    poses: NDArray[np.float64]
    fresh: int
    origin: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class QueryPoints:
    """Points at which the candidates of one window are judged.

    ``points`` (P, 3) stand at the reference, relative to the origin; ``scan`` (P,), ascending, says
    whose they are: 0 the fixed points, then the moving scans. ``moments`` (P, 1 + S, 10) are the
    moments of each scan's part of a neighbourhood, at the reference and about the point. They hold
    under any candidate that drifts by no more than ``reach`` (P, 1 + S) metres, but for the
    pairs at the ``boundary``; ``grid`` gives those for any other reach. ``weights`` (P,) make the
    mean over families of the mean in each; ``families`` are those that count, and ``family`` (P,)
    is 0, 1 or 2, a row of ``axes`` (3, 3), their unit normals.
    """

    points: NDArray[np.float64]
    scan: NDArray[np.int64]
    moments: NDArray[np.float64]
    reach: NDArray[np.float64]
    boundary: BoundaryPairs
    grid: Grid
    family: NDArray[np.int64]
    families: tuple[int, ...]
    weights: NDArray[np.float64]
    axes: NDArray[np.float64]
    score_name: str


def choose_query_points(local_map: LocalMap, settings: MomSettings) -> QueryPoints | None:
    """Find planar neighbourhoods that a new scan shares with another one, and their families.

    None where there is no such neighbourhood.
    """
    bounds = np.cumsum([0, len(local_map.fixed), *map(len, local_map.moving)])
    first, last = bounds[1].item(), bounds[local_map.fresh + 1].item()
    # Half as many again as are wanted: not every seed turns out to be planar.
    seeds = first + spread_positions(last - first, settings.max_points * 3 // 2)
    if len(seeds) == 0:
        return None
    points = _placed(local_map, bounds)
    queries, scan = points.take(seeds, axis=0), np.searchsorted(bounds, seeds, side='right') - 1
    grid = make_grid(points, bounds, settings.radius)
    moments = scan_moments(grid, queries, settings.radius, len(bounds) - 1)
    # Alone, a scan has the same planes at any pose.
    chosen, spread = shared_neighbourhoods(moments, scan, settings.min_neighbours)
    found = smallest_eigen(spread)
    planar = np.flatnonzero(found.middle > settings.eigenvalue_ratio * found.values)
    if len(planar) == 0:
        return None
    families = orthogonal_families(found.vectors.take(planar, axis=1), settings.max_angle)
    labels, counted, name = _count_families(families.labels, settings)
    kept = _thin_families(labels, counted, settings.max_points)
    chosen, labels = chosen[planar[kept]], labels[kept]
    queries, scan = queries.take(chosen, axis=0), scan[chosen]
    # The reference itself does not drift.
    motions = _motions(local_map, local_map.poses[1:])
    reach, boundary = _reach(motions, queries, scan, grid, settings)
    return QueryPoints(
        points=queries,
        scan=scan,
        moments=moments.take(chosen, axis=0),
        reach=reach,
        boundary=boundary,
        grid=grid,
        family=labels,
        families=counted,
        weights=1.0 / (np.bincount(labels)[labels] * len(counted)),
        axes=families.axes,
        score_name=name,
    )


def _reach(
    motions: NDArray[np.float64],
    queries: NDArray[np.float64],
    scan: NDArray[np.int64],
    grid: Grid,
    settings: MomSettings,
) -> tuple[NDArray[np.float64], BoundaryPairs]:
    """Reach and boundary pairs of queries (P, 3) of scans (P,) for candidates (C, 1 + S, 4, 4)."""
    # Candidates that drift further would have so many pairs that searching again costs less.
    reach = largest_drifts(motions, queries, scan, settings.radius)
    return reach, find_boundary_pairs(grid, queries, settings.radius, reach + ROUNDING)


def warm_up() -> None:
    """Compile all that scoring needs, or load it from disk."""
    side = 0.4 * np.arange(20.0)
    x, y = (grid.ravel() for grid in np.meshgrid(side, side))
    floor = np.stack([x, y, 0.01 * np.cos(9.0 * x)], axis=1)
    poses = np.tile(np.eye(4), (2, 2, 1, 1))
    poses[1, 0, 0, 3] = 0.1
    local_map = LocalMap(floor, [floor, floor], poses, 1, np.zeros(3))
    query_points = choose_query_points(local_map, MomSettings())
    assert query_points is not None  # the floor is flat
    fast_scores(query_points, poses, local_map, MomSettings())


def fast_scores(
    query_points: QueryPoints,
    poses: NDArray[np.float64],
    local_map: LocalMap,
    settings: MomSettings,
    exact: bool = True,
) -> NDArray[np.float64]:
    """MOM in m^2 (C,) of candidates with the moving scans at ``poses`` (C, S, 4, 4).

    The values are those of ``direct_score``. Candidates that drift by more than the radius are
    indeed searched again, unless ``exact`` is off: then those beyond the reach of the query points
    keep what neighbours they had there. A candidate with poses that are not finite has the score
    NaN.
    """
    return weighted(query_points, fast_variances(query_points, poses, local_map, settings, exact))


def weighted(query_points: QueryPoints, variances: NDArray[np.float64]) -> NDArray[np.float64]:
    """MOM in m^2 (C,) of candidates by their plane variances (C, P)."""
    # In the batches in which they came, so that the last bit does not depend on how many there are.
    parts = [
        variances[start : start + BATCH] @ query_points.weights
        for start in range(0, len(variances), BATCH)
    ]
    return np.concatenate(parts) if parts else np.empty(0)


def fast_variances(
    query_points: QueryPoints,
    poses: NDArray[np.float64],
    local_map: LocalMap,
    settings: MomSettings,
    exact: bool = True,
) -> NDArray[np.float64]:
    """Plane variances in m^2 (C, P) of which ``fast_scores`` are the weighted means."""
    variances = np.empty((len(poses), len(query_points.points)))
    for start in range(0, len(poses), BATCH):
        some = poses[start : start + BATCH]
        motions, finite = _motions(local_map, some), np.isfinite(some).all(axis=(1, 2, 3))
        values, near = _moved_variances(query_points, motions, settings, exact)
        far = np.flatnonzero(~near & finite & exact)
        if len(far):
            # The same query points with a longer reach are ready sooner than any search.
            reach, boundary = _reach(
                motions[far], query_points.points, query_points.scan, query_points.grid, settings
            )
            longer = replace(query_points, reach=reach, boundary=boundary)
            values[far], near = _moved_variances(longer, motions[far], settings)
            for further in far[~near]:
                values[further] = direct_variances(query_points, some[further], local_map, settings)
        variances[start : start + BATCH] = values
    return variances


def _moved_variances(
    query_points: QueryPoints,
    motions: NDArray[np.float64],
    settings: MomSettings,
    exact: bool = True,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Variances (C, P) of candidates (C, 1 + S, 4, 4), and which of them are within reach."""
    spread, near = moved_covariances(
        motions,
        query_points.points,
        query_points.scan,
        query_points.moments,
        query_points.boundary,
        query_points.reach if exact else np.full_like(query_points.reach, np.inf),
        settings.radius,
    )
    return smallest_eigen(spread.reshape(6, -1)).values.reshape(len(motions), -1), near


def fast_score(
    query_points: QueryPoints,
    poses: NDArray[np.float64],
    local_map: LocalMap,
    settings: MomSettings,
) -> float:
    """MOM in m^2 of the moving scans at ``poses`` (S, 4, 4), from the query points' moments."""
    return float(fast_scores(query_points, poses[None], local_map, settings)[0])


def direct_score(
    query_points: QueryPoints,
    poses: NDArray[np.float64],
    local_map: LocalMap,
    settings: MomSettings,
) -> float:
    """The same value with the neighbourhoods searched again at ``poses`` (S, 4, 4)."""
    variances = direct_variances(query_points, poses, local_map, settings)
    return float(variances @ query_points.weights)


def direct_variances(
    query_points: QueryPoints,
    poses: NDArray[np.float64],
    local_map: LocalMap,
    settings: MomSettings,
) -> NDArray[np.float64]:
    """Plane variances (P,) with the neighbourhoods searched again at ``poses`` (S, 4, 4), m^2."""
    points = _place(local_map, poses)
    motions = _motions(local_map, poses[None])[0][query_points.scan]
    queries = np.einsum('pij,pj->pi', motions[:, :3, :3], query_points.points) + motions[:, :3, 3]
    # An unbalanced tree is built in half the time and is asked only once.
    tree = KDTree(points, leafsize=24, balanced_tree=False, compact_nodes=False)
    found = tree.query_ball_point(queries, settings.radius, return_sorted=False)
    rows = np.repeat(np.arange(len(found)), [len(near) for near in found])
    columns = np.concatenate([np.asarray(near, dtype=np.int64) for near in found])
    numbers = sum_products(rows, columns, points.T, len(found))
    variances = np.linalg.eigvalsh(full_matrices(covariances(numbers)))[:, 0]
    positive: NDArray[np.float64] = np.maximum(variances, 0.0)
    return positive


def _place(local_map: LocalMap, poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """All points (N, 3) relative to the origin: the fixed ones, then those of the moving scans."""
    placed = [
        cloud @ pose[:3, :3].T + (pose[:3, 3] - local_map.origin)
        for pose, cloud in zip(poses, local_map.moving, strict=True)
    ]
    return np.vstack([local_map.fixed - local_map.origin, *placed])


def _placed(local_map: LocalMap, bounds: NDArray[np.int64]) -> NDArray[np.float64]:
    """As ``_place`` at the reference; scan s has the points bounds[s] to bounds[s + 1]."""
    points = np.empty((bounds[-1], 3))
    np.concatenate([local_map.fixed, *local_map.moving], out=points)
    _move(points, bounds, local_map.poses[0].copy(), local_map.origin.copy())
    return points


@kernel
def _move(
    points: NDArray[np.float64],
    bounds: NDArray[np.int64],
    poses: NDArray[np.float64],
    origin: NDArray[np.float64],
) -> None:
    """Move the ``points`` (N, 3) of every scan by its pose (S, 4, 4), in place; see _placed."""
    for i in range(bounds[1]):
        for k in range(3):
            points[i, k] -= origin[k]
    for s in range(len(poses)):
        m = poses[s]
        r, t, a, b = m[0, 0], m[0, 1], m[0, 2], m[0, 3] - origin[0]
        u, v, w, c = m[1, 0], m[1, 1], m[1, 2], m[1, 3] - origin[1]
        e, f, g, d = m[2, 0], m[2, 1], m[2, 2], m[2, 3] - origin[2]
        for i in range(bounds[s + 1], bounds[s + 2]):
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            points[i, 0] = r * x + t * y + a * z + b
            points[i, 1] = u * x + v * y + w * z + c
            points[i, 2] = e * x + f * y + g * z + d


def _motions(local_map: LocalMap, poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """How candidates (C, S, 4, 4) move fixed and moving points, (C, 1 + S, 4, 4).

    From where they stand at the reference, relative to the origin.
    """
    # Copies, because an array that cannot be written to would be another type to compile for.
    return _changes(poses.copy(), local_map.poses[0].copy(), local_map.origin.copy())


@kernel
def _changes(
    poses: NDArray[np.float64], reference: NDArray[np.float64], origin: NDArray[np.float64]
) -> NDArray[np.float64]:
    """See _motions; ``reference`` (S, 4, 4)."""
    count, scans = poses.shape[0], poses.shape[1]
    motions = np.zeros((count, scans + 1, 4, 4))
    for c in range(count):
        for i in range(4):
            motions[c, 0, i, i] = 1.0
        for s in range(scans):
            pose, before, motion = poses[c, s], reference[s], motions[c, s + 1]
            for i in range(3):
                motion[i, 3] = pose[i, 3] - origin[i]
                for j in range(3):
                    turn = 0.0
                    for k in range(3):
                        turn += pose[i, k] * before[j, k]
                    motion[i, j] = turn
                    motion[i, 3] -= turn * (before[j, 3] - origin[j])
            motion[3, 3] = 1.0
    return motions


def _count_families(
    labels: NDArray[np.int64], settings: MomSettings
) -> tuple[NDArray[np.int64], tuple[int, ...], str]:
    sizes = np.bincount(labels[labels >= 0], minlength=3).tolist()
    counted = tuple(family for family in range(3) if sizes[family] >= settings.min_family_points)
    if counted:
        return labels, counted, f'mom_{len(counted)}'
    return np.zeros(len(labels), dtype=np.int64), (0,), PLANE_VARIANCE


def _thin_families(
    labels: NDArray[np.int64], counted: tuple[int, ...], max_points: int
) -> NDArray[np.int64]:
    """Positions of at most ``max_points`` points, ascending, shared evenly between families."""
    share = max(max_points // len(counted), 1)
    picks = []
    for family in counted:
        members = np.flatnonzero(labels == family)
        few = len(members) <= share
        picks.append(members if few else members[spread_positions(len(members), share)])
    kept = np.concatenate(picks)
    kept.sort()
    return kept
