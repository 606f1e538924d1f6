"""Mapping a whole input offline: the same mapper as online, as fast as it goes.

``map_into`` is what ``map`` does once and ``evaluate`` many times.
"""

import signal
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.config import Config
from incremental_mapper.datasets.source import Source
from incremental_mapper.errors import InputError, OutputError
from incremental_mapper.exports.formats import check_formats
from incremental_mapper.map.ply import MapCloud
from incremental_mapper.mapping.load_shedding import READ_AHEAD
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.mapping.result import MapResult, WindowResult
from incremental_mapper.results.candidate_table import FILE_NAME, candidate_recorder
from incremental_mapper.results.journal.journal_writer import Journal
from incremental_mapper.results.mending import MendError, mending
from incremental_mapper.results.opened_drive import Drive, open_drive
from incremental_mapper.results.run_folder import (
    is_whole,
    prepared_folder,
    shown_of,
    write_result,
)
from incremental_mapper.results.run_statistics import InputFacts, RunStatistics
from incremental_mapper.results.sessions.going_on import EarlierMap, whole
from incremental_mapper.results.trajectory_errors import trajectory_errors
from incremental_mapper.results.watching import RunWatcher, Watch
from incremental_mapper.settings import merge, read_yaml
from incremental_mapper.trajectory import Trajectory
from incremental_mapper.visualization.run_pictures import draw_run


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """A mapped input: the result, the map with where its points come from, and its statistics."""

    result: MapResult
    map: MapCloud
    statistics: RunStatistics

    @property
    def cloud(self) -> NDArray[np.float32]:
        """The map (N, 3) in metres, or (N, 4), intensity last, where a LiDAR measures it."""
        return self.map.points

    @property
    def points(self) -> NDArray[np.float32]:
        """The map's points (N, 3), metres."""
        return self.cloud[:, :3]


def _nobody(_what: str) -> None:
    """Is told what comes next where nobody wants to know."""


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


def map_into(
    folder: Path,
    drive: Drive,
    progress: Callable[[int], Any] | None = None,
    stop: Stop | None = None,
    stage: Callable[[str], object] = _nobody,
    watch: Sequence[Watch] = (),
    pictures: bool = True,
) -> Run:
    """Map a drive and write all its files.

    Args:
        folder: An existing folder to write into.
        drive: What ``open_drive`` gave.
        progress: See ``map_source``.
        stop: See ``map_source``.
        stage: Called with what comes next, once the input has been read.
        watch: Begin to watch a run; what goes wrong with them is raised once all is written.
        pictures: Draw them when the files are written, where nobody else does.

    Returns:
        The run.

    Raises:
        ConfigError: A format of ``map.formats`` cannot be written here.
        InputError: Nothing of the input could be used.
        OutputError: A file cannot be written.
        KeyboardInterrupt: It was stopped before anything was mapped.
    """
    journals: list[Journal] = []
    troubles: list[str] = []
    check_formats(drive.config.map.formats)

    def attempt(drive: Drive, may_mend: bool) -> Run:
        with (
            candidate_recorder(folder / FILE_NAME) as record,
            _journaling(drive) as journal,
            ExitStack() as stack,
        ):
            watchers = [stack.enter_context(begin(drive.config)) for begin in watch]
            told = None if record is None else _numbered_on(record, drive.earlier)
            run = _map_once(drive, progress, stop, told, may_mend, journal, stage, watchers)
        if drive.earlier is not None and not run.result.sessions:
            (folder / FILE_NAME).unlink(missing_ok=True)  # its windows have other numbers
        troubles[:] = [watcher.trouble for watcher in watchers if watcher.trouble]
        journals.extend([] if journal is None else [journal])
        return run

    run = mending(drive, attempt)
    stage('write')
    try:
        write_result(folder, run.result, run.map, run.statistics.to_tree())
    except OutputError as error:
        if is_whole(folder):
            for journal in journals:
                journal.remove()
        kept = ''.join(journal.kept() for journal in journals)
        raise OutputError(f'{error}{kept}') from error
    for journal in journals:
        journal.remove()
    if pictures:
        stage('pictures')
        draw_run(folder, shown_of(run.result, run.map, drive.truth))
    if troubles:
        raise OutputError(f'{"; ".join(troubles)}; all else is in {folder}')
    return run


def map_drive(
    path: Path | str,
    out: Path | str | None = None,
    config: Path | str | Mapping[str, Any] | None = None,
    *,
    strategy: str | None = None,
    truth: Path | str | None = None,
    force: bool = False,
) -> Run:
    """Map an input from end to end, as the command ``map`` does.

    Args:
        path: KAIST folder, rosbag2 or ROS 1 bag, or a folder of scans.
        out: Folder for all files and pictures, see ``run_folder``; None writes nothing.
        config: A settings file, or its sections as nested dictionaries; the input's own settings
            lie below them.
        strategy: Replaces ``selection.strategy``.
        truth: File of true poses, TUM or KAIST's ``global_pose.csv``; by default what lies in the
            input.
        force: Write into ``out`` although it is not empty.

    Returns:
        The run: trajectory and scans in the frame ``map``, the map's points (N, 3) in metres, and
        the record of ``stats.json``.

    Raises:
        ConfigError: A setting or the strategy is unknown, or has a value that it cannot have.
        InputError: The input or the truth cannot be read, or nothing of it could be used.
        OutputError: The folder is taken, or a file cannot be written.
    """
    named = isinstance(config, (str, Path))
    tree = read_yaml(Path(config)) if named else dict(config or {})  # type: ignore[arg-type]
    if strategy is not None:
        tree = merge(tree, {'selection': {'strategy': strategy}})
    where = str(config) if named else 'settings'
    drive = open_drive(Path(path), tree, where, None if truth is None else Path(truth))
    if out is None:
        return mending(drive, lambda drive, may_mend: _map_once(drive, may_mend=may_mend))
    with prepared_folder(Path(out), force):
        return map_into(Path(out), drive)


