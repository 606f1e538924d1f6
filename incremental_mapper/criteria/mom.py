"""The Mutually Orthogonal Metric of a window's candidates (paper, section Evaluation Metric).

The judging points and their neighbourhoods are found once per window, at the poses of one
candidate. Each scan's part of a neighbourhood is kept as its homogeneous moment Σ p̃ p̃ᵀ in the
scan's own frame; under a pose T it becomes T M Tᵀ, so a candidate's covariances follow from the
moments and its poses. ``direct_score`` searches the neighbourhoods again instead.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.config import MomSettings
from incremental_mapper.criteria.neighbourhoods import (
    Pairs,
    Shell,
    find_pairs,
    outer_products,
    sum_moments,
)
from incremental_mapper.criteria.planes import (
    covariances,
    orthogonal_families,
    smallest_eigenvalues,
    spread_positions,
)
from incremental_mapper.geometry import transform_points

PLANE_VARIANCE = 'plane_variance'


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """What a window's candidates are judged on.

    ``fixed`` are points (F, 3) of recent scans, already placed in the map. ``moving`` are the
    scans (N_s, 3) in base_link whose poses differ between candidates; the first ``fresh`` of them
    are the window's new scans. ``reference`` (S, 4, 4) are their poses T_map_base in one
    candidate, and ``margin`` bounds, in metres, how far another candidate moves two points
    against each other. ``origin`` (3,) is a place near the car: numbers relative to it keep the
    moments exact.
    """

    fixed: NDArray[np.float64]
    moving: Sequence[NDArray[np.float64]]
    reference: NDArray[np.float64]
    margin: float
    fresh: int
    origin: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Judges:
    """Judging points of one window.

    ``points`` (P, 3) are in their scan's frame, ``scan`` (P,) is its position in
    ``Scene.moving``. ``moments`` (1 + S, P, 4, 4) are those of the fixed points, relative to the
    origin, and of each moving scan in its own frame; ``shell`` holds the pairs near the rim in
    the same order. ``family`` (P,) is 0, 1 or 2, and ``families`` are those that count.
    """

    points: NDArray[np.float64]
    scan: NDArray[np.int64]
    moments: NDArray[np.float64]
    shell: Shell
    family: NDArray[np.int64]
    families: tuple[int, ...]
    score_name: str


def choose_judges(scene: Scene, settings: MomSettings) -> Judges | None:
    """Find planar neighbourhoods that a new scan shares with another one, and their families.

    None where there is no such neighbourhood.
    """
    relative = _relative(scene.reference, scene.origin)
    points, owner = _place(scene, relative)
    fresh = np.flatnonzero((owner >= 1) & (owner <= scene.fresh))
    # Half as many again as are wanted: not every seed turns out to be planar.
    seeds = fresh[spread_positions(len(fresh), settings.max_points * 3 // 2)]
    if len(seeds) == 0:
        return None
    pairs = find_pairs(points, points[seeds], settings.radius + scene.margin)
    products = outer_products(points)
    now = pairs.select(pairs.squares <= settings.radius**2)
    total = sum_moments(now, products, len(seeds))[0]
    values, vectors = np.linalg.eigh(covariances(total))
    # Alone, a scan has the same planes at any pose.
    other = now.rows[owner[now.columns] != owner[seeds][now.rows]]
    planar = (
        (np.bincount(other, minlength=len(seeds)) > 0)
        & (total[:, 3, 3] >= settings.min_neighbours)
        & (values[:, 1] > settings.eigenvalue_ratio * np.maximum(values[:, 0], 0.0))
    )
    chosen = np.flatnonzero(planar)
    if len(chosen) == 0:
        return None
    families = orthogonal_families(vectors[chosen, :, 0], settings.max_angle)
    labels, counted, name = _count_families(families.labels, settings)
    chosen, labels = _thin_families(chosen, labels, counted, settings.max_points)
    place = np.full(len(seeds), -1)
    place[chosen] = np.arange(len(chosen))
    pairs = pairs.select(place[pairs.rows] >= 0)
    rows = place[pairs.rows]
    core = pairs.squares <= max(settings.radius - scene.margin, 0.0) ** 2
    shell = _shell(scene, owner, rows[~core], pairs.columns[~core])
    sums = sum_moments(
        Pairs(rows[core], pairs.columns[core], pairs.squares[core]),
        products,
        len(chosen),
        owner,
        len(relative) + 1,
    )
    for scan, pose in enumerate(relative, start=1):
        back = np.linalg.inv(pose)
        sums[scan] = back @ sums[scan] @ back.T
    index = seeds[chosen]
    return Judges(
        points=_own_points(scene)[index],
        scan=owner[index] - 1,
        moments=sums,
        shell=shell,
        family=labels,
        families=counted,
        score_name=name,
    )


def fast_score(
    judges: Judges, poses: NDArray[np.float64], scene: Scene, settings: MomSettings
) -> float:
    """MOM in m^2 of the moving scans at ``poses`` (S, 4, 4), from the judges' moments."""
    relative = _relative(poses, scene.origin)
    total = judges.moments[0].copy()
    for pose, moments in zip(relative, judges.moments[1:], strict=True):
        total += pose @ moments @ pose.T
    everyone = np.concatenate([np.eye(4)[None], relative])
    total += judges.shell.moments(everyone, _queries(judges, relative), settings.radius)
    return _mean_over_families(judges, smallest_eigenvalues(covariances(total)))


