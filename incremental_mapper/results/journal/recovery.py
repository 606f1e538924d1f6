"""The map of a journal: what the mapper would have given back after the last window in it."""

import fcntl
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, BinaryIO

import gtsam
import numpy as np

from incremental_mapper.blas import single_threaded_blas
from incremental_mapper.checks.finding import Finding, Severity, ranked
from incremental_mapper.config import Config
from incremental_mapper.errors import ConfigError, InputError
from incremental_mapper.graph.factor_archive import FactorArchive
from incremental_mapper.graph.factors import Factor
from incremental_mapper.map.store import MB, Points, PointsInFile, read_points
from incremental_mapper.mapping.final_solve import final_values
from incremental_mapper.mapping.judgement import judge_map
from incremental_mapper.mapping.loop_closing import close_loops
from incremental_mapper.mapping.result import MapResult, fixes_in_map, trajectory_of
from incremental_mapper.mapping.statistics import MapStatistics
from incremental_mapper.measurements import Drops
from incremental_mapper.results.file_names import JOURNAL, STATISTICS
from incremental_mapper.results.journal.journal_writer import (
    BEGINNING,
    FAILED,
    WINDOW,
)
from incremental_mapper.results.journal.record_file import Damage, Record, content, records
from incremental_mapper.results.manifest import require_whole
from incremental_mapper.results.plain_graph import (
    cluster_of_tree,
    core_of,
    factors_of,
    findings_of,
    fix_of,
    unpacked,
    values_of,
)
from incremental_mapper.results.run_statistics import InputFacts
from incremental_mapper.selection.window_record import WindowRecord
from incremental_mapper.settings import make_config
from incremental_mapper.smoothing.graph_state import (
    GraphState,
    PlacedCluster,
    PlacedFix,
    PlacedScan,
)

