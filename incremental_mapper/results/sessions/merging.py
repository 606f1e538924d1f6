"""Finished runs as one map: which can be related, in which frame, and what is written of all."""

import json
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import accumulate, combinations, pairwise
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from incremental_mapper.checks.finding import Finding, Severity, ranked
from incremental_mapper.checks.fixes import TOO_FAR
from incremental_mapper.config import Config
from incremental_mapper.errors import ConfigError, InputError
from incremental_mapper.frontend.gnss import Datum
from incremental_mapper.graph.factors import Factor
from incremental_mapper.map.ply import MapCloud
from incremental_mapper.map.store import make_store
from incremental_mapper.mapping.result import MapResult
from incremental_mapper.measurements import Drops
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.results.run_statistics import InputFacts, RunStatistics
from incremental_mapper.results.sessions.joining import alone, between_datums, joined, turned
from incremental_mapper.results.sessions.same_fixes import measured_twice
from incremental_mapper.results.sessions.saved_run import SavedRun, read_saved_run
from incremental_mapper.results.sessions.ties import Ties, disagreement, find_ties, tie_factors
from incremental_mapper.settings import make_config, to_tree
from incremental_mapper.variables import pose_key

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


@dataclass(frozen=True, slots=True)
class Pair:
    """Two runs of a fleet that come near each other: all that a worker elsewhere needs.

    ``first`` and ``second`` are their places in the fleet, ``folders`` where they are, ``datum``
    the origin of the common frame, and ``settings`` those of all, as JSON.
    """

    first: int
    second: int
    folders: tuple[Path, Path]
    datum: Datum
    settings: str


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
    if same := measured_twice(parts):
        one, other, fixes = same
        raise InputError(
            f'{runs[other].folder}: is the same drive as {runs[one].folder} ({fixes} fixes have '
            'the same stamps and places); a drive enters a joint map once'
        )
    return Fleet(tuple(runs), tuple(parts), first, config)


def pairs_of(fleet: Fleet) -> list[Pair]:
    """The pairs of runs that may show the same places; none where closures are switched off.

    Args:
        fleet: The runs.
    """
    config = fleet.config
    if not config.closure.enabled:
        return []
    ways = [
        np.array([part.values.atPose3(pose_key(one.id)).translation() for one in part.clusters])
        for part in fleet.parts
    ]
    trees = [KDTree(way[:, :2]) for way in ways]
    far = config.closure.radius + config.closure.map_length
    settings = json.dumps(to_tree(config))
    return [
        Pair(i, j, (fleet.runs[i].folder, fleet.runs[j].folder), fleet.datum, settings)
        for i, j in combinations(range(len(ways)), 2)
        if trees[i].query(ways[j][:, :2], distance_upper_bound=far)[0].min() <= far
    ]


def search_pair(pair: Pair) -> Ties:
    """Find the places that two runs show; any process that sees their folders may do it.

    Args:
        pair: The runs.

    Raises:
        InputError: One cannot be read.
    """
    first, second = (_read_again(folder, pair.datum, pair.settings) for folder in pair.folders)
    return find_ties(first, second, make_config(json.loads(pair.settings)))


def merge(
    fleet: Fleet,
    found: Mapping[Pair, Ties] | None = None,
    stage: Callable[[str], object] = lambda _: None,
) -> Merged:
    """The joint map of runs: one graph, one solve, one cloud.

    Args:
        fleet: The runs.
        found: What pairs of them show.
        stage: Called with what comes next.

    Returns:
        The map.
    """
    started = time.perf_counter()
    stage('solve')
    before = [0, *accumulate(len(part.clusters) for part in fleet.parts)]
    ties: list[Factor] = []
    findings: list[Finding] = []
    pairs = sorted((found or {}).items(), key=lambda item: (item[0].first, item[0].second))
    for pair, one in pairs:
        ties += tie_factors(one, (before[pair.first], before[pair.second]), fleet.config.closure)
        if one.apart:
            findings.append(disagreement(str(pair.folders[0]), str(pair.folders[1]), one.apart))
    searched = sum(one.searched for _, one in pairs)
    result = joined(fleet.parts, fleet.config, ties, searched)
    # Windows that failed are in the folders of their runs.
    result = replace(result, failed=(), findings=ranked([*result.findings, *findings]))
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


@lru_cache(maxsize=4)
def _read_again(folder: Path, datum: Datum, settings: str) -> MapResult:
    config = make_config(json.loads(settings))
    run = read_saved_run(folder, make_store(config.map))
    return turned(run.result, between_datums(datum, _datum(run)), config)


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
