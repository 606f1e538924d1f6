"""incremental_mapper: the factor graph that makes the best local map, window by window.

Everything that a program needs is imported from here; the rooms behind it are private. Names are
loaded when they are first asked for, so that ``import incremental_mapper`` costs nothing.

    from incremental_mapper import map_drive
    run = map_drive('urban26', out='map', config='config/kaist.yaml')
    print(run.statistics.mapped.compression_vertices_percent, run.statistics.errors)
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from incremental_mapper.candidates.model import Candidate, Cluster, Connection, CoreMeasurement
    from incremental_mapper.config import Config
    from incremental_mapper.datasets.open import open_source
    from incremental_mapper.datasets.source import Source
    from incremental_mapper.errors import (
        ConfigError,
        InputError,
        MapperError,
        MeasurementError,
        OutputError,
    )
    from incremental_mapper.exports.exported_run import ExportedRun, place_of
    from incremental_mapper.exports.formats import Content, Format
    from incremental_mapper.exports.place import Place
    from incremental_mapper.mapping.load_shedding import LoadShedding
    from incremental_mapper.mapping.mapper import Mapper
    from incremental_mapper.mapping.newest_state import NewestState
    from incremental_mapper.mapping.result import MapResult, WindowResult
    from incremental_mapper.measurements import (
        FixStatus,
        GnssFix,
        ImuSample,
        LidarScan,
        make_fix,
        make_imu,
        make_scan,
    )
    from incremental_mapper.results.finished_run import FinishedRun
    from incremental_mapper.results.offline_run import Run, map_drive, map_source
    from incremental_mapper.results.trajectory_errors import TrajectoryErrors, trajectory_errors
    from incremental_mapper.scoring.criteria import Criterion, Proposal
    from incremental_mapper.selection.choice import Choice, Tried
    from incremental_mapper.selection.lowest_score import LowestScore
    from incremental_mapper.selection.strategies import Strategy, find_strategy, strategy_names
    from incremental_mapper.selection.window_problem import WindowProblem
    from incremental_mapper.selection.window_record import load_window, reselect_window
    from incremental_mapper.settings import load_config
    from incremental_mapper.trajectory import Trajectory, read_tum, write_tum

__version__ = '0.1.0'

_ROOMS = {
    'candidates.model': ('Candidate', 'Cluster', 'Connection', 'CoreMeasurement'),
    'config': ('Config',),
    'datasets.open': ('open_source',),
    'datasets.source': ('Source',),
    'errors': ('ConfigError', 'InputError', 'MapperError', 'MeasurementError', 'OutputError'),
    'exports.exported_run': ('ExportedRun', 'place_of'),
    'exports.formats': ('Content', 'Format'),
    'exports.place': ('Place',),
    'mapping.load_shedding': ('LoadShedding',),
    'mapping.mapper': ('Mapper',),
    'mapping.newest_state': ('NewestState',),
    'mapping.result': ('MapResult', 'WindowResult'),
    'measurements': (
        'FixStatus',
        'GnssFix',
        'ImuSample',
        'LidarScan',
        'make_fix',
        'make_imu',
        'make_scan',
    ),
    'results.offline_run': ('Run', 'map_drive', 'map_source'),
    'results.finished_run': ('FinishedRun',),
    'results.trajectory_errors': ('TrajectoryErrors', 'trajectory_errors'),
    'scoring.criteria': ('Criterion', 'Proposal'),
    'selection.choice': ('Choice', 'Tried'),
    'selection.lowest_score': ('LowestScore',),
    'selection.strategies': ('Strategy', 'find_strategy', 'strategy_names'),
    'selection.window_problem': ('WindowProblem',),
    'selection.window_record': ('load_window', 'reselect_window'),
    'settings': ('load_config',),
    'trajectory': ('Trajectory', 'read_tum', 'write_tum'),
}
_HOME = {name: room for room, names in _ROOMS.items() for name in names}

__all__ = [
    'Candidate',
    'Choice',
    'Cluster',
    'Config',
    'ConfigError',
    'Connection',
    'Content',
    'CoreMeasurement',
    'Criterion',
    'ExportedRun',
    'FinishedRun',
    'FixStatus',
    'Format',
    'GnssFix',
    'ImuSample',
    'InputError',
    'LidarScan',
    'LoadShedding',
    'LowestScore',
    'MapResult',
    'Mapper',
    'MapperError',
    'MeasurementError',
    'NewestState',
    'OutputError',
    'Place',
    'Proposal',
    'Run',
    'Source',
    'Strategy',
    'Trajectory',
    'TrajectoryErrors',
    'Tried',
    'WindowProblem',
    'WindowResult',
    '__version__',
    'find_strategy',
    'load_config',
    'load_window',
    'make_fix',
    'make_imu',
    'make_scan',
    'map_drive',
    'map_source',
    'open_source',
    'place_of',
    'read_tum',
    'reselect_window',
    'strategy_names',
    'trajectory_errors',
    'write_tum',
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    found = getattr(import_module(f'{__name__}.{_HOME[name]}'), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted(__all__)
