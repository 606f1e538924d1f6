"""Mapping a whole input offline: the same mapper as online, as fast as it goes."""

import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass
from importlib import metadata
from types import FrameType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from incremental_mapper import __version__
from incremental_mapper.config import Config, make_config, merge
from incremental_mapper.datasets.source import Source
from incremental_mapper.errors import InputError
from incremental_mapper.map.cloud import accumulate
from incremental_mapper.mapping.load_shedding import AHEAD
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.mapping.result import MapResult, WindowResult
from incremental_mapper.mapping.statistics import peak_rss_mb
from incremental_mapper.measurements import Drops
from incremental_mapper.results.trajectory_errors import TrajectoryErrors, trajectory_errors
from incremental_mapper.trajectory import Trajectory

LIBRARIES = ('gtsam', 'kiss-icp', 'small_gicp', 'rosbags', 'numpy', 'scipy', 'pymap3d')


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """A mapped input: the result, the map's points (N, 3), and all keys of stats.json."""

    result: MapResult
    points: NDArray[np.float32]
    errors: TrajectoryErrors | None
    stats: dict[str, Any]
    interrupted: bool


class Stop:
    """Turns the first Ctrl-C into a wish to stop; a second one interrupts as usual."""

    def __init__(self) -> None:
        self.wanted = False

    @contextmanager
    def listening(self) -> Iterator['Stop']:
        """Listen to SIGINT while the block runs; off the main thread this does nothing."""
        try:
            before = signal.signal(signal.SIGINT, self._on_signal)
        except ValueError:
            yield self
            return
        try:
            yield self
        finally:
            signal.signal(signal.SIGINT, before)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if self.wanted:
            raise KeyboardInterrupt
        self.wanted = True


def settle_config(source: Source, tree: Mapping[str, Any], where: str) -> Config:
    """The settings of a run: the user's laid over those that the input brings itself."""
    return make_config(merge(source.info.settings, tree), where)


def map_source(
    source: Source,
    config: Config,
    truth: Trajectory | None = None,
    progress: Callable[[int], object] | None = None,
    stop: Stop | None = None,
    observe: Callable[[WindowResult], object] | None = None,
) -> Run:
    """Map an input from end to end.

    ``progress`` is called with the number of measurements read since the last call; ``stop``
    ends the run early, keeping what was mapped; ``observe`` is called with each window. Raises
    InputError where nothing could be used.
    """

    def tell(windows: Iterable[WindowResult]) -> None:
        for window in windows:
            if observe is not None:
                observe(window)

    started = time.perf_counter()
    mapper = Mapper(config, [name for name, count in source.info.counts.items() if count])
    interrupted = False
    with closing(mapper):
        for measurement in source.measurements():
            tell(mapper.advance(measurement, AHEAD))
            if progress is not None:
                progress(1)
            if stop is not None and stop.wanted:
                interrupted = True
                break
        tell(mapper.flush())
        result = mapper.result()
    if not result.clusters and interrupted:
        raise KeyboardInterrupt
    if not result.clusters:
        reasons = ', '.join(
            f'{count} of {sensor} ({reason})'
            for (sensor, reason), count in sorted(source.drops.items())
        )
        raise InputError(
            f'{source.info.path}: no scan and no fix could be used'
            + (f'; left out: {reasons}' if reasons else '; is it the right input?')
        )
    points = map_points(result, config)
    errors = None if truth is None else trajectory_errors(result.trajectory, truth)
    stats = complete_stats(result, source.drops, time.perf_counter() - started)
    stats.update(
        {
            'interrupted': interrupted,
            'map_points': len(points),
            **({} if errors is None else asdict(errors)),
            'input': {
                'path': str(source.info.path),
                'kind': source.info.kind,
                'counts': source.info.counts,
                'notes': list(source.info.notes),
            },
        }
    )
    return Run(result, points, errors, stats, interrupted)


def complete_stats(result: MapResult, drops: Drops, wall: float) -> dict[str, Any]:
    """The keys of stats.json that every run has.

    ``drops`` is what was lost before it reached the mapper, ``wall`` the seconds that passed.
    """
    stats = dict(result.stats)
    dropped = {sensor: dict(reasons) for sensor, reasons in stats['dropped'].items()}
    for (sensor, reason), count in drops.items():
        reasons = dropped.setdefault(sensor, {})
        reasons[reason] = reasons.get(reason, 0) + count
    return stats | {
        'dropped': dropped,
        'wall_s': wall,
        'real_time_factor': stats['drive_s'] / wall,
        'peak_rss_mb': peak_rss_mb(),
        **_window_seconds(result),
        'versions': versions(),
    }


def map_points(result: MapResult, config: Config) -> NDArray[np.float32]:
    """The map (N, 3) of a result, from the newest poses of its clusters."""
    return accumulate(result.placed_scans(), config.map.voxel_size, config.map.max_range)


def versions() -> dict[str, str]:
    """Versions of this package and of what its numbers depend on."""
    found = {'incremental_mapper': __version__, 'python': sys.version.split()[0]}
    for name in LIBRARIES:
        found[name] = metadata.version(name)
    return found


def _window_seconds(result: MapResult) -> dict[str, float]:
    """Seconds a window: median, worst, and the means of the first and the last tenth."""
    seconds = np.array([row['window_s'] for row in result.rows if row['core']])
    if len(seconds) == 0:
        return {}
    tenth = max(len(seconds) // 10, 1)
    return {
        'window_median_s': float(np.median(seconds)),
        'window_p99_s': float(np.percentile(seconds, 99)),
        'window_first_tenth_s': float(seconds[:tenth].mean()),
        'window_last_tenth_s': float(seconds[-tenth:].mean()),
    }