Tree = Mapping[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class Recovered:
    """What a journal holds.

    Attributes:
        result: The map of all its windows.
        config: The settings of its run.
        facts: What was mapped.
        drops: What was lost before the mapper.
        wall: Seconds from the first measurement to the last window.
        findings: What was wrong with the input, and with the journal.
        notes: Remarks on the journal.
    """

    result: MapResult
    config: Config
    facts: InputFacts
    drops: Drops
    wall: float
    findings: tuple[Finding, ...]
    notes: tuple[str, ...]


def find_journals(place: Path) -> list[Path]:
    """The journals of a folder, the oldest first.

    Args:
        place: The folder, or one journal.

    Returns:
        The journals; none where it is the folder of a finished run, which is whole.

    Raises:
        InputError: There is none; of the folder of a run, what is wrong with it.
    """
    if place.is_file():
        return [place]
    if not place.is_dir():
        raise InputError(f'{place}: does not exist; expected a journal, or a folder of journals')
    if (place / STATISTICS).is_file():
        require_whole(place)
        return []
    found = sorted(place.glob(f'*{JOURNAL}'))
    if not found:
        raise InputError(f'{place}: holds no journal, a file that ends in {JOURNAL}')
    return found


@contextmanager
def opened(path: Path, alone: bool) -> Iterator[BinaryIO]:
    """A journal, open for reading.

    Args:
        path: The file.
        alone: Whether nobody else may write or read it meanwhile.

    Raises:
        InputError: It cannot be read, or somebody else has it.
    """
    try:
        file = path.open('rb+' if alone else 'rb')
    except OSError as error:
        raise InputError(f'{path}: cannot be read ({error.strerror})') from error
    with file:
        if alone:
            try:
                fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                raise InputError(f'{path}: is in use: its map is still being made') from error
        yield file


def in_use(file: BinaryIO) -> bool:
    """Whether somebody writes a journal, or recovers and removes it.

    Args:
        file: It, open for reading.
    """
    try:
        fcntl.lockf(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        fcntl.lockf(file, fcntl.LOCK_UN)
    except BlockingIOError:
        return True
    except OSError:
        return False  # nobody can tell
    return False


def recover(path: Path, file: BinaryIO) -> Recovered:
    """Make the map of a journal.

    Args:
        path: Its name.
        file: The journal, which must stay open as long as points of the map are wanted.

    Returns:
        The map and what is told of it.

    Raises:
        InputError: It is no journal, cannot be read by this version, or holds no window.
    """
    try:
        return _recovered(path, _read(path, file))
    except OSError as error:
        raise InputError(f'{path}: cannot be read ({error.strerror})') from error
    # GTSAM says so of what another version of it has written.
    except (KeyError, TypeError, ValueError, RuntimeError, IndexError, ConfigError) as error:
        reason = ' '.join(str(error).split())[:200]
        raise InputError(
            f'{path}: cannot be read by this version of the program ({reason}); '
            'recover it with the version that wrote it'
        ) from error


@dataclass(slots=True, eq=False)
class _Reading:
    """What is known after some records."""

    begun: Tree
    clusters: list[PlacedCluster] = field(default_factory=list)
    factors: list[Factor] = field(default_factory=list)
    scans: list[PlacedScan] = field(default_factory=list)
    fixes: list[PlacedFix] = field(default_factory=list)
    final: gtsam.Values = field(default_factory=gtsam.Values)
    lag: gtsam.Values = field(default_factory=gtsam.Values)
    rows: list[dict[str, Any]] = field(default_factory=list)
    failed: list[WindowRecord] = field(default_factory=list)
    findings: tuple[Finding, ...] = ()
    last: Tree = field(default_factory=dict)
    damage: Damage | None = None

    def state(self) -> GraphState:
        """G(t) after the last window."""
        values = gtsam.Values(self.final)
        values.insert_or_assign(self.lag)
        offset = self.last['enu_offset']
        return GraphState(
            clusters=self.clusters,
            factors=FactorArchive(self.factors),
            scans=self.scans,
            fixes=self.fixes,
            values=values,
            enu_offset=None if offset is None else np.array(offset),
            georeferenced=self.last['georeferenced'],
        )


@dataclass(frozen=True, slots=True)
class _Points:
    """The points of a journal; see PointFile."""

    file: BinaryIO

    def read(self, offset: int, size: int) -> Points:
        return read_points(self.file.fileno(), offset, size)


def _read(path: Path, file: BinaryIO) -> _Reading:
    reading: _Reading | None = None
    points = _Points(file)
    for item in records(path, file):
        if isinstance(item, Damage):
            if reading is not None:
                reading.damage = item
        elif item.kind == BEGINNING:
            reading = _Reading(_unpacked(file, item))
            reading.findings = findings_of(reading.begun['findings'])
        elif reading is None:
            break
        elif item.kind == FAILED:
            told, _, data = content(file, item).partition(b'\n')
            tree = json.loads(told)
            reading.failed.append(WindowRecord(tree['window'], tree['error'], data))
        elif item.kind == WINDOW:
            _take(reading, _unpacked(file, item), points)
    if reading is None or not reading.clusters:
        raise InputError(f'{path}: holds no window of a map; there is nothing to recover')
    return reading


def _take(reading: _Reading, tree: Tree, points: _Points) -> None:
    """Append a window, as the mapper did."""
    graph, lag, final = tree['texts']
    factors = factors_of(tree['factors'], graph)
    if (order := tree.get('order')) is not None:
        # All of G(t) was replaced.
        known, new = reading.factors, iter(factors)
        reading.factors = [known[place] if place >= 0 else next(new) for place in order]
        reading.fixes, reading.final = [], gtsam.Values()
    else:
        reading.factors.extend(factors)
    reading.final.insert_or_assign(values_of(final))
    reading.lag = values_of(lag)
    if tree['joined'] is not None:
        number, core, stood = tree['joined']
        before = reading.clusters[number]
        joined = (*before.joined, *map(core_of, core))
        reading.clusters[number] = replace(before, joined=joined, stood=(*before.stood, *stood))
    reading.clusters.extend(map(cluster_of_tree, tree['clusters']))
    reading.scans.extend(_scan(scan, points) for scan in tree['scans'])
    reading.fixes.extend(map(fix_of, tree['fixes']))
    reading.rows.append(tree['row'])
    if 'findings' in tree:
        reading.findings = findings_of(tree['findings'])
    reading.last = tree


@single_threaded_blas()
def _recovered(path: Path, reading: _Reading) -> Recovered:
    state, begun, last = reading.state(), reading.begun, reading.last
    config = make_config(begun['settings'], str(path))
    values, failed = final_values(state, config)
    closed = close_loops(state, values, config)
    values = closed.values
    statistics = {**last['statistics'], 'settings': begun['settings']}
    statistics['solver_failures'] += int(failed)
    clusters = tuple(state.clusters)
    known = findings_of(begun['findings'])
    result = MapResult(
        clusters=clusters,
        factors=(*state.factors.unpacked(), *closed.factors),
        values=values,
        trajectory=trajectory_of(clusters, values),
        scans=tuple(state.scans),
        fixes=fixes_in_map(state),
        rows=tuple(reading.rows),
        statistics=closed.counted(MapStatistics.from_tree(statistics)),
        findings=ranked([*reading.findings, *judge_map(state, values, config)]),
        failed=tuple(reading.failed),
    )
    facts = begun['input']
    counts = facts['counts'] or last['statistics']['received']  # of topics nobody knows before
    note = f'recovered from {path}: {len(reading.rows)} windows'
    found = [*known, *_damaged(path, reading.damage)]
    if reading.damage is not None and not reading.damage.inside:
        note += f'; {reading.damage.size} bytes of a window that was cut off are left out'
    return Recovered(
        result=result,
        config=config,
        facts=InputFacts(facts['path'], facts['kind'], counts, (*facts['notes'], note)),
        drops=Drops({(sensor, reason): count for sensor, reason, count in last['drops']}),
        wall=last['wall_s'],
        findings=tuple(found),
        notes=(note,),
    )


def _damaged(path: Path, damage: Damage | None) -> list[Finding]:
    if damage is None or not damage.inside:
        return []
    text = (
        f'{path.name} is damaged: the last {damage.size / MB:.3f} MB of '
        f'{(damage.offset + damage.size) / MB:.3f} cannot be read'
    )
    remedy = 'the map ends there; see whether the disk is sound'
    return [Finding('journal_damaged', Severity.WARNING, '', text, remedy)]


def _unpacked(file: BinaryIO, record: Record) -> dict[str, Any]:
    """The tree of a record, with its texts in place of their lengths."""
    return unpacked(content(file, record))


def _scan(tree: Tree, points: _Points) -> PlacedScan:
    offset, rows, columns = tree['points']
    turned = tree['T_cluster_scan']
    return PlacedScan(
        tree['cluster'],
        tree['stamp'],
        tree['sensor'],
        PointsInFile(points, offset, (rows, columns)),
        gtsam.Pose3() if turned is None else gtsam.Pose3(np.array(turned)),
    )
