"""One map from its first measurement to its last: the mapper, and what is told of its windows."""

import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TypeAlias

from incremental_mapper.checks.finding import Finding, ranked
from incremental_mapper.config import Config, Tree
from incremental_mapper.garbage import search_all, set_aside
from incremental_mapper.mapping.following import Follower, PoseUpdate
from incremental_mapper.mapping.load_shedding import NO_SHEDDING, LoadShedding
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.mapping.newest_state import NewestState
from incremental_mapper.mapping.result import WindowResult
from incremental_mapper.mapping.statistics import peak_rss_mb
from incremental_mapper.measurements import Drops, Measurement
from incremental_mapper.results.candidate_spool import CandidateSpool
from incremental_mapper.results.candidate_table import FILE_NAME
from incremental_mapper.results.journal.journal_writer import Journal
from incremental_mapper.results.run_statistics import InputFacts
from incremental_mapper.results.sessions.going_on import EarlierMap
from incremental_mapper.ros.inbox import View
from incremental_mapper.ros.saving import Snapshot
from incremental_mapper.ros.search_process import SearchProcess
from incremental_mapper.ros.subscriptions import GNSS, IMU
from incremental_mapper.ros.updates import News, Trouble, ViewUpdate, WindowUpdate
from incremental_mapper.visualization.extras import LIBRARIES

Told: TypeAlias = PoseUpdate | WindowUpdate | News | Trouble

TOPICS = 'ROS topics'
AUTOSAVE = '_autosave'
FAILED = 'mapper_failed'
"""Why a measurement was lost where the mapper raised."""


