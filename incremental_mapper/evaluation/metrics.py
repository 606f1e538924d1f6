"""The numbers of a finished run that the table shows, read from its output folder.

They have the names of ``stats.json``, and are None where a run has no such number.
"""

from collections.abc import Mapping
from typing import TypeAlias

from incremental_mapper.results.run_folder import FinishedRun

Metrics: TypeAlias = dict[str, float | int | None]

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


def drive_metrics(run: FinishedRun, quality: Mapping[str, float | None]) -> Metrics:
    """The numbers of a whole drive; ``quality`` holds those of its map."""
    return {name: run.stats.get(name) for name in OF_STATISTICS} | {
        name: quality.get(name) for name in OF_MAPS
    }