def direct_score(
    judges: Judges, poses: NDArray[np.float64], scene: Scene, settings: MomSettings
) -> float:
    """The same value with the neighbourhoods searched again at ``poses``."""
    relative = _relative(poses, scene.origin)
    points, _ = _place(scene, relative)
    queries = _queries(judges, relative)
    pairs = find_pairs(points, queries, settings.radius)
    moments = sum_moments(pairs, outer_products(points), len(queries))[0]
    return _mean_over_families(judges, smallest_eigenvalues(covariances(moments)))


def _relative(poses: NDArray[np.float64], origin: NDArray[np.float64]) -> NDArray[np.float64]:
    moved = np.array(poses, dtype=np.float64)
    moved[:, :3, 3] -= origin
    return moved


def _place(
    scene: Scene, relative: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """All points (N, 3) relative to the origin, and whose they are: 0 fixed, 1.. moving."""
    clouds = [
        transform_points(pose, cloud) for pose, cloud in zip(relative, scene.moving, strict=True)
    ]
    points = np.vstack([scene.fixed - scene.origin, *clouds])
    sizes = [len(scene.fixed), *(len(cloud) for cloud in clouds)]
    return points, np.repeat(np.arange(len(sizes)), sizes)


def _own_points(scene: Scene) -> NDArray[np.float64]:
    """All points in the frame that moves them; the fixed ones relative to the origin."""
    return np.vstack([scene.fixed - scene.origin, *scene.moving])


def _shell(
    scene: Scene,
    owner: NDArray[np.int64],
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
) -> Shell:
    order = np.argsort(owner[columns], kind='stable')
    rows, columns = rows[order], columns[order]
    starts = np.searchsorted(owner[columns], np.arange(len(scene.moving) + 2))
    return Shell(rows=rows, points=_own_points(scene)[columns], starts=starts)


def _queries(judges: Judges, relative: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where the judging points are, (P, 3) relative to the origin."""
    poses = relative[judges.scan]
    turned: NDArray[np.float64] = np.einsum('pij,pj->pi', poses[:, :3, :3], judges.points)
    return turned + poses[:, :3, 3]


def _count_families(
    labels: NDArray[np.int64], settings: MomSettings
) -> tuple[NDArray[np.int64], tuple[int, ...], str]:
    counted = tuple(
        family for family in range(3) if int((labels == family).sum()) >= settings.min_family_points
    )
    if counted:
        return labels, counted, f'mom_{len(counted)}'
    return np.zeros(len(labels), dtype=np.int64), (0,), PLANE_VARIANCE


def _thin_families(
    chosen: NDArray[np.int64],
    labels: NDArray[np.int64],
    counted: tuple[int, ...],
    max_points: int,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """At most ``max_points`` judges, shared evenly between the families."""
    share = max(max_points // len(counted), 1)
    picks = []
    for family in counted:
        members = np.flatnonzero(labels == family)
        picks.append(members[spread_positions(len(members), share)])
    pick = np.concatenate(picks)
    return chosen[pick], labels[pick]


def _mean_over_families(judges: Judges, variances: NDArray[np.float64]) -> float:
    """Paper, equation for E_MOM: the mean over families of their mean plane variance."""
    means = [float(variances[judges.family == family].mean()) for family in judges.families]
    return float(np.mean(means))