class MapSession:
    """A mapper with its live map and its odometry frame; used in the worker's thread.

    ``limited_windows`` counts the windows for which fewer candidates were tried because
    measurements came too fast; ``scan_bytes`` and ``cloud_bytes`` are what this map's scans and
    its voxels take of the memory, ``disk_bytes`` what scans take of a disk. Any thread may read
    these. Whatever the libraries below raise is let through.
    """

    def __init__(
        self,
        config: Config,
        mended: Sequence[Finding] = (),
        outside: Callable[[], Drops] = Drops,
        earlier: EarlierMap | None = None,
    ) -> None:
        """Begin a map.

        Args:
            config: All settings.
            mended: What they put right.
            outside: Tells what was lost before the mapper.
            earlier: The map that it goes on with, in whose frame ``config`` puts it.
        """
        self._earlier = earlier
        self._mended, self._outside = tuple(mended), outside
        self.limited_windows = self.scan_bytes = self.cloud_bytes = self.disk_bytes = 0
        search_all()
        self.journal = _journal(config, self._mended)
        sensors = [*config.lidars, IMU, GNSS]
        try:
            self._mapper = Mapper(
                config, sensors, config.window.predict, self.journal, SearchProcess()
            )
        except BaseException:
            self.discard()
            raise
        self._follower = Follower(self._mapper, None if earlier is None else earlier.run.result)
        self._live = self._follower.live
        self._started: float | None = None
        # Looked for, not imported: the process that saves needs it, not this one.
        wanted = config.save.candidates and find_spec(LIBRARIES[FILE_NAME]) is not None
        folder = Path(config.map.store_folder) if config.map.store_folder else None
        self._spool = CandidateSpool(folder) if wanted else None
        set_aside()

    def close(self) -> None:
        """Let go of the mapper's processes."""
        self._mapper.close()
        if self._spool is not None:
            self._spool.close()
        if self.journal is not None:
            self.journal.close()

    def discard(self) -> None:
        """Leave no journal: nobody wants this map, or it is mapped again."""
        if self.journal is not None:
            self.journal.remove()

    def advance(self, measurement: Measurement, shedding: LoadShedding) -> Iterator[Told]:
        """Map a measurement; the windows that it completes are told of one by one."""
        if self._started is None:
            self._started = time.perf_counter()
        return self._told(self._mapper.advance(measurement, shedding), shedding)

    @property
    def waits(self) -> bool:
        """Whether a closed window waits for its scans, and nothing need come for it to go on."""
        return self._mapper.waits

    def go_on(self, shedding: LoadShedding) -> Iterator[Told]:
        """Map the closed windows whose scans are prepared by now."""
        return self._told(self._mapper.go_on(shedding), shedding)

    def drain(self) -> Iterator[Told]:
        """Close and map every open window."""
        return self._told(self._mapper.drain(NO_SHEDDING), NO_SHEDDING, on_order=True)

    def view(self, view: View, graph_span: float) -> ViewUpdate:
        """Map, path or graph as they stand; ``graph_span`` is how much of the graph, seconds."""
        stamp = self._mapper.state.frontier.newest_stamp
        if view is View.MAP:
            begin = time.perf_counter()
            points = self._live.points()
            return ViewUpdate(view, points, stamp, time.perf_counter() - begin)
        if view is View.PATH:
            return ViewUpdate(view, self._live.path(), stamp)
        return ViewUpdate(view, self._live.graph(graph_span), stamp)

    @property
    def mend(self) -> Tree:
        """Settings that the data proved right against those of this map; see ``Mapper.mend``."""
        return self._mapper.mend

    @property
    def mended(self) -> tuple[Finding, ...]:
        """The findings that ``mend`` puts right."""
        return self._mapper.mended

    def mended_since(self, findings: Sequence[Finding]) -> None:
        """Take note of what settings put right while the map goes on."""
        self._mended = (*self._mended, *findings)

    @property
    def drops(self) -> Drops:
        """What the mapper did not use; any thread may ask."""
        return self._mapper.drops

    @property
    def empty(self) -> bool:
        """Whether nothing was mapped."""
        return not self._mapper.state.clusters

    def snapshot(self, drops: Drops, findings: Iterable[Finding]) -> Snapshot:
        """The map as it stands, to be saved by a fork of this process.

        Args:
            drops: What never reached the mapper.
            findings: What was wrong with it.
        """
        counts = dict(self._mapper.stats()['received'])
        facts = InputFacts(TOPICS, TOPICS, counts)
        known = (*findings, *self._mended)
        return Snapshot(
            self._mapper,
            drops,
            self._wall(),
            facts,
            known,
            peak_rss_mb(),
            self._spool,
            self.journal,
            self._earlier,
        )

    def taken(self, reason: str) -> Drops:
        """Everything that the mapper took in and has not counted as dropped.

        Args:
            reason: Why it is lost.
        """
        stats, lost = self._mapper.stats(), Counter[tuple[str, str]]()
        for sensor, count in stats['received'].items():
            lost[sensor, reason] = count - sum(stats['dropped'].get(sensor, {}).values())
        return +lost

    def in_no_cluster(self) -> Drops:
        """Core measurements that the mapper took in and has neither used nor counted."""
        lost = self.taken(FAILED)
        del lost[IMU, FAILED]
        for placed in self._mapper.state.clusters:
            lost.subtract(
                (core.sensor, FAILED) for core in (*placed.cluster.members, *placed.joined)
            )
        return +lost

    def _wall(self) -> float:
        return 0.0 if self._started is None else time.perf_counter() - self._started

    def _told(
        self, results: Iterable[WindowResult], shedding: LoadShedding, on_order: bool = False
    ) -> Iterator[Told]:
        """What is told of windows: first the pose that others steer by, then all else."""
        for result in results:
            self.limited_windows += shedding.candidates is not None
            pose = self._follower.pose(result)
            if pose is not None:
                yield pose
            yield self._update(result, None if pose is None else pose.newest, on_order)
            said = self._mapper.close_loops()
            if said is not None:
                yield Trouble(said.text) if said.trouble else News(said.text)

    def _update(
        self, result: WindowResult, newest: NewestState | None, on_order: bool
    ) -> WindowUpdate:
        if self.journal is not None:
            self.journal.window(self._mapper, result, self._outside())
        if self._spool is not None:
            self._spool.add(result)
        scans = self._follower.new_scans()
        stats, wall = self._mapper.stats(), self._wall()
        stats |= {
            'wall_s': wall,
            'real_time_factor': stats['drive_s'] / wall if wall > 0 else 0.0,
            'peak_rss_mb': peak_rss_mb(),
        }
        memory = sum(scan.stored.memory for scan in scans)
        self.scan_bytes += memory
        self.disk_bytes += sum(scan.stored.nbytes for scan in scans) - memory
        self.cloud_bytes = self._live.nbytes
        points = self._live.placed(scans)
        findings = ranked([*self._mended, *self._mapper.findings])
        if self._earlier is not None:
            known = self._mapper.state.georeferenced
            stats['session'] = 'joined' if known else 'apart'
            findings = findings if known else ranked([self._earlier.apart(False), *findings])
        return WindowUpdate(result, newest, points, stats, findings, on_order)


def journal_folder(config: Config) -> Path | None:
    """Where a node keeps its journals; None where none is wanted.

    Args:
        config: All settings.
    """
    name = config.journal.folder
    if not name and config.save.every > 0.0:
        name = config.save.folder + AUTOSAVE
    return Path(name).expanduser().absolute() if name else None


def _journal(config: Config, mended: Sequence[Finding]) -> Journal | None:
    folder = journal_folder(config)
    if folder is None:
        return None
    facts = InputFacts(TOPICS, TOPICS, {})
    return Journal(folder, config, facts, mended, config.save.every or config.journal.sync)
