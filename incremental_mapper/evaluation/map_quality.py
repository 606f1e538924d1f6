"""How good a map is beside the base map of the same drive.

Two numbers: how far its points are from the base map, and how thick its planes are. Both maps
may be georeferenced a little differently, so the map is first moved by the rigid transform that
brings its trajectory onto the base trajectory.

What was found lies beside the map, and is not computed again while the maps are the same.
"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from incremental_mapper.config import MomSettings
from incremental_mapper.evaluation import cache
from incremental_mapper.geometry import transform_points
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.scoring.eigen import smallest_eigen
from incremental_mapper.scoring.moments import COUNT, covariances
from incremental_mapper.scoring.neighbourhoods import moments_around
from incremental_mapper.scoring.plane_families import spread_positions
from incremental_mapper.trajectory import Trajectory

QUALITY_FILE = 'map_quality.json'
PLACES = 4000
"""Places of the base map at which planes are looked at; more do not change the mean."""


@dataclass(frozen=True, slots=True)
class MapQuality:
    """Mean distance (m) of a map's points to the base map's nearest one, and mean plane variance.

    ``plane_variance_m2`` is the mean smallest eigenvalue (m^2) of the covariances of the map's
    points around the planar places of the base map: the same places judge every strategy.
    None where nothing could be compared.
    """

    map_distance_m: float | None
    plane_variance_m2: float | None


@dataclass(frozen=True, slots=True)
class QualityJob:
    """The folder of a finished run, and that of the base run of the same sequence, if any."""

    folder: Path
    base: Path | None


@dataclass(frozen=True, slots=True, eq=False)
class PlacedMap:
    """Map points (N, 3) and the trajectory that they were placed by, in one frame."""

    points: NDArray[np.float64]
    trajectory: Trajectory


def stored_quality(job: QualityJob) -> MapQuality | None:
    """What an earlier call found; None where the maps or the comparison have changed since."""
    try:
        stored = json.loads((job.folder / QUALITY_FILE).read_text(encoding='utf-8'))
        return MapQuality(**stored['quality']) if stored['key'] == _key(job) else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def run_quality_job(job: QualityJob) -> MapQuality:
    """Compare the maps and store what was found.

    Raises:
        MapperError: A file of one of the runs cannot be read.
    """
    settings = MomSettings.model_validate(FinishedRun(job.folder).stats['settings']['mom'])
    own = read_map(job.folder)
    base = None if job.base is None else own if job.base == job.folder else read_map(job.base)
    quality = compare_maps(own, base, settings)
    stored = {'key': _key(job), 'quality': asdict(quality)}
    cache.write_json(job.folder / QUALITY_FILE, stored)
    return quality


def read_map(folder: Path) -> PlacedMap:
    """The map of a finished run; raises InputError where it cannot be read."""
    run = FinishedRun(folder)
    return PlacedMap(run.points, run.trajectory)


def compare_maps(own: PlacedMap, base: PlacedMap | None, settings: MomSettings) -> MapQuality:
    """Compare a map with the base map.

    Args:
        own: The map to be judged.
        base: The base map; without it there is no distance, and the map's own planes are
            looked at.
        settings: Radius (m), planarity and least number of neighbours are those of MOM.
    """
    points, distance = own.points, None
    reference = own if base is None else base
    if len(points) == 0 or len(reference.points) == 0:
        return MapQuality(None, None)
    if base is not None:
        points = transform_points(fit_poses(own.trajectory, base.trajectory), points)
        distance = float(KDTree(base.points).query(points, workers=-1)[0].mean())
    places = planar_places(reference.points, settings)
    return MapQuality(distance, plane_variance(points, places, settings))


def planar_places(points: NDArray[np.float64], settings: MomSettings) -> NDArray[np.float64]:
    """Points (P, 3) of a map (N, 3) whose neighbourhoods are planar."""
    places = points[spread_positions(len(points), PLACES)]
    counts, spread = _neighbourhoods(points, places, settings.radius)
    found = smallest_eigen(spread)
    planar = (counts >= settings.min_neighbours) & (
        found.middle > settings.eigenvalue_ratio * found.values
    )
    chosen: NDArray[np.float64] = places[planar]
    return chosen


def plane_variance(
    points: NDArray[np.float64], places: NDArray[np.float64], settings: MomSettings
) -> float | None:
    """Mean smallest eigenvalue (m^2) of the neighbourhoods of ``places`` (P, 3) in ``points``.

    Places with too few neighbours are left out; None where there is no other.
    """
    if len(places) == 0:
        return None
    counts, spread = _neighbourhoods(points, places, settings.radius)
    enough = counts >= settings.min_neighbours
    return float(smallest_eigen(spread[:, enough]).values.mean()) if enough.any() else None


def fit_poses(estimate: Trajectory, target: Trajectory) -> NDArray[np.float64]:
    """The rigid transform T_target_estimate (4, 4) between the frames of two trajectories.

    The mean over all poses, orientation included, so that it is determined for a standing car
    too, whose positions leave the rotation open. The identity where they share no time.
    """
    transform = np.eye(4)
    stamps = estimate.stamps[target.covers(estimate.stamps)]
    if len(stamps) == 0:
        return transform
    own, other = estimate.interpolate(stamps), target.interpolate(stamps)
    turn: Rotation = (other.rotations() * own.rotations().inv()).mean()
    transform[:3, :3] = turn.as_matrix()
    transform[:3, 3] = (other.positions - turn.apply(own.positions)).mean(axis=0)
    return transform


def _neighbourhoods(
    points: NDArray[np.float64], places: NDArray[np.float64], radius: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Numbers of neighbours (P,) and covariances (6, P) of ``places``."""
    moments = moments_around(points, places, radius)
    return moments[COUNT], covariances(moments)


def _key(job: QualityJob) -> str:
    # The mark is written anew by every run, so its time tells of a run that was forced.
    marks = [folder and folder / cache.MARK for folder in (job.folder, job.base)]
    code = cache.code_fingerprint(Path(__file__).parent, [Path(__file__)])
    return cache.digest([*map(cache.file_fingerprint, marks), code])
