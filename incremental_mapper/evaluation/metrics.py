"""The numbers of a finished run that the table shows, of a whole drive or of its pieces by motion.

They have the names of ``stats.json``, and are None where a run has no such number.

Of a drive cut by motion, clusters and variables belong to the piece that their stamp lies in, a
factor to that of its newest variable, a window to that of its middle, and a pair of poses to the
piece that both lie in. The ATE is taken after the fit of the whole drive. The number of components,
the quality of the map and findings are those of whole drives only.
"""

from collections.abc import Iterable, Mapping
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Severity
from incremental_mapper.evaluation.segments import Motion, Segment, segment_indices
from incremental_mapper.geometry import transform_points
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.results.trajectory_errors import (
    consecutive_pairs,
    pairs_apart,
    relative_pose_errors,
)
from incremental_mapper.trajectory import Trajectory, fit_rigid, match_truth

Metrics: TypeAlias = dict[str, float | int | None]
Segments: TypeAlias = tuple[Segment, ...]

OF_STATISTICS = (
    'total_time_shift_s',
    'solver_error',
    'rpe_translation_rmse_m',
    'rpe_rotation_rmse_deg',
    'clusters',
    'vertices',
    'factors',
    'compression_vertices_percent',
    'compression_factors_percent',
    'components',
    'rpe_per_second_translation_rmse_m',
    'rpe_per_second_rotation_rmse_deg',
    'ate_rmse_m',
    'window_median_s',
    'real_time_factor',
    'drive_s',
    'wall_s',
    'windows',
)
OF_MAPS = ('map_distance_m', 'plane_variance_m2')
FINDINGS = 'findings'
"""Name of the number of findings that were not mended, errors among them."""


def drive_metrics(run: FinishedRun, quality: Mapping[str, float | None]) -> Metrics:
    """The numbers of a whole drive.

    Args:
        run: A finished run.
        quality: The numbers of its map, by the names of ``OF_MAPS``; those that are missing
            become None.

    Raises:
        InputError: The run's ``stats.json`` cannot be read.
    """
    return {
        **{name: run.stats.get(name) for name in OF_STATISTICS},
        **{name: quality.get(name) for name in OF_MAPS},
        FINDINGS: len(unmended(run)),
    }


def unmended(run: FinishedRun) -> list[Mapping[str, str]]:
    """What was found wrong with a run and was not put right, the worst first.

    Args:
        run: A finished run.

    Returns:
        Findings as ``stats.json`` has them; a run of an earlier version has none.

    Raises:
        InputError: The run's ``stats.json`` cannot be read.
    """
    return [item for item in run.stats.get('warnings', ()) if item['severity'] != Severity.MENDED]


def motion_metrics(
    run: FinishedRun, base: FinishedRun | None, segments: Segments, truth: Trajectory | None
) -> dict[Motion, Metrics]:
    """The numbers of all pieces of each motion together, for the motions that occur.

    Args:
        run: A finished run.
        base: The run of the strategy ``base`` on the same drive; without it there is no
            compression, which is taken against its variables and factors in the same pieces.
        segments: The drive cut by motion, as ``segment_by_motion`` gives it.
        truth: The true trajectory; without it there are no errors.

    Raises:
        InputError: A file of a run cannot be read.
    """
    counts = _counts(run, segments)
    base_counts = None if base is None else _counts(base, segments)
    pair_errors = {} if truth is None else _pair_errors(run.trajectory, truth, segments)
    found = {}
    for motion in Motion:
        pieces = [index for index, segment in enumerate(segments) if segment.motion is motion]
        if not pieces:
            continue
        metrics: Metrics = dict.fromkeys((*OF_STATISTICS, *OF_MAPS, FINDINGS))
        metrics |= {name: int(column[pieces].sum()) for name, column in counts.items()}
        if base_counts is not None:
            for name in ('vertices', 'factors'):
                own, other = counts[name][pieces].sum(), base_counts[name][pieces].sum()
                metrics[f'compression_{name}_percent'] = (
                    float(100.0 * (1.0 - own / other)) if other else None
                )
        metrics |= _window_metrics(run, segments, pieces)
        for name, (errors, places) in pair_errors.items():
            chosen = errors[np.isin(places, pieces)]
            metrics[name] = float(np.sqrt(np.mean(chosen**2))) if len(chosen) else None
        found[motion] = metrics
    return found


def _counts(run: FinishedRun, segments: Segments) -> dict[str, NDArray[np.int64]]:
    """Clusters, vertices and factors of every segment, (S,) each."""
    graph = run.graph
    stamps = {variable['key']: variable['stamp_ns'] for variable in graph['variables']}
    newest = (max(stamps[key] for key in factor['variables']) for factor in graph['factors'])
    return {
        'clusters': _occurrences((item['stamp_ns'] for item in graph['clusters']), segments),
        'vertices': _occurrences(stamps.values(), segments),
        'factors': _occurrences(newest, segments),
    }


def _occurrences(stamps: Iterable[int], segments: Segments) -> NDArray[np.int64]:
    indices = segment_indices(np.fromiter(stamps, dtype=np.int64), segments)
    return np.bincount(indices[indices >= 0], minlength=len(segments))


def _window_metrics(run: FinishedRun, segments: Segments, pieces: list[int]) -> Metrics:
    rows = run.windows
    starts = np.array([int(row['start_ns']) for row in rows], dtype=np.int64)
    ends = np.array([int(row['end_ns']) for row in rows], dtype=np.int64)
    inside = np.isin(segment_indices(starts + (ends - starts) // 2, segments), pieces)
    chosen = [row for row, taken in zip(rows, inside.tolist(), strict=True) if taken]
    seconds = [float(row['window_s']) for row in chosen if int(row['core'])]
    driven = float((ends - starts)[inside].sum() / NANOSECONDS)
    return {
        'windows': len(chosen),
        'total_time_shift_s': sum(float(row['time_shift_s']) for row in chosen),
        'solver_error': sum(float(row['solver_error']) for row in chosen),
        'window_median_s': float(np.median(seconds)) if seconds else None,
        'real_time_factor': driven / sum(seconds) if seconds else None,
        'drive_s': driven,
        'wall_s': sum(seconds),
    }


def _pair_errors(
    estimate: Trajectory, truth: Trajectory, segments: Segments
) -> dict[str, tuple[NDArray[np.float64], NDArray[np.int64]]]:
    """Errors by the name of their mean, with the segment of each; -1 where it is none's."""
    covered, reference = match_truth(estimate, truth)
    if len(covered) < 2:
        return {}
    places = segment_indices(covered.stamps, segments)
    found = {}
    steps = consecutive_pairs(covered.stamps)
    seconds = pairs_apart(covered.stamps, NANOSECONDS)
    for name, pairs in (('rpe', steps), ('rpe_per_second', seconds)):
        metres, degrees = relative_pose_errors(covered, reference, pairs)
        first, last = places[pairs[:, 0]], places[pairs[:, 1]]
        within = np.where(first == last, first, -1)
        found[f'{name}_translation_rmse_m'] = (metres, within)
        found[f'{name}_rotation_rmse_deg'] = (degrees, within)
    fitted = transform_points(fit_rigid(covered.positions, reference.positions), covered.positions)
    found['ate_rmse_m'] = (np.linalg.norm(fitted - reference.positions, axis=1), places)
    return found
