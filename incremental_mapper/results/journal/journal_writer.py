"""Writes the journal of a map: what each window appended, and the points of its scans.

What has left the smoother's lag is final and written once; the lag is written anew with every
window, so that the estimates of a recovered map are those that the mapper had. Where all of G(t)
was replaced, as when it was turned into ENU, the record says which factors are new.
"""

import contextlib
import fcntl
import json
import logging
import os
import shlex
import threading
import time
from collections.abc import Sequence
from io import FileIO
from pathlib import Path
from typing import Any

import gtsam
import numpy as np

from incremental_mapper import __version__
from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.config import Config
from incremental_mapper.graph.factors import Factor
from incremental_mapper.map.store import (
    MB,
    Points,
    PointsInFile,
    StoredPoints,
    append,
    disk_low,
    free_bytes,
    make_store,
    read_points,
)
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.mapping.result import WindowResult
from incremental_mapper.measurements import Drops
from incremental_mapper.results.file_names import JOURNAL
from incremental_mapper.results.journal.record_file import frame, title
from incremental_mapper.results.plain_graph import (
    cluster_tree,
    core_tree,
    factor_tree,
    fix_tree,
    packed,
)
from incremental_mapper.results.run_statistics import InputFacts, versions
from incremental_mapper.settings import to_tree
from incremental_mapper.smoothing.graph_state import (
    GraphState,
    PlacedCluster,
    PlacedScan,
)

LOGGER = logging.getLogger('incremental_mapper')
BEGINNING, POINTS, WINDOW, FAILED = b'B', b'P', b'W', b'F'
"""Kinds of records."""


