"""The one thread that owns the mapper: measurements and orders in, updates out."""

import contextlib
import threading
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Iterator

from incremental_mapper.checks.finding import Finding, ranked
from incremental_mapper.checks.fix_shape import without_consequences
from incremental_mapper.config import Config, SaveSettings
from incremental_mapper.datasets.sectors import SectorGatherer
from incremental_mapper.datasets.sensor_settings import with_settings
from incremental_mapper.errors import MapperError
from incremental_mapper.garbage import set_aside
from incremental_mapper.mapping.beginning import Beginning
from incremental_mapper.measurements import Drops, LidarScan, Measurement
from incremental_mapper.results.mending import MOST_MENDS
from incremental_mapper.results.sessions.going_on import earlier_map
from incremental_mapper.ros.clock_steps import step_findings
from incremental_mapper.ros.inbox import Command, Deadline, Inbox, Order, Renewal
from incremental_mapper.ros.left_over import LeftOver
from incremental_mapper.ros.map_session import FAILED, MapSession, Told
from incremental_mapper.ros.saves import Saves
from incremental_mapper.ros.saving import Snapshot
from incremental_mapper.ros.time_jumps import JumpFilter
from incremental_mapper.ros.updates import Reply, Restarted, Retimed, Trouble, Update, WindowUpdate
from incremental_mapper.settings import as_it_was, make_config, merge, to_tree

SHUTDOWN = 'shutdown'
"""Why a measurement was lost that waited when the time to stop was over."""
LOOK = 0.001
"""Seconds between two looks whether the scans of a closed window are prepared: they take some
milliseconds, and so long its pose waits."""
SWITCH = 0.0005
"""Seconds for which a thread may keep Python's lock where another one waits for it. Of Python's own
5 ms each message and each pose that is published would wait several times, beside a worker that
computes."""
RETRY = 5.0
"""Seconds between two attempts to begin a map where the last one failed."""
NO_MAP = 'there is no map: none could be begun; the log says why'
MENDED = 'before_mend'
"""Why a measurement was lost that a map held whose settings proved wrong."""
OF_STAMPS = 'clock_offset'
"""The rule of findings that put right nothing but stamps."""


