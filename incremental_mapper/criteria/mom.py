"""The Mutually Orthogonal Metric of a window's candidates (paper, section Evaluation Metric).

The judging points and their neighbourhoods are found once per window, at the poses of one
candidate. Each scan's part of a neighbourhood is kept as its homogeneous moment Σ p̃ p̃ᵀ; under a
motion T it becomes T M Tᵀ, which is linear in M. One matrix product thus moves the moments of all
neighbourhoods for many candidates at once; neighbours that come or go are corrected one by one.
``direct_score`` searches the neighbourhoods of each candidate again, by other means.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from incremental_mapper.config import MomSettings
from incremental_mapper.criteria.eigen import full_matrices, smallest_eigen
from incremental_mapper.criteria.moments import (
    COUNT,
    NUMBERS,
    covariances,
    sum_products,
    transfers,
)
from incremental_mapper.criteria.neighbourhoods import Pairs, RowIndex
from incremental_mapper.criteria.planes import orthogonal_families, spread_positions
from incremental_mapper.criteria.shell import ROUNDING, Shell, drifts, squared_lengths

PLANE_VARIANCE = 'plane_variance'
BATCH = 32
"""Candidates that are scored together; it bounds the memory that they take."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
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
class Judges:
    """Judging points of one window.

    ``points`` (3, P) stand at the reference, relative to the origin; ``scan`` (P,) says whose
    they are: 0 the fixed points, then the moving scans. ``parts`` (10·(1 + S), P) are the moments
    of each scan's part of a neighbourhood, at the reference, number by number. They hold under any
    candidate that drifts by no more than ``reach`` (1 + S, P) metres, but for the ``shell``.
    ``weights`` (P,) of the judges make the mean over families of the mean in each; ``families``
    are those that count, and ``family`` (P,) is 0, 1 or 2.
    """

    points: NDArray[np.float64]
    scan: NDArray[np.int64]
    parts: NDArray[np.float64]
    reach: NDArray[np.float64]
    shell: Shell
    family: NDArray[np.int64]
    families: tuple[int, ...]
    weights: NDArray[np.float64]
    score_name: str


