"""Finished runs as one map: which can be related, in which frame, and what is written of all."""

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from incremental_mapper.checks.finding import Severity
from incremental_mapper.checks.fixes import TOO_FAR
from incremental_mapper.config import Config
from incremental_mapper.errors import ConfigError, InputError
from incremental_mapper.frontend.gnss import Datum
from incremental_mapper.graph.factors import Factor
from incremental_mapper.map.ply import MapCloud
from incremental_mapper.map.store import make_store
from incremental_mapper.mapping.result import MapResult
from incremental_mapper.measurements import Drops
from incremental_mapper.results.run_folder import FinishedRun
from incremental_mapper.results.run_statistics import InputFacts, RunStatistics
from incremental_mapper.results.sessions.joining import alone, between_datums, joined, turned
from incremental_mapper.results.sessions.saved_run import SavedRun, read_saved_run
from incremental_mapper.settings import make_config

KIND = 'finished runs'
"""What the input of a joint map is called."""


@dataclass(frozen=True, slots=True, eq=False)
class Fleet:
    """Finished runs that can be related, each turned into the frame of the first one.

    Attributes:
        runs: They, as their folders have them.
        parts: Their graphs in the common frame.
        datum: Origin of that frame.
        config: The settings of the first run.
    """

    runs: tuple[SavedRun, ...]
    parts: tuple[MapResult, ...]
    datum: Datum
    config: Config


@dataclass(frozen=True, slots=True, eq=False)
class Merged:
    """The joint map and its record."""

    result: MapResult
    map: MapCloud
    statistics: RunStatistics


def read_fleet(folders: Sequence[Path]) -> Fleet:
    """Read finished runs, and bring them into one frame.

    Args:
        folders: Their folders.

    Returns:
        The runs.

    Raises:
        ConfigError: There are fewer than two, or one is named twice.
        InputError: One cannot be read, or cannot be related to the others.
    """
    paths = [folder.resolve() for folder in folders]
    doubled = [path for path, count in Counter(paths).items() if count > 1]
    if doubled:
        raise ConfigError(f'{doubled[0]}: is named twice; a run enters a joint map once')
    if len(paths) < 2:
        raise ConfigError(f'{paths[0]}: is the only run; name two or more')
    for path in paths:
        FinishedRun(path).check()
    settings = FinishedRun(paths[0]).stats['settings']
    config = make_config(settings, str(paths[0]))
    store = make_store(config.map)
    runs = [read_saved_run(path, store) for path in paths]
    first = _datum(runs[0])
    parts: list[MapResult] = []
    for run in runs:
        T_first_run = between_datums(first, _datum(run))
        _require_near(run, runs[0], T_first_run.translation())
        parts.append(alone(turned(run.result, T_first_run, config), str(run.folder)))
    return Fleet(tuple(runs), tuple(parts), first, config)


def merge(
    fleet: Fleet,
    ties: Sequence[Factor] = (),
    stage: Callable[[str], object] = lambda _: None,
) -> Merged:
    """The joint map of runs: one graph, one solve, one cloud.

    Args:
        fleet: The runs.
        ties: Factors between their poses, see ``joining.joined``.
        stage: Called with what comes next.

    Returns:
        The map.
    """
    started = time.perf_counter()
    stage('solve')
    result = joined(fleet.parts, fleet.config, ties=ties)
    # Those are the files of their folders.
    result = replace(result, failed=())
    stage('map')
    cloud = result.cloud(fleet.config.map)
    counts: Counter[str] = Counter()
    for run in fleet.runs:
        counts.update(run.counts)
    notes = [f'joins {run.folder}' for run in fleet.runs]
    if _overlap(fleet.runs):
        notes.append('runs overlap in time: trajectory.tum has the poses of several by turns')
    facts = InputFacts(', '.join(str(run.folder) for run in fleet.runs), KIND, counts, tuple(notes))
    wall = time.perf_counter() - started
    return Merged(result, cloud, RunStatistics.of_run(result, Drops(), wall, len(cloud), facts))


def _datum(run: SavedRun) -> Datum:
    """Where a run's map is on the earth; raises InputError where a joint map cannot tell."""
    statistics = run.result.statistics
    if run.datum is None:
        raise InputError(
            f'{run.folder}: cannot be related to the others: its map is not east-north-up, since '
            'no fixes told where it is'
        )
    if statistics.components != 1:
        raise InputError(
            f'{run.folder}: cannot be related to the others: its map is in '
            f'{statistics.components} pieces'
        )
    errors = [one for one in run.result.findings if one.severity is Severity.ERROR]
    if errors:
        raise InputError(
            f'{run.folder}: is not to be trusted ({errors[0].rule}: {errors[0].text}); leave it out'
        )
    return run.datum


def _require_near(run: SavedRun, first: SavedRun, origin: np.ndarray) -> None:
    far = float(np.hypot(*origin[:2]))
    if far > TOO_FAR:
        raise InputError(
            f'{run.folder}: is {far / 1000.0:.0f} km from {first.folder}; one flat frame reaches '
            f'{TOO_FAR / 1000.0:.0f} km'
        )


def _overlap(runs: Sequence[SavedRun]) -> bool:
    """Whether two runs were driven at the same time."""
    spans = sorted(
        (int(run.result.trajectory.stamps[0]), int(run.result.trajectory.stamps[-1]))
        for run in runs
    )
    return any(end >= begin for (_, end), (begin, _) in pairwise(spans))