class Worker:
    """Runs the mapper in a thread of its own; ``emit`` takes the updates, in that thread.

    Whatever the mapper raises is counted in ``failures`` and logged, what it had is saved if that
    is wanted, and a new map begins. Where even that fails the worker goes on without a map:
    measurements are counted as lost, orders are answered, and it tries again. Only the first map
    must be possible: what the constructor raises is let through.

    Measurements come as their messages are, and are put right by ``config`` here: where the data
    prove a setting wrong, a new map begins with what they prove right, from its first measurement
    on if that is not long ago. That happens ``MOST_MENDS`` times.

    Any thread may read ``failures`` and the figures of the map.
    """

    def __init__(self, config: Config, emit: Callable[[Update], None]) -> None:
        # Once: a map before may be large, and every map of this node goes on from it.
        self._earlier = earlier_map(config)
        if self._earlier is not None:
            tree = merge(to_tree(config), self._earlier.settings)
            config = make_config(tree, str(config.session.folder))
        self.config = config
        self._given = to_tree(config)
        self.inbox = Inbox(config.queue)
        self.jumps = JumpFilter(config.time_jump)
        self.outside_drops: Callable[[], Drops] = Drops
        self.outside_findings: Callable[[], tuple[Finding, ...]] = tuple
        self.graph_span = config.graph.markers_span
        self.failures = 0
        self._lost: Drops = Counter()
        self._emit = emit
        self._thread = threading.Thread(target=self._run, name='mapper', daemon=True)
        self._deadline: Deadline | None = None
        self._retry = Deadline(0.0)
        self._beginning = Beginning()
        self._sectors: dict[str, SectorGatherer] = {}
        self._mends = 0
        self._known: tuple[Finding, ...] = ()  # what the settings put right by now
        self.saves = Saves(emit, lambda: self.save_settings())
        self.save_settings: Callable[[], SaveSettings] = lambda: config.save
        self._left_over = LeftOver(config, emit)
        self._session: MapSession | None = self._new_session()

    def start(self) -> None:
        """Start the thread, and what is made of journals of before."""
        self._thread.start()
        self._left_over.start()

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
        """What was lost between the callbacks and the mapper, by sensor and reason."""
        return self.outside_drops() + self.inbox.drops() + self.jumps.drops + self._lost

    def all_drops(self) -> Drops:
        """The same with what the mapper itself did not use, of this map."""
        session = self._session
        return self.drops() if session is None else self.drops() + session.drops

    @property
    def clock_steps(self) -> tuple[Finding, ...]:
        """Sensors whose clock stepped while the others' did not."""
        config = self.config
        sensors = {**config.lidars, 'imu': config.imu, 'gnss': config.gnss}
        offsets = {name: sensor.time_offset for name, sensor in sensors.items()}
        return step_findings(self.jumps.steps, offsets)

    @property
    def has_map(self) -> bool:
        """Whether measurements are mapped; not so where no map could be begun."""
        return self._session is not None

    @property
    def limited_windows(self) -> int:
        """Windows of this map for which fewer candidates were tried: measurements came too fast."""
        session = self._session
        return 0 if session is None else session.limited_windows

    @property
    def scan_bytes(self) -> int:
        """What this map's scans take of the memory."""
        session = self._session
        return 0 if session is None else session.scan_bytes

    @property
    def disk_bytes(self) -> int:
        """What this map's scans take of a disk."""
        session = self._session
        return 0 if session is None else session.disk_bytes

    @property
    def journal_figures(self) -> tuple[int, int]:
        """Bytes of this map's journal, and windows that are not in it."""
        journal = None if self._session is None else self._session.journal
        return (0, 0) if journal is None else (journal.nbytes, journal.missing)

    @property
    def cloud_bytes(self) -> int:
        """What this map's voxels take."""
        session = self._session
        return 0 if session is None else session.cloud_bytes

    def _run(self) -> None:
        set_aside()
        try:
            while self._serve():
                pass
        finally:
            if self._session is not None:
                self._session.close()

    def _serve(self) -> bool:
        """Wait for work and do it; returns whether more may come."""
        session = self._session
        item, views = self.inbox.take(LOOK if session is not None and session.waits else None)
        with self._guarded():
            if item is None and session is not None:
                self._tell(session.go_on(self.inbox.shedding()))
            for view in sorted(views):
                if self._session is not None:
                    self._emit(self._session.view(view, self.graph_span))
        if isinstance(item, Command):
            if item.order is Order.STOP:
                self._finish()
                return False
            reply: Reply | None = Reply(item.ticket, False, 'the mapper failed; the log says how')
            with self._guarded():
                reply = self._obey(item)
            if reply is not None:
                self._emit(reply)
        elif isinstance(item, Renewal):
            self._renew(item)
        elif item is not None and self._too_late():
            self.inbox.count(item, SHUTDOWN)
            self.inbox.clear(SHUTDOWN)
        elif item is not None:
            self._take_in(item)
        return True

    @contextlib.contextmanager
    def _guarded(self) -> Iterator[None]:
        """Where the block raises, tell of it and begin a new map."""
        try:
            yield
        # The libraries below raise what they like; a map is not worth the node's life.
        except Exception:
            self._fail()
            self._begin('the mapper failed')

    def _fail(self, last: bool = False) -> None:
        """Tell of the exception and keep what was mapped before it, as far as it can be had."""
        self.failures += 1
        self._emit(Trouble(f'the mapper failed:\n{traceback.format_exc()}'))
        if self._session is not None:
            # Anything may be missing from the state of a mapper that failed.
            with contextlib.suppress(Exception):
                self._lost = self._lost + self._session.in_no_cluster()
        self._save_quietly(last)

    def _begin(self, reason: str) -> str | None:
        """Leave the map for a new one; returns why there is none, if so."""
        before, self._session = self._session, None
        if before is not None:
            self._emit(Restarted(reason, self.config, self._known))
        self._beginning, self._sectors = Beginning(), {}
        try:
            if before is not None:
                before.close()
            self._session = self._new_session()
        except Exception as error:
            self.failures += 1
            self._retry = Deadline(RETRY)
            why = str(error) if isinstance(error, MapperError) else traceback.format_exc()
            self._emit(
                Trouble(f'no new map can begin, measurements are left out until one can: {why}')
            )
            return f'no new map can begin: {error}'
        return None

    def _new_session(self) -> MapSession:
        return MapSession(self.config, self._known, self.drops, self._earlier)

    def _too_late(self) -> bool:
        return self._deadline is not None and self._deadline.passed()

    def _renew(self, renewal: Renewal) -> None:
        """Begin a new map with other settings, and map again what is still at hand."""
        kept = without_consequences(self._known, renewal.findings)
        tree = to_tree(self.config)
        for finding in self._known:
            if finding not in kept:
                tree = merge(tree, as_it_was(self._given, finding.settings))
        try:
            self.config = make_config(merge(tree, renewal.settings), 'proved settings')
        except MapperError as error:
            self._emit(Trouble(f'{renewal.reason}; the settings stay: {error}'))
            return
        self._known = ranked([*kept, *renewal.findings])
        again = self._beginning.whole()
        if again is None and (self._retimed(renewal) or self._goes_on(renewal)):
            return
        # What nothing proves wrong only lacks a sensor, or has it at another place.
        saved = again is None and not renewal.findings and bool(self.save_settings().on_shutdown)
        if saved:
            with self._guarded():
                self._drain()
                self._save_quietly()
        elif again is None and self._session is not None:
            with self._guarded():
                self._lost = self._lost + self._session.taken(MENDED)
        self.jumps.restart()
        if self._session is None:
            self._emit(Restarted('', self.config, self._known))
        elif not saved:
            self._session.discard()
        # Before its first measurement nobody need know that there was another map.
        self._begin('' if again == () else renewal.reason)
        for measurement in again or ():
            if self._too_late():
                self.inbox.count(measurement, SHUTDOWN)
            else:
                self._take_in(measurement)

    def _goes_on(self, renewal: Renewal) -> bool:
        """Keep the map where other settings are not worth it; the next one has them."""
        if self._session is None or not renewal.optional:
            return False
        self._emit(
            Trouble(
                f'{renewal.reason}; the map goes on as it began, since it is too long to be mapped '
                'again: call reset for a new one that is made with that'
            )
        )
        return True

    def _retimed(self, renewal: Renewal) -> bool:
        """Go on with the map where other settings are other stamps of some sensors, no more.

        What such a sensor measured until now was not used, or told nothing wrong of the others: a
        long map is worth more than its share of it.
        """
        session = self._session
        only_stamps = {finding.rule for finding in renewal.findings} == {OF_STAMPS}
        if session is None or not only_stamps:
            return False
        self.jumps.forget({finding.sensor for finding in renewal.findings})
        session.mended_since(renewal.findings)
        self._emit(Retimed(renewal.reason, self.config))
        return True

    def _mend(self) -> None:
        """Begin anew where the map's data prove a setting wrong."""
        session = self._session
        if session is None or not session.mend or self._mends >= MOST_MENDS:
            return
        self._mends += 1
        reason = '; '.join(finding.line() for finding in session.mended)
        self._renew(Renewal(session.mend, reason, session.mended))

    def _take_in(self, raw: Measurement) -> None:
        measurement = self._gathered(with_settings(raw, self.config))
        if measurement is None:
            self._beginning.add(raw)
            return
        passed = self.jumps.check(measurement)
        if passed.jumped:
            with self._guarded():
                self._drain()
                self._save_quietly()
                self._begin('stamps jumped')
        if passed.jumped:
            self._beginning.forget()  # the witnesses of the jump came before
        self._beginning.add(raw)
        for item in passed.measurements:
            self._map(item)
        self._mend()

    def _map(self, measurement: Measurement) -> None:
        if self._session is None and self._retry.passed():
            self._begin('another attempt')
        if self._session is None:
            self._lost = self._lost + Counter({(measurement.sensor, FAILED): 1})
            return
        with self._guarded():
            self._tell(self._session.advance(measurement, self.inbox.shedding()))

    def _gathered(self, measurement: Measurement) -> Measurement | None:
        """A whole sweep where a LiDAR sends parts of them; None until there is one."""
        lidar = self.config.lidars.get(measurement.sensor)
        if lidar is None or not lidar.sectors or not isinstance(measurement, LidarScan):
            return measurement
        gatherer = self._sectors.setdefault(measurement.sensor, SectorGatherer())
        return gatherer.take(measurement)

    def _drain(self) -> int:
        """Close all windows; returns how many."""
        for item in self.jumps.settle():
            self._map(item)
        for gatherer in self._sectors.values():
            sweep = gatherer.finish()
            if sweep is not None:
                self._map(sweep)
        return 0 if self._session is None else self._tell(self._session.drain())

    def _tell(self, updates: Iterable[Told]) -> int:
        """Tell of windows; returns of how many."""
        count = 0
        for update in updates:
            self._emit(update)
            count += isinstance(update, WindowUpdate)
        return count

    def _finish(self) -> None:
        try:
            self._drain()
        except Exception:
            self._fail(last=True)
        else:
            self._save_quietly(last=True)
        self.saves.finish()
        journal = None if self._session is None else self._session.journal
        if journal is not None and journal.holds_map:
            self._emit(Trouble(f'not saved elsewhere{journal.kept()}'))

    def _obey(self, command: Command) -> Reply | None:
        """Do what is ordered; returns the reply, unless it comes later or nobody waits for one."""
        if command.order is Order.RESET:
            self.jumps.restart()
            if self._session is not None:
                self._session.discard()
            trouble = self._begin('asked to')
            return Reply(command.ticket, trouble is None, trouble or 'a new map begins')
        if self._session is None:
            return Reply(command.ticket, False, NO_MAP)
        if command.order is Order.FLUSH:
            return Reply(command.ticket, True, f'{self._drain()} windows closed')
        self.saves.asked(command, self._snapshot(self._session))
        return None

    def _snapshot(self, session: MapSession) -> Snapshot:
        return session.snapshot(self.drops(), self.outside_findings())

    def _save_quietly(self, last: bool = False) -> None:
        """Save where the settings want a map saved that ends; whatever fails is told."""
        if self._session is None:
            if last:
                self.saves.nothing()
            return
        try:
            self.saves.ends(self._snapshot(self._session), last)
        # Anything may be missing from the state of a mapper that failed.
        except Exception:
            self.saves.failed += 1
            self._emit(Trouble(f'saving failed:\n{traceback.format_exc()}'))