def choose_judges(scene: Scene, settings: MomSettings) -> Judges | None:
    """Find planar neighbourhoods that a new scan shares with another one, and their families.

    None where there is no such neighbourhood.
    """
    points, owner = _place(scene, scene.poses[0])
    first, last = np.searchsorted(owner, [1, scene.fresh + 1])
    # Half as many again as are wanted: not every seed turns out to be planar.
    seeds = first + spread_positions(int(last - first), settings.max_points * 3 // 2)
    if len(seeds) == 0:
        return None
    queries, scan, scans = points.take(seeds, axis=1), owner[seeds], len(scene.moving) + 1
    # The reference itself does not drift.
    reach = _reach(_motions(scene, scene.poses[1:]), queries, scan, settings.radius)
    radii = settings.radius + reach.max(axis=0) + ROUNDING
    index = RowIndex(points, float(radii.max()))
    points, owner = index.points, owner.take(index.order)
    parts, rims = np.empty((NUMBERS, scans, len(seeds))), []
    for pairs in index.search(queries, radii):
        count = len(seeds[pairs.queries])
        inside = pairs.squares <= settings.radius**2
        inner = np.flatnonzero(inside)
        columns = pairs.columns.take(inner)
        # Where the point's scan and the query of a pair stand in tables (1 + S, count).
        cell = owner.take(columns) * count + pairs.rows.take(inner)
        sums = sum_products(cell, columns, points, scans * count)
        parts[:, :, pairs.queries] = sums.reshape(NUMBERS, scans, count)
        rim = _rim(pairs, owner, reach[:, pairs.queries], settings.radius)
        rims.append((pairs.queries.start + pairs.rows[rim], pairs.columns[rim], inside[rim]))
    total = parts.sum(axis=1)
    # Alone, a scan has the same planes at any pose.
    shared = total[COUNT] > parts[COUNT, scan, np.arange(len(seeds))]
    chosen = np.flatnonzero(shared & (total[COUNT] >= settings.min_neighbours))
    found = smallest_eigen(covariances(total.take(chosen, axis=1)))
    planar = np.flatnonzero(found.middle > settings.eigenvalue_ratio * found.values)
    if len(planar) == 0:
        return None
    families = orthogonal_families(found.vectors.take(planar, axis=1).T, settings.max_angle)
    labels, counted, name = _count_families(families.labels, settings)
    kept = _thin_families(labels, counted, settings.max_points)
    chosen, labels = chosen[planar[kept]], labels[kept]
    return Judges(
        points=queries[:, chosen],
        scan=scan[chosen],
        parts=parts.take(chosen, axis=2).reshape(NUMBERS * scans, len(chosen)),
        reach=reach[:, chosen],
        shell=_shell(rims, points, owner, queries, chosen),
        family=labels,
        families=counted,
        weights=1.0 / (np.bincount(labels)[labels] * len(counted)),
        score_name=name,
    )


def fast_scores(
    judges: Judges,
    poses: NDArray[np.float64],
    scene: Scene,
    settings: MomSettings,
    exact: bool = True,
) -> NDArray[np.float64]:
    """MOM in m^2 (C,) of candidates with the moving scans at ``poses`` (C, S, 4, 4).

    The values are those of ``direct_score``. Candidates that drift beyond the judges' reach are
    indeed searched again, unless ``exact`` is off: then they keep what neighbours they had there.
    """
    scores = np.empty(len(poses))
    for start in range(0, len(poses), BATCH):
        some = poses[start : start + BATCH]
        motions = _motions(scene, some)
        drift = drifts(motions, judges.points, judges.scan)
        allowed = np.square(judges.reach + 0.1 * ROUNDING)
        near = (squared_lengths(drift) <= allowed).all(axis=(1, 2)) | (not exact)
        values = np.empty(len(some))
        if near.any():
            values[near] = _moved_scores(judges, motions[near], drift[:, near], settings)
        for far in np.flatnonzero(~near):
            values[far] = direct_score(judges, some[far], scene, settings)
        scores[start : start + BATCH] = values
    return scores


def fast_score(
    judges: Judges, poses: NDArray[np.float64], scene: Scene, settings: MomSettings
) -> float:
    """MOM in m^2 of the moving scans at ``poses`` (S, 4, 4), from the judges' moments."""
    return float(fast_scores(judges, poses[None], scene, settings)[0])


def direct_score(
    judges: Judges, poses: NDArray[np.float64], scene: Scene, settings: MomSettings
) -> float:
    """The same value with the neighbourhoods searched again at ``poses`` (S, 4, 4)."""
    points = _place(scene, poses)[0].T
    motions = _motions(scene, poses[None])[0][judges.scan]
    queries = np.einsum('pij,jp->pi', motions[:, :3, :3], judges.points) + motions[:, :3, 3]
    # An unbalanced tree is built in half the time and is asked only once.
    tree = KDTree(points, leafsize=24, balanced_tree=False, compact_nodes=False)
    found = tree.query_ball_point(queries, settings.radius, return_sorted=False)
    rows = np.repeat(np.arange(len(found)), [len(near) for near in found])
    columns = np.concatenate([np.asarray(near, dtype=np.int64) for near in found])
    numbers = sum_products(rows, columns, points.T, len(found))
    variances = np.linalg.eigvalsh(full_matrices(covariances(numbers)))[:, 0]
    return float(np.maximum(variances, 0.0) @ judges.weights)


def _moved_scores(
    judges: Judges,
    motions: NDArray[np.float64],
    drift: NDArray[np.float64],
    settings: MomSettings,
) -> NDArray[np.float64]:
    """Scores (C,) of candidates within reach."""
    count, scans = motions.shape[:2]
    # (10·C, 10·S): all candidates' numbers of the whole neighbourhood from those of its parts.
    moving = transfers(motions).transpose(2, 0, 3, 1).reshape(NUMBERS * count, scans * NUMBERS)
    numbers = (moving @ judges.parts).reshape(NUMBERS, count, -1)
    numbers += judges.shell.flips(motions, drift, settings.radius)
    found = smallest_eigen(covariances(numbers.reshape(NUMBERS, -1)))
    scores: NDArray[np.float64] = found.values.reshape(count, -1) @ judges.weights
    return scores


def _place(
    scene: Scene, poses: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """All points (3, N) relative to the origin, and whose they are: 0 fixed, 1.. moving."""
    sizes = [len(scene.fixed), *(len(cloud) for cloud in scene.moving)]
    ends = np.cumsum(sizes)
    points = np.empty((3, ends[-1]))
    np.subtract(scene.fixed.T, scene.origin[:, None], out=points[:, : sizes[0]])
    for pose, cloud, start, end in zip(poses, scene.moving, ends[:-1], ends[1:], strict=True):
        own = points[:, start:end]
        np.matmul(pose[:3, :3], cloud.T, out=own)
        own += (pose[:3, 3] - scene.origin)[:, None]
    return points, np.repeat(np.arange(len(sizes)), sizes)


def _motions(scene: Scene, poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """How candidates (C, S, 4, 4) move fixed and moving points, (C, 1 + S, 4, 4).

    From where they stand at the reference, relative to the origin.
    """
    reference = scene.poses[0]
    turns = poses[:, :, :3, :3] @ np.swapaxes(reference[:, :3, :3], -1, -2)
    motions = np.zeros((len(poses), len(reference) + 1, 4, 4))
    motions[:, :, [0, 1, 2, 3], [0, 1, 2, 3]] = 1.0
    motions[:, 1:, :3, :3] = turns
    before, after = reference[:, :3, 3] - scene.origin, poses[:, :, :3, 3] - scene.origin
    motions[:, 1:, :3, 3] = after - (turns @ before[:, :, None])[..., 0]
    return motions


def _reach(
    motions: NDArray[np.float64],
    queries: NDArray[np.float64],
    scan: NDArray[np.int64],
    limit: float,
) -> NDArray[np.float64]:
    """Largest drifts (1 + S, Q) of the candidates that drift by no more than ``limit`` metres.

    The others would make shells that cost more than to search again for them alone.
    """
    found = squared_lengths(drifts(motions, queries, scan))
    near = found.max(axis=(1, 2)) <= limit**2
    some = found if near.all() else found[near]
    largest: NDArray[np.float64] = np.sqrt(some.max(axis=0, initial=0.0))
    return largest


def _rim(
    pairs: Pairs, owner: NDArray[np.int64], reach: NDArray[np.float64], radius: float
) -> NDArray[np.int64]:
    """Which pairs come or go where their distance changes by no more than ``reach`` (1 + S, Q)."""
    # Most pairs are too near for any reach.
    least = max(radius - float(reach.max()) - 2.0 * ROUNDING, 0.0)
    some = np.flatnonzero(pairs.squares >= least**2)
    cell = owner.take(pairs.columns.take(some)) * reach.shape[1] + pairs.rows.take(some)
    apart = np.abs(np.sqrt(pairs.squares.take(some)) - radius)
    rim: NDArray[np.int64] = some[apart <= reach.take(cell) + ROUNDING]
    return rim


def _shell(
    rims: Sequence[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]],
    points: NDArray[np.float64],
    owner: NDArray[np.int64],
    queries: NDArray[np.float64],
    chosen: NDArray[np.int64],
) -> Shell:
    """The shell of the chosen queries; ``rims`` are query, point and inside of pairs."""
    query, point, inside = (np.concatenate(parts) for parts in zip(*rims, strict=True))
    place = np.full(queries.shape[1], -1)
    place[chosen] = np.arange(len(chosen))
    kept = np.flatnonzero(place[query] >= 0)
    query, point, inside = query[kept], point[kept], inside[kept]
    near = points[:, point]
    return Shell(
        judge=place[query],
        scan=owner[point],
        points=near,
        apart=near - queries[:, query],
        inside=inside,
    )


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
    """Positions of at most ``max_points`` judges, ascending, shared evenly between families."""
    share = max(max_points // len(counted), 1)
    picks = []
    for family in counted:
        members = np.flatnonzero(labels == family)
        picks.append(members[spread_positions(len(members), share)])
    return np.sort(np.concatenate(picks))