def map_source(
    source: Source,
    config: Config,
    truth: Trajectory | None = None,
    progress: Callable[[int], object] | None = None,
    stop: Stop | None = None,
    observe: Callable[[WindowResult], object] | None = None,
) -> Run:
    """Map an input from end to end, as the settings say.

    Args:
        source: An opened input; it is read once.
        config: The effective settings.
        truth: True poses that the estimate is compared with.
        progress: Called with the number of measurements read since its last call.
        stop: Ends the run early where it is wanted; what was mapped until then is kept.
        observe: Called with each window.

    Returns:
        The run; nothing is written.

    Raises:
        InputError: Nothing of the input could be used.
        KeyboardInterrupt: It was stopped before anything was mapped.
    """
    drive = Drive(source, config, truth, {}, '')
    return _map_once(drive, progress, stop, observe)


@contextmanager
def _journaling(drive: Drive) -> Iterator[Journal | None]:
    """The journal of a run, if one is wanted; it stays where the run fails."""
    place, info = drive.config.journal.folder, drive.source.info
    if not place:
        yield None
        return
    facts = InputFacts(str(info.path), info.kind, info.counts, drive.all_notes())
    known = (*info.findings, *drive.mended)
    journal = Journal(Path(place).expanduser().absolute(), drive.config, facts, known)
    try:
        yield journal
    except MendError:
        journal.remove()  # all of it is mapped again
        raise
    finally:
        journal.close()


def _map_once(
    drive: Drive,
    progress: Callable[[int], object] | None = None,
    stop: Stop | None = None,
    observe: Callable[[WindowResult], object] | None = None,
    may_mend: bool = False,
    journal: Journal | None = None,
    stage: Callable[[str], object] = _nobody,
    watchers: Sequence[RunWatcher] = (),
) -> Run:
    """As ``map_source``; raises MendError, if it may, where the data prove a setting wrong."""
    source, config, truth = drive.source, drive.config, drive.truth

    def tell(windows: Iterable[WindowResult]) -> None:
        for window in windows:
            if journal is not None:
                journal.window(mapper, window, source.drops)
            if observe is not None:
                observe(window)
            for watcher in watchers:
                watcher.window(mapper, window)

    sensors = [name for name, count in source.info.counts.items() if count]
    mapper = Mapper(config, sensors, store=journal)
    started = time.perf_counter()  # what is compiled or started once is no part of the mapping
    interrupted, count = False, 0
    with closing(mapper):
        for measurement in source.measurements():
            tell(mapper.advance(measurement, READ_AHEAD))
            count += 1
            if progress is not None:
                progress(1)
            if may_mend and mapper.mend:
                if progress is not None:
                    progress(-count)
                raise MendError(mapper.mended)
            if stop is not None and stop.wanted:
                interrupted = True
                break
        stage('last windows')
        tell(mapper.flush())
        if may_mend and mapper.mend:
            raise MendError(mapper.mended)
        stage('final solve')
        result = mapper.result()
    info = source.info
    facts = InputFacts(str(info.path), info.kind, info.counts, drive.all_notes())
    if drive.earlier is not None:
        stage('sessions')
    of_all = whole(drive.earlier, result, config, facts)
    result = of_all.result
    if not result.clusters:
        if interrupted:
            raise KeyboardInterrupt
        raise _nothing_used(source)
    stage('map')
    cloud = result.cloud(config.map)
    wall = of_all.wall + time.perf_counter() - started  # comparing and drawing are no mapping
    for watcher in watchers:
        watcher.finish(result, cloud)
    errors = None if truth is None else trajectory_errors(result.trajectory, truth)
    statistics = RunStatistics.of_run(
        result,
        source.drops,
        wall,
        len(cloud),
        of_all.facts,
        errors,
        interrupted,
        (*info.findings, *drive.mended),
    )
    return Run(result, cloud, statistics)


def _numbered_on(
    record: Callable[[WindowResult], object], earlier: EarlierMap | None
) -> Callable[[WindowResult], object]:
    """Count windows on from those of the map before."""
    if earlier is None:
        return record
    before = earlier.windows
    return lambda window: record(replace(window, index=window.index + before))


def _nothing_used(source: Source) -> InputError:
    reasons = ', '.join(
        f'{count} of {sensor} ({reason})'
        for (sensor, reason), count in sorted(source.drops.items())
    )
    return InputError(
        f'{source.info.path}: no scan and no fix could be used'
        + (f'; left out: {reasons}' if reasons else '; is it the right input?')
    )