class Journal:
    """The journal of one map, in a file of its own; it is the map's store of points, too.

    Nothing that goes wrong with it costs the map: it ends, ``findings`` say why, and points are
    kept as ``map.store`` says from then on. One thread writes; another one sees to it that what is
    written reaches the disk.
    """

    def __init__(
        self,
        folder: Path,
        config: Config,
        facts: InputFacts,
        known: Sequence[Finding] = (),
        sync: float | None = None,
    ) -> None:
        """Begin a file.

        Args:
            folder: It is made where it is not there.
            config: All settings of the map.
            facts: What is mapped.
            known: What was wrong with the input, and is put right by ``config``.
            sync: Replaces ``journal.sync``.
        """
        self.path = folder
        self.windows = self.missing = self.nbytes = 0
        self._sync = config.journal.sync if sync is None else sync
        self._reserve = round(config.journal.reserve * MB)
        self._warn = round(config.map.reserve * MB)
        self._rest = make_store(config.map)
        self._reason = ''
        self._removed = False
        self._free: int | None = None
        self._file: FileIO | None = None
        self._written = _Written()
        self._begun = time.monotonic()
        self._lock = threading.Lock()
        self._ended = threading.Event()
        try:
            self._open(folder)
            tree = {
                'package': __version__,
                'versions': versions(),
                'settings': to_tree(config),
                'input': _facts_tree(facts),
                'findings': [finding.to_tree() for finding in known],
            }
            self._append(title() + frame(BEGINNING, packed(tree)))
            self._flush()
        except OSError as error:
            self._stop(f'{folder}: {error.strerror or error}')
            return
        self._thread = threading.Thread(target=self._keep_flushing, name='journal', daemon=True)
        self._thread.start()

    # --- the store of points

    def put(self, points: Points) -> StoredPoints:
        """See PointStore."""
        if self._reason:
            return self._rest.put(points)
        data = np.ascontiguousarray(points, dtype=np.float32).tobytes()
        try:
            record = frame(POINTS, data)
            offset = self._append(record) + len(record) - len(data)
        except OSError as error:
            self._stop(error.strerror or str(error))
            return self._rest.put(points)
        return PointsInFile(self, offset, (points.shape[0], points.shape[1]))

    def read(self, offset: int, size: int) -> Points:
        """See PointFile."""
        return read_points(self._number, offset, size)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """See PointStore."""
        if not self._reason:
            low = disk_low(self.path.parent, self._free, self._warn)
            return () if low is None else (low,)
        text = f'the journal has ended ({self._reason}): {self.missing} windows are not in it'
        remedy = 'a crash would cost them; make room, or name another folder in journal.folder'
        stopped = Finding('journal_ended', Severity.WARNING, '', text, remedy)
        return (stopped, *self._rest.findings)

    # --- windows

    def window(self, mapper: Mapper, result: WindowResult, drops: Drops) -> None:
        """Write what a window has appended.

        Args:
            mapper: The mapper, right after the window.
            result: What it gave back.
            drops: What was lost before the mapper.
        """
        if self._reason:
            self.missing += 1
            return
        try:
            self._free = free_bytes(self._number)
            if self._free < self._reserve:
                self._stop(f'{self._free // MB} MB are left, less than journal.reserve')
                self.missing += 1
                return
            for failed in mapper.failed_windows[self._written.failed :]:
                told = json.dumps({'window': failed.window, 'error': failed.error}).encode()
                self._append(frame(FAILED, told + b'\n' + failed.data))
            tree, texts = self._written.news(mapper, result)
            tree['wall_s'] = time.monotonic() - self._begun
            tree['drops'] = [[*place, count] for place, count in sorted(drops.items())]
            self._append(frame(WINDOW, packed(tree, *texts)))
            self._written.any = self._written.any or bool(mapper.state.clusters)
        except OSError as error:
            self._stop(error.strerror or str(error))
        # A strategy of a user's own may make factors that GTSAM cannot write.
        except Exception as error:
            LOGGER.warning('the journal fails; the map goes on', exc_info=True)
            self._stop(' '.join(repr(error).split())[:200])
        else:
            self.windows += 1
            return
        self.missing += 1

    @property
    def holds_map(self) -> bool:
        """Whether there is a file of which a map can be made."""
        return self._written.any and not self._removed

    def kept(self) -> str:
        """Words for a map that is saved nowhere else; none where there is no file of it."""
        if not self.holds_map:
            return ''
        part = f'the first {self.windows} windows of the map are' if self.missing else 'the map is'
        command = f'incremental_mapper recover {shlex.quote(str(self.path))}'
        return f'; {part} in its journal: "{command}" makes its files'

    def close(self) -> None:
        """End it: what was written reaches the disk, and a file without a map goes."""
        self._ended.set()
        if not self._written.any:
            self.remove()
        elif not self._removed:
            if not self._reason:
                self._flush_quietly()
            with contextlib.suppress(OSError):
                fcntl.lockf(self._number, fcntl.LOCK_UN)

    def remove(self) -> None:
        """End it and remove its file: the map is saved, or nobody wants it; any thread may.

        Points can still be read from it as long as somebody holds them.
        """
        self._ended.set()
        if self._file is not None and not self._removed:
            self._removed = True
            with contextlib.suppress(OSError):
                self.path.unlink()

    # --- the file

    def _open(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        name = time.strftime('drive_%Y%m%d_%H%M%S')
        number = 1
        while self._file is None:
            path = folder / (f'{name}_{number}{JOURNAL}' if number > 1 else f'{name}{JOURNAL}')
            number += 1
            with contextlib.suppress(FileExistsError):
                self._file = FileIO(path, 'x+')
                self.path = path
        # Whoever recovers journals must leave one alone that is being written. This lock is not
        # inherited by a fork, and ends with this process. Some network disks have none.
        with contextlib.suppress(OSError):
            fcntl.lockf(self._number, fcntl.LOCK_EX | fcntl.LOCK_NB)

    @property
    def _number(self) -> int:
        assert self._file is not None
        return self._file.fileno()

    def _append(self, data: bytes) -> int:
        """Put bytes behind those that there are; returns where they begin."""
        append(self._number, data, self.nbytes)
        offset, self.nbytes = self.nbytes, self.nbytes + len(data)
        return offset

    def _stop(self, reason: str) -> None:
        """Write no more; what is whole in it may be recovered."""
        self._reason = reason
        self._ended.set()
        if self._file is not None:
            with contextlib.suppress(OSError):  # a part of a record takes room, and is of no use
                os.ftruncate(self._number, self.nbytes)
        LOGGER.warning('the journal has ended (%s); the map goes on without it', reason)

    def _flush(self) -> None:
        with self._lock:
            os.fsync(self._number)
        folder = os.open(self.path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    def _flush_quietly(self) -> None:
        try:
            with self._lock:
                os.fsync(self._number)
        except OSError as error:
            self._stop(error.strerror or str(error))

    def _keep_flushing(self) -> None:
        flushed = 0
        while not self._ended.wait(max(self._sync, 0.01)):
            size = self.nbytes
            if size != flushed:
                self._flush_quietly()
                flushed = size


class _Written:
    """How much of a mapper's state is in the journal."""

    def __init__(self) -> None:
        self.failed = 0
        self.any = False
        self._clusters = self._scans = self._fixes = 0
        self._newest: PlacedCluster | None = None
        self._factors: Sequence[Factor] = ()
        self._count = self._final = 0
        self._lag: set[int] = set()
        self._findings: Sequence[Finding] = ()

    def news(self, mapper: Mapper, result: WindowResult) -> tuple[dict[str, Any], list[str]]:
        """What is new since the last call: plain values, and what GTSAM writes itself."""
        state = mapper.state
        graph, texts = self._graph(state)
        tree: dict[str, Any] = {'row': result.row, **graph}
        tree['clusters'] = [cluster_tree(placed) for placed in state.clusters[self._clusters :]]
        tree['joined'] = self._joined(state)
        tree['scans'] = [_scan_tree(scan) for scan in state.scans[self._scans :]]
        tree['fixes'] = [fix_tree(fix) for fix in state.fixes[self._fixes :]]
        tree['enu_offset'] = state.enu_offset
        tree['georeferenced'] = state.georeferenced
        statistics = mapper.statistics.to_tree()
        del statistics['settings']
        tree['statistics'] = statistics
        if (findings := mapper.lasting_findings) != self._findings:
            tree['findings'] = [finding.to_tree() for finding in findings]
            self._findings = findings
        self._clusters, self._scans = len(state.clusters), len(state.scans)
        self._fixes, self.failed = len(state.fixes), len(mapper.failed_windows)
        self._newest = state.clusters[-1] if state.clusters else None
        return tree, texts

    def _graph(self, state: GraphState) -> tuple[dict[str, Any], list[str]]:
        """Factors and values: new factors, the lag, and what has become final."""
        tree: dict[str, Any] = {}
        lag = state.prior.values
        keys = set(lag.keys())
        if state.factors is self._factors or not self._factors:
            new = state.factors[self._count :]
            gone = self._lag - keys
            final = state.values.extract(list(gone)) if gone else gtsam.Values()
            if self._final + len(gone) != state.values.size():
                final = state.values  # some were never in the lag when a window was written
        else:
            # All of G(t) was replaced: -1 stands for a new factor, else for one that is known.
            places = {
                id(factor): place for place, factor in enumerate(self._factors[: self._count])
            }
            order = [places.get(id(factor), -1) for factor in state.factors]
            new = [factor for factor, place in zip(state.factors, order, strict=True) if place < 0]
            tree['order'], final = order, state.values
            self._fixes = 0
        graph = gtsam.NonlinearFactorGraph()
        for factor in new:
            graph.push_back(factor.factor)
        tree['factors'] = [factor_tree(factor) for factor in new]
        empty = final.size() == 0
        texts = [
            graph.serialize() if new else '',
            lag.serialize(),
            '' if empty else final.serialize(),
        ]
        self._factors, self._count = state.factors, len(state.factors)
        self._lag, self._final = keys, state.values.size()
        return tree, texts

    def _joined(self, state: GraphState) -> list[Any] | None:
        """What joined the newest cluster of those that are written."""
        before = self._newest
        now = state.clusters[before.id] if before is not None else None
        if before is None or now is None or now is before:
            return None
        core = now.joined[len(before.joined) :]
        return [now.id, [core_tree(item) for item in core], now.stood[len(before.stood) :]]


def _facts_tree(facts: InputFacts) -> dict[str, Any]:
    return {
        'path': facts.path,
        'kind': facts.kind,
        'counts': dict(facts.counts),
        'notes': list(facts.notes),
    }


def _scan_tree(scan: PlacedScan) -> dict[str, Any]:
    stored = scan.stored
    assert isinstance(stored, PointsInFile)  # else the journal has ended, and nothing is written
    offset = scan.T_cluster_scan
    still = offset.equals(gtsam.Pose3(), 0.0)
    return {
        'cluster': scan.cluster,
        'stamp': scan.stamp,
        'sensor': scan.sensor,
        'points': [stored.offset, *stored.shape],
        'T_cluster_scan': None if still else offset.matrix(),
    }
