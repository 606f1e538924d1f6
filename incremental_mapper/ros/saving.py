"""Writing a map: complete in its place, or what there is of it, and never over anything.

Data only. Pictures and ``candidates.parquet`` take longer and can be made afterwards.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from incremental_mapper.checks.finding import Finding
from incremental_mapper.checks.outcome import unreadable_findings
from incremental_mapper.errors import OutputError
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.measurements import Drops
from incremental_mapper.results.candidate_spool import CandidateSpool
from incremental_mapper.results.candidate_table import FILE_NAME, candidate_recorder
from incremental_mapper.results.file_names import GRAPH, STATISTICS, TRAJECTORY
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.results.journal.journal_writer import Journal
from incremental_mapper.results.new_folder import HiddenFolder
from incremental_mapper.results.run_folder import write_result
from incremental_mapper.results.run_statistics import InputFacts, RunStatistics
from incremental_mapper.results.sessions.going_on import EarlierMap, whole

EMPTY = 'the map is empty, nothing was saved; no scan and no fix was mapped yet'


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """A map as it stands, and what is told of it.

    Attributes:
        mapper: What is saved.
        drops: What was lost before the mapper.
        wall: Seconds since the first measurement.
        facts: What stats.json says of the input.
        findings: What was wrong with the input, before the mapper's own.
        peak_rss_mb: The largest resident memory of the node.
        spool: The candidates of all windows, where they are kept.
        journal: The map's journal, if there is one.
        earlier: The map that it goes on with: what is saved is the map of both.
        most: Pairs of places that are compared at the most, see ``Mapper.result``.
    """

    mapper: Mapper
    drops: Drops
    wall: float
    facts: InputFacts
    findings: tuple[Finding, ...]
    peak_rss_mb: float
    spool: CandidateSpool | None = None
    journal: Journal | None = None
    earlier: EarlierMap | None = None
    most: float = math.inf


@dataclass(frozen=True, slots=True)
class Target:
    """Where a map is to go.

    Attributes:
        folder: The folder; where it exists, ``folder_2`` and so on is made.
        fallback: Takes the folder's name where its own place cannot be written; None gives up.
    """

    folder: Path
    fallback: Path | None = None


@dataclass(frozen=True, slots=True)
class Saved:
    """The folder that was made.

    ``trouble`` says why it is another one than was wanted, or what is missing in it; ``warnings``
    are what was wrong with the map and its input, the worst first.
    """

    folder: Path
    trouble: str = ''
    warnings: tuple[Finding, ...] = ()


@dataclass(frozen=True, slots=True)
class _Attempt:
    """A hidden folder beside the place that it is meant for, and why it is not complete."""

    target: Path
    scratch: HiddenFolder | None
    trouble: str = ''

    @property
    def useful(self) -> bool:
        """Whether it holds trajectory and graph."""
        scratch = self.scratch
        return scratch is not None and all(
            (scratch.path / name).exists() for name in (TRAJECTORY, GRAPH)
        )

    def drop(self) -> None:
        """Leave nothing of it."""
        if self.scratch is not None:
            self.scratch.drop()


def save_map(target: Target, snapshot: Snapshot) -> Saved:
    """Write the data files of ``map``.

    Args:
        target: Where to.
        snapshot: The map; its mapper may go on afterwards.

    Returns:
        The folder that was made.

    Raises:
        OutputError: There is nothing to save, or nothing of it can be written anywhere.
    """
    result = snapshot.mapper.result(snapshot.most)
    if not result.clusters:
        raise OutputError(EMPTY)
    config = snapshot.mapper.config
    of_all = whole(snapshot.earlier, result, config, snapshot.facts)
    result = of_all.result
    unreadable: list[str] = []
    cloud = result.cloud(config.map, unreadable)
    lost = unreadable_findings(unreadable)
    findings = [*snapshot.findings, *lost]
    statistics = RunStatistics.of_run(
        result,
        snapshot.drops,
        of_all.wall + snapshot.wall,
        len(cloud),
        of_all.facts,
        findings=findings,
    )
    tree = replace(statistics, peak_rss_mb=snapshot.peak_rss_mb).to_tree()
    folder = target.folder.expanduser().absolute()
    place, trouble = _put(
        folder, target, lambda scratch: write_result(scratch, result, cloud, tree)
    )
    missing = [finding.text for finding in lost]
    return Saved(place, '; '.join([trouble, *missing] if trouble else missing), statistics.warnings)


def windows_before(folder: Path) -> int:
    """How many windows a saved map has of the sessions before its newest one."""
    if not (folder / STATISTICS).is_file():  # of a full disk the graph alone was saved
        return 0
    return sum(one['windows'] for one in FinishedRun(folder).stats.get('sessions', ())[:-1])


def write_candidates(folder: Path, spool: CandidateSpool, before: int = 0) -> str | None:
    """Add ``candidates.parquet`` to a saved map; returns a remark where that cannot be done.

    Args:
        folder: The folder of the map.
        spool: The candidates of its windows.
        before: Windows of the map that come before those.
    """
    try:
        with candidate_recorder(folder / FILE_NAME) as record:
            if record is not None:
                for window in spool.windows():
                    record(replace(window, index=window.index + before))
    except (OutputError, OSError) as error:
        return f'no {FILE_NAME}: {error}'
    return f'{FILE_NAME} ends early: {spool.trouble}' if spool.trouble else None


def _put(folder: Path, target: Target, write: Callable[[Path], None]) -> tuple[Path, str]:
    """Write into the wanted place, else the fallback, else what can be written of it.

    Returns:
        The folder, and why it is not as wanted.
    """
    attempts = [_attempt(folder, write)]
    if attempts[0].trouble and target.fallback is not None:
        attempts.append(_attempt(target.fallback.absolute() / folder.name, write))
    newest = attempts[-1]
    trouble = attempts[0].trouble
    try:
        if not newest.trouble:
            elsewhere = f'not in its place, copy it from there: {trouble}' if trouble else ''
            return _stand(newest), elsewhere
        for attempt in attempts:
            if attempt.useful:
                part = attempt.target.with_name(f'{attempt.target.name}_incomplete')
                return _stand(replace(attempt, target=part)), f'incomplete: {trouble}'
    except OSError as error:
        trouble = f'{newest.target}: cannot be written ({error.strerror or error})'
    finally:
        for attempt in attempts:
            attempt.drop()
    raise OutputError(trouble)


def _attempt(target: Path, write: Callable[[Path], None]) -> _Attempt:
    """Write into a hidden folder beside ``target``."""
    scratch: HiddenFolder | None = None
    try:
        scratch = HiddenFolder(target)
        scratch.fill(write)
    except OSError as error:
        reason = error.strerror or str(error)
        return _Attempt(target, scratch, f'{target}: cannot be written ({reason})')
    except OutputError as error:
        return _Attempt(target, scratch, str(error))
    except BaseException:
        _Attempt(target, scratch).drop()
        raise
    return _Attempt(target, scratch)


def _stand(attempt: _Attempt) -> Path:
    """Give an attempt its name, or one that is free."""
    assert attempt.scratch is not None
    return attempt.scratch.appear(attempt.target)
