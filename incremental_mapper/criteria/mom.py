"""The Mutually Orthogonal Metric of a window's candidates (paper, section Evaluation Metric).

The judging points and their neighbourhoods are found once per window, at the predicted poses.
Each scan's part of a neighbourhood is kept as its homogeneous moment Σ p̃ p̃ᵀ in the scan's own
frame; under a pose T it becomes T M Tᵀ, so a candidate's covariances follow from the moments and
its poses alone. ``direct_score`` searches the neighbourhoods again instead.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from incremental_mapper.config import MomSettings
from incremental_mapper.criteria.planes import (
    covariances,
    orthogonal_families,
    smallest_eigenvalues,
    spread_positions,
)
from incremental_mapper.geometry import transform_points

NO_SCORE = 'none'
PLANE_VARIANCE = 'plane_variance'


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """What a window's candidates are judged on.

    ``fixed`` are points (F, 3) of recent scans, already placed in the map. ``moving`` are the
    scans (N_s, 3) in base_link whose poses differ between candidates, and ``predicted`` their
    poses T_map_base (S, 4, 4); the first ``fresh`` of them are the window's new scans. ``origin``
    (3,) is a place near the car: numbers relative to it keep the moments exact.
    """

    fixed: NDArray[np.float64]
    moving: Sequence[NDArray[np.float64]]
    predicted: NDArray[np.float64]
    fresh: int
    origin: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Judges:
    """Judging points of one window.

    ``points`` (P, 3) are in their scan's frame, ``scan`` (P,) is its position in
    ``Scene.moving``; ``fixed_moments`` (P, 4, 4) are relative to the origin and
    ``moments`` (S, P, 4, 4) in each scan's frame; ``family`` (P,) is 0, 1, 2 or -1.
    """

    points: NDArray[np.float64]
    scan: NDArray[np.int64]
    fixed_moments: NDArray[np.float64]
    moments: NDArray[np.float64]
    family: NDArray[np.int64]
    families: tuple[int, ...]
    score_name: str


def choose_judges(scene: Scene, settings: MomSettings) -> Judges:
    """Find planar neighbourhoods that a new scan shares with another one, and their families."""
    relative = _relative(scene.predicted, scene.origin)
    clouds = [
        transform_points(pose, cloud) for pose, cloud in zip(relative, scene.moving, strict=True)
    ]
    everything = np.vstack([scene.fixed - scene.origin, *clouds])
    sizes = [len(scene.fixed), *(len(cloud) for cloud in clouds)]
    owner = np.repeat(np.arange(len(sizes)), sizes)
    fresh = np.flatnonzero((owner >= 1) & (owner <= scene.fresh))
    # Half as many again as are wanted: not every seed turns out to be planar.
    seeds = fresh[spread_positions(len(fresh), settings.max_points * 3 // 2)]
    if len(seeds) == 0 or len(everything) == 0:
        return _no_judges(len(clouds))
    moments = _moments(everything, everything[seeds], settings.radius, owner, len(sizes))
    counts = moments[:, :, 3, 3]
    shared = (counts > 0).sum(axis=0) > 1  # one scan alone has the same planes at any pose
    total = counts.sum(axis=0)
    spread = covariances(moments.sum(axis=0))
    values, vectors = np.linalg.eigh(spread)
    planar = (
        shared
        & (total >= settings.min_neighbours)
        & (values[:, 1] > settings.eigenvalue_ratio * np.maximum(values[:, 0], 0.0))
    )
    chosen = np.flatnonzero(planar)
    families = orthogonal_families(vectors[chosen, :, 0], settings.max_angle)
    labels, counted, name = _count_families(families.labels, settings)
    chosen, labels = _thin_families(chosen, labels, counted, settings.max_points)
    owners = owner[seeds[chosen]] - 1
    back = [np.linalg.inv(pose) for pose in relative]
    own = np.stack(
        [inverse @ moments[scan + 1][chosen] @ inverse.T for scan, inverse in enumerate(back)]
    )
    homogeneous = np.append(everything[seeds[chosen]], np.ones((len(chosen), 1)), axis=1)
    own_points = np.einsum('pij,pj->pi', np.array(back)[owners], homogeneous)[:, :3]
    return Judges(
        points=own_points,
        scan=owners,
        fixed_moments=moments[0][chosen],
        moments=own,
        family=labels,
        families=counted,
        score_name=name,
    )


def fast_score(
    judges: Judges, poses: NDArray[np.float64], origin: NDArray[np.float64]
) -> float | None:
    """MOM in m^2 of the moving scans at ``poses`` (S, 4, 4); None where there is no judge."""
    if len(judges.points) == 0:
        return None
    total = judges.fixed_moments.copy()
    for pose, moments in zip(_relative(poses, origin), judges.moments, strict=True):
        total += pose @ moments @ pose.T
    return _mean_over_families(judges, smallest_eigenvalues(covariances(total)))


def direct_score(
    judges: Judges, poses: NDArray[np.float64], scene: Scene, settings: MomSettings
) -> float | None:
    """The same value with the neighbourhoods searched again at ``poses``."""
    if len(judges.points) == 0:
        return None
    relative = _relative(poses, scene.origin)
    clouds = [
        transform_points(pose, cloud) for pose, cloud in zip(relative, scene.moving, strict=True)
    ]
    everything = np.vstack([scene.fixed - scene.origin, *clouds])
    homogeneous = np.append(judges.points, np.ones((len(judges.points), 1)), axis=1)
    queries = np.einsum('pij,pj->pi', relative[judges.scan], homogeneous)[:, :3]
    nobody = np.zeros(len(everything), dtype=np.int64)
    moments = _moments(everything, queries, settings.radius, nobody, 1)[0]
    return _mean_over_families(judges, smallest_eigenvalues(covariances(moments)))


def _relative(poses: NDArray[np.float64], origin: NDArray[np.float64]) -> NDArray[np.float64]:
    moved = np.array(poses, dtype=np.float64)
    moved[:, :3, 3] -= origin
    return moved


def _moments(
    points: NDArray[np.float64],
    queries: NDArray[np.float64],
    radius: float,
    owner: NDArray[np.int64],
    owners: int,
) -> NDArray[np.float64]:
    """Homogeneous moments (owners, Q, 4, 4) of each owner's points within ``radius`` of queries."""
    # An unbalanced tree is built in half the time and is asked only once.
    tree = KDTree(points, leafsize=24, balanced_tree=False, compact_nodes=False)
    lists = tree.query_ball_point(queries, radius, return_sorted=False)
    lengths = np.fromiter((len(found) for found in lists), dtype=np.int64, count=len(lists))
    columns = np.fromiter(chain.from_iterable(lists), dtype=np.int64, count=int(lengths.sum()))
    rows = owner[columns] * len(queries) + np.repeat(np.arange(len(queries)), lengths)
    pairs = csr_array(
        (np.ones(len(columns)), (rows, columns)), shape=(owners * len(queries), len(points))
    )
    tilde = np.append(points, np.ones((len(points), 1)), axis=1)
    upper = np.triu_indices(4)
    sums = np.asarray(pairs @ (tilde[:, upper[0]] * tilde[:, upper[1]]))
    moments = np.empty((owners, len(queries), 4, 4))
    moments[:, :, upper[0], upper[1]] = sums.reshape(owners, len(queries), -1)
    moments[:, :, upper[1], upper[0]] = moments[:, :, upper[0], upper[1]]
    return moments


def _count_families(
    labels: NDArray[np.int64], settings: MomSettings
) -> tuple[NDArray[np.int64], tuple[int, ...], str]:
    counted = tuple(
        family for family in range(3) if int((labels == family).sum()) >= settings.min_family_points
    )
    if counted:
        return labels, counted, f'mom_{len(counted)}'
    name = PLANE_VARIANCE if len(labels) else NO_SCORE
    return np.zeros(len(labels), dtype=np.int64), (0,), name


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


def _no_judges(scans: int) -> Judges:
    return Judges(
        points=np.zeros((0, 3)),
        scan=np.zeros(0, dtype=np.int64),
        fixed_moments=np.zeros((0, 4, 4)),
        moments=np.zeros((scans, 0, 4, 4)),
        family=np.zeros(0, dtype=np.int64),
        families=(0,),
        score_name=NO_SCORE,
    )
