"""The one thread that owns the mapper: measurements and orders in, updates out."""

import contextlib
import threading
import time
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.config import Config
from incremental_mapper.errors import MapperError
from incremental_mapper.mapping.load_shedding import NO_SHEDDING, LoadShedding
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.mapping.result import NewestState, WindowResult
from incremental_mapper.mapping.statistics import peak_rss_mb
from incremental_mapper.measurements import Drops, Measurement
from incremental_mapper.results.run_statistics import InputFacts
from incremental_mapper.ros.inbox import Command, Deadline, Inbox, Order, View
from incremental_mapper.ros.live_map import GraphView, LiveMap, PathView
from incremental_mapper.ros.saving import save_map
from incremental_mapper.ros.subscriptions import GNSS, IMU
from incremental_mapper.ros.time_jumps import JumpFilter
from incremental_mapper.smoothing.graph_state import PlacedScan

SHUTDOWN, FAILED = 'shutdown', 'mapper_failed'


@dataclass(frozen=True, slots=True, eq=False)
class WindowUpdate:
    """A window's result.

    ``newest`` and ``T_odom_base`` are None where the window appended nothing; ``points`` (N, 3)
    are its new points in the map; ``stats`` the keys of stats.json so far.
    """

    result: WindowResult
    newest: NewestState | None
    T_odom_base: gtsam.Pose3 | None
    points: NDArray[np.float64]
    stats: dict[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class ViewUpdate:
    """A view that was asked for; the map is (N, 3) float32 metres."""

    view: View
    content: NDArray[np.float32] | PathView | GraphView
    stamp: int


@dataclass(frozen=True, slots=True)
class Reply:
    """What came of an order."""

    ticket: int
    success: bool
    message: str


@dataclass(frozen=True, slots=True)
class Restarted:
    """The map begins anew; what was published of the old one no longer holds."""

    reason: str


@dataclass(frozen=True, slots=True)
class Trouble:
    """Something that a log must tell of."""

    message: str


Update: TypeAlias = WindowUpdate | ViewUpdate | Reply | Restarted | Trouble


class Worker:
    """Runs the mapper in a thread of its own; ``emit`` takes the updates, in that thread.

    ``failures`` counts how often the mapper raised, ``limited_windows`` the windows of this map
    for which fewer candidates were tried because measurements came too fast, ``scan_bytes`` and
    ``cloud_bytes`` what this map's scans and its voxels take. Any thread may read them.
    """

    def __init__(self, config: Config, emit: Callable[[Update], None]) -> None:
        self.config = config
        self.inbox = Inbox(config.queue)
        self.jumps = JumpFilter(config.time_jump)
        self.outside_drops: Callable[[], Drops] = Drops
        self.graph_span = config.graph.markers_span
        self.failures = 0
        self._lost: Drops = Counter()
        self._emit = emit
        self._sensors = [*config.lidars, IMU, GNSS]
        self._thread = threading.Thread(target=self._run, name='mapper', daemon=True)
        self._deadline: Deadline | None = None
        self._begin()

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def begin_stop(self, seconds: float) -> None:
        """Map what waits for at most ``seconds``, close the windows, save if wanted, end."""
        self._deadline = Deadline(seconds)
        self.inbox.put(Command(Order.STOP))

    def running(self) -> bool:
        """Whether the thread has not ended."""
        return self._thread.is_alive()

    def join(self) -> None:
        """Wait for the end."""
        self._thread.join()

    def drops(self) -> Drops:
        """What was lost between the callbacks and the mapper."""
        return self.outside_drops() + self.inbox.drops() + self.jumps.drops + self._lost

    def _begin(self) -> None:
        self._mapper = Mapper(self.config, self._sensors)
        self._live = LiveMap(self._mapper)
        self._started: float | None = None
        self._odom = gtsam.Pose3()
        self._last_cluster: int | None = None
        self._scans = 0
        self.limited_windows = self.scan_bytes = self.cloud_bytes = 0

    def _run(self) -> None:
        try:
            self._serve()
        finally:
            self._mapper.close()

    def _serve(self) -> None:
        while True:
            item, views = self.inbox.take()
            try:
                for view in sorted(views):
                    self._emit(self._view(view))
                if isinstance(item, Command):
                    if item.order is Order.STOP:
                        self._finish()
                        return
                    self._emit(self._obey(item))
                elif item is not None and self._too_late():
                    self.inbox.count(item, SHUTDOWN)
                    self.inbox.clear(SHUTDOWN)
                elif item is not None:
                    self._take_in(item)
            # The libraries below raise what they like; a map is not worth the node's life.
            except Exception:
                self._fail()
                if isinstance(item, Command):
                    self._emit(Reply(item.ticket, False, 'the mapper failed; the log says how'))
                    if item.order is Order.STOP:
                        return
                self._restart('the mapper failed')

    def _fail(self) -> None:
        """Tell of the exception and keep what was mapped before it, as far as it can be had."""
        self.failures += 1
        self._emit(Trouble(f'the mapper failed:\n{traceback.format_exc()}'))
        # Anything may be missing from the state of a mapper that failed.
        with contextlib.suppress(Exception):
            self._lost = self._lost + self._in_no_cluster()
        self._save_quietly()

    def _in_no_cluster(self) -> Drops:
        """Core measurements that the mapper took in and has neither used nor counted."""
        stats, lost = self._mapper.stats(), Counter[tuple[str, str]]()
        for sensor, count in stats['received'].items():
            if sensor != IMU:
                lost[sensor, FAILED] = count - sum(stats['dropped'].get(sensor, {}).values())
        for placed in self._mapper.state.clusters:
            lost.subtract((core.sensor, FAILED) for core in placed.cluster.members)
        return +lost

    def _too_late(self) -> bool:
        return self._deadline is not None and self._deadline.passed()

    def _take_in(self, measurement: Measurement) -> None:
        passed = self.jumps.check(measurement)
        if passed.jumped:
            self._flush(NO_SHEDDING)
            self._save_quietly()
            self._restart('stamps jumped backwards')
        for item in passed.measurements:
            if self._started is None:
                self._started = time.perf_counter()
            shedding = self.inbox.shedding()
            for result in self._mapper.advance(item, shedding):
                self.limited_windows += shedding.candidates is not None
                self._tell(result)

    def _flush(self, shedding: LoadShedding) -> int:
        results = 0
        for result in self._mapper.drain(shedding):
            self._tell(result)
            results += 1
        return results

    def _finish(self) -> None:
        self._flush(NO_SHEDDING)
        self._save_quietly()

    def _restart(self, reason: str) -> None:
        self._mapper.close()
        self._begin()
        self._emit(Restarted(reason))

    def _obey(self, command: Command) -> Reply:
        if command.order is Order.FLUSH:
            count = self._flush(NO_SHEDDING)
            return Reply(command.ticket, True, f'{count} windows closed')
        if command.order is Order.RESET:
            self.jumps.restart()
            self._restart('asked to')
            return Reply(command.ticket, True, 'a new map begins')
        try:
            place = self._save(Path(self.config.save.folder))
        except MapperError as error:
            return Reply(command.ticket, False, str(error))
        # A folder that could not be written is no reason to lose the map.
        except Exception:
            self._emit(Trouble(f'saving failed:\n{traceback.format_exc()}'))
            return Reply(command.ticket, False, 'saving failed; the log says how')
        return Reply(command.ticket, True, f'saved to {place}')

    def _save_quietly(self) -> None:
        folder = self.config.save.on_shutdown
        if not folder:
            return
        try:
            place = self._save(Path(folder))
        except MapperError as error:
            self._emit(Trouble(str(error)))
        # As in _fail, or where the folder's pictures cannot be drawn.
        except Exception:
            self._emit(Trouble(f'saving failed:\n{traceback.format_exc()}'))
        else:
            self._emit(Trouble(f'saved to {place}'))

    def _save(self, folder: Path) -> Path:
        counts = dict(self._mapper.stats()['received'])
        facts = InputFacts('ROS topics', 'ROS topics', counts)
        saved = save_map(folder, self._mapper, self.drops(), self._wall(), facts)
        if saved.note is not None:
            self._emit(Trouble(saved.note))
        return saved.folder

    def _wall(self) -> float:
        return 0.0 if self._started is None else time.perf_counter() - self._started

    def _tell(self, result: WindowResult) -> None:
        self._live.follow()
        stats, wall = self._mapper.stats(), self._wall()
        stats |= {
            'wall_s': wall,
            'real_time_factor': stats['drive_s'] / wall if wall > 0 else 0.0,
            'peak_rss_mb': peak_rss_mb(),
        }
        newest = self._mapper.newest() if result.clusters else None
        odom = None if newest is None else self._move_odom(newest)
        scans = self._new_scans()
        self.scan_bytes += sum(scan.stored.nbytes for scan in scans)
        self.cloud_bytes = self._live.nbytes
        points = self._live.placed(scans)
        self._emit(WindowUpdate(result, newest, odom, points, stats))

    def _new_scans(self) -> Sequence[PlacedScan]:
        scans = self._mapper.state.scans
        before, self._scans = self._scans, len(scans)
        return scans[before:]

    def _move_odom(self, newest: NewestState) -> gtsam.Pose3:
        """The pose in the odometry frame: moved by what one estimate says of the last step.

        Corrections of the map move both ends of the step, so the pose does not jump with them.
        """
        state = self._mapper.state
        if self._last_cluster is None:
            self._odom = newest.pose
        else:
            self._odom = self._odom.compose(state.pose(self._last_cluster).between(newest.pose))
        self._last_cluster = state.frontier.newest
        return self._odom

    def _view(self, view: View) -> ViewUpdate:
        stamp = self._mapper.state.frontier.newest_stamp
        if view is View.MAP:
            return ViewUpdate(view, self._live.points(), stamp)
        if view is View.PATH:
            return ViewUpdate(view, self._live.path(), stamp)
        return ViewUpdate(view, self._live.graph(self.graph_span), stamp)
