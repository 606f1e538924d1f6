"""Measurements in, G(t), poses, map and statistics out: the only place that keeps state."""

import math
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.blas import single_threaded_blas
from incremental_mapper.candidates.spans import ImuStamps
from incremental_mapper.checks.finding import Finding, ranked
from incremental_mapper.checks.outcome import Outcome, outcome_findings
from incremental_mapper.compiled import waiting
from incremental_mapper.config import Config, Strategy, Tree
from incremental_mapper.errors import MapperError
from incremental_mapper.frontend import preprocessing
from incremental_mapper.frontend.front_end import FrontEnd, Preparation, Prepared
from incremental_mapper.frontend.imu_preintegration import (
    EMPTY_SERIES,
    SMOOTHED,
    ImuSeries,
    preintegration_parameters,
)
from incremental_mapper.frontend.lidar_odometry import PreparedScan
from incremental_mapper.map.store import PointStore, make_store
from incremental_mapper.mapping.base_count import BaseCount
from incremental_mapper.mapping.commit import NOTHING, Committed, commit
from incremental_mapper.mapping.failed_windows import FailedWindows
from incremental_mapper.mapping.final_solve import final_values
from incremental_mapper.mapping.georeferencing import georeference, without_fixes
from incremental_mapper.mapping.imu_gate import ImuGate
from incremental_mapper.mapping.imu_intake import ImuIntake
from incremental_mapper.mapping.joining import join, joinable
from incremental_mapper.mapping.judgement import judge_map
from incremental_mapper.mapping.live_closing import LiveLoops, LoopNews, Runner
from incremental_mapper.mapping.live_closing import live as closes_live
from incremental_mapper.mapping.load_shedding import NO_SHEDDING, LoadShedding
from incremental_mapper.mapping.loop_closing import close_loops
from incremental_mapper.mapping.newest_state import NewestState, newest_state
from incremental_mapper.mapping.result import MapResult, WindowResult, fixes_in_map, trajectory_of
from incremental_mapper.mapping.row_archive import RowArchive
from incremental_mapper.mapping.same_stamp import prefer_usable
from incremental_mapper.mapping.scan_intake import ScanIntake
from incremental_mapper.mapping.standstill import Standstill
from incremental_mapper.mapping.statistics import MapStatistics, Totals, map_statistics, window_row
from incremental_mapper.mapping.watch import Watch
from incremental_mapper.mapping.window_buffer import Window, WindowBuffer, joined
from incremental_mapper.measurements import (
    NANOSECONDS,
    Drops,
    ImuSample,
    LidarScan,
    Measurement,
)
from incremental_mapper.selection.bridging import bridged
from incremental_mapper.selection.choice import Choice
from incremental_mapper.selection.strategies import find_strategy
from incremental_mapper.selection.window_problem import pose_problem
from incremental_mapper.selection.window_record import WindowRecord, record_window
from incremental_mapper.settings import to_tree
from incremental_mapper.smoothing import linear_system
from incremental_mapper.smoothing.graph_state import GraphState, recent_scans

IMU = 'imu'
"""Name of the IMU among the sensors."""


@dataclass(frozen=True, slots=True)
class _Frame:
    """A window's bounds (ns), its number of IMU samples, and the seconds of its stages so far."""

    start: int
    end: int
    imu: int
    seconds: dict[str, float]


def _loose(item: Prepared) -> bool:
    """Whether it is a scan without a match to the one before, and none for the next one."""
    return isinstance(item, PreparedScan) and item.previous is None and not item.usable


class Mapper:
    """The method of the paper, one window after the other (Algorithm 1).

    Push measurements in any order that ``window.lateness`` allows; every call returns the
    windows that it completed. ``finish`` closes the rest and returns the whole map. Poses are
    T_map_base: ``map`` is local ENU once the map is georeferenced, ``base_link`` is x forward,
    y left, z up. One thread at a time may use a mapper.
    """

    def __init__(
        self,
        config: Config,
        sensors: Sequence[str] = (),
        predict: bool = False,
        store: PointStore | None = None,
        searches: Runner | None = None,
    ) -> None:
        """Make ready for the first measurement.

        Args:
            config: All settings.
            sensors: Names to wait for from the start; others are waited for once they are seen.
            predict: Wait for no sensor beyond what is usual for it; whoever needs windows soon.
            store: Keeps the points of the scans; None is what ``map.store`` says.
            searches: Runs the search for closed loops beside the windows; without one, loops are
                closed in ``result`` alone.

        Raises:
            ConfigError: The strategy is unknown or cannot be loaded.
            OutputError: ``map.store_folder`` cannot be used.
        """
        self.config = config
        self._strategy = find_strategy(config.selection.strategy)
        self._imu = ImuIntake(config.imu, config.preintegration.gravity)
        self._scans = ScanIntake(config.lidars)
        awaited = [name for name in sensors if name != 'imu' or config.imu.enabled]
        # Closed, and waiting for their scans or to be merged with the next.
        self._held: list[tuple[Window, Preparation]] = []
        self._shedding = NO_SHEDDING
        if store is None:
            store = make_store(config.map)  # may fail, so before any process is started
        self._front_end = FrontEnd(config, IMU in awaited)
        self._buffer = WindowBuffer(
            config.window,
            awaited,
            predict,
            better=prefer_usable(config),
            begin=self._front_end.begin if predict else None,
            sample=self._front_end.imu,
            restart=self._front_end.restart,
        )
        with waiting():  # while the front end's processes start
            preprocessing.warm_up()
            linear_system.warm_up()
            self._strategy.warm_up()
        self._parameters = preintegration_parameters(config.preintegration, config.imu.matrix())
        self._series, self._gate = EMPTY_SERIES, ImuGate()
        self._around = EMPTY_SERIES  # samples before and behind the newest cluster
        self._orientation: NDArray[np.float64] | None = None
        self._carried: list[Prepared] = []
        self._state = GraphState(store=store, recent=recent_scans(config.mom.submap_scans))
        closes = searches is not None and closes_live(config)
        self._loops = LiveLoops(self._state, config, searches) if searches and closes else None
        self._base = BaseCount(round(config.preintegration.max_gap * NANOSECONDS))
        self._totals = Totals()
        self._failed: Drops = Counter()
        self._standstill = Standstill()
        self._failures = FailedWindows()
        self._rows = RowArchive()
        self._watch = Watch(config)
        self._settings = to_tree(config)

    @property
    def state(self) -> GraphState:
        """G(t)."""
        return self._state

    def push(self, measurement: Measurement) -> list[WindowResult]:
        """Take in a measurement and run the windows that it closed.

        Args:
            measurement: A scan, a fix or an inertial sample, with its header stamp.

        Returns:
            The windows that were closed, oldest first; most often none.
        """
        return list(self.advance(measurement))

    def advance(
        self, measurement: Measurement, shedding: LoadShedding = NO_SHEDDING
    ) -> Iterator[WindowResult]:
        """As ``push``, one window at a time: ``newest`` then tells of each.

        Args:
            measurement: A scan, a fix or an inertial sample, with its header stamp.
            shedding: Limits what is spent on the windows.

        Yields:
            The windows that were closed, oldest first.
        """
        self._totals.received[measurement.sensor] += 1
        self._watch.measurement(measurement)
        taken: Measurement | None = measurement
        if isinstance(measurement, ImuSample):
            taken = self._imu.take(measurement)
        elif isinstance(measurement, LidarScan):
            taken = self._scans.take(measurement)
        if taken is not None:
            self._buffer.push(taken)
        newest = self._buffer.newest
        if newest is not None:
            self._front_end.passed(newest)
        self._hold(self._buffer.pop_ready())
        yield from self.go_on(shedding)

    def close_loops(self) -> LoopNews | None:
        """Between two windows: put in closed loops that were found, and search for more.

        Returns:
            What a user is to be told of it, most often nothing.
        """
        return None if self._loops is None else self._loops.step()

    @property
    def waits(self) -> bool:
        """Whether closed windows wait for their scans."""
        return bool(self._held)

    def go_on(self, shedding: LoadShedding = NO_SHEDDING) -> Iterator[WindowResult]:
        """Run the closed windows whose scans are prepared by now.

        Args:
            shedding: Limits what is spent on the windows.

        Yields:
            They, oldest first.
        """
        self._shedding = shedding
        while self._may_run(shedding.windows):
            yield self._run(self._next_window(shedding.windows))

    def flush(self) -> list[WindowResult]:
        """Close and run every open window without waiting for anything late."""
        return list(self.drain())

    def drain(self, shedding: LoadShedding = NO_SHEDDING) -> Iterator[WindowResult]:
        """As ``flush``, one window at a time.

        Args:
            shedding: Limits what is spent on the windows.

        Yields:
            The windows that were open, oldest first.
        """
        self._shedding = shedding
        self._hold(self._buffer.flush())
        while self._held:
            yield self._run(self._next_window(shedding.windows))
        if self._carried:
            last = self._carried[-1].core.stamp
            yield self._window([], _Frame(last, last + 1, 0, {}), force=True)
        self._watch.end()

    def finish(self) -> MapResult:
        """Run what is left and return the whole map."""
        self.flush()
        return self.result()

    @single_threaded_blas()
    def result(self, most: float = math.inf) -> MapResult:
        """The map of all windows so far; the mapper can go on afterwards.

        G(t) is optimised once more for it if ``graph.final_optimization`` says so, and again with
        the loops that the drive closes (``closure``).

        Args:
            most: Where loops are closed while the map grows: pairs of places that are compared now
                at the most, beyond those that were compared already.

        Returns:
            Clusters, factors, values, trajectory, map and statistics.
        """
        values, failed = final_values(self._state, self.config)
        self._totals.solver_failures += int(failed)
        if self._loops is None:
            closed = close_loops(self._state, values, self.config)
        else:
            closed = self._loops.of_all(values, most)
        values = closed.values
        clusters = tuple(self._state.clusters)
        return MapResult(
            clusters=clusters,
            factors=(*self._state.factors.unpacked(), *closed.factors),
            values=values,
            trajectory=trajectory_of(clusters, values),
            scans=tuple(self._state.scans),
            fixes=fixes_in_map(self._state),
            rows=self._rows.all(),
            statistics=closed.counted(self.statistics),
            findings=self._watch.final(
                lambda: judge_map(self._state, values, self.config),
                lambda: outcome_findings(self._outcome()),
                lambda: self._state.store.findings,
            ),
            failed=tuple(self._failures.records),
        )

    def newest(self) -> NewestState | None:
        """Newest pose with covariance and twist, None before the first window; constant cost."""
        return newest_state(self._state, self._around, self.config)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What was found wrong with the measurements so far, the worst first."""
        return ranked(
            [
                *self._watch.findings(),
                *outcome_findings(self._outcome()),
                *self._state.store.findings,
            ]
        )

    @property
    def lasting_findings(self) -> tuple[Finding, ...]:
        """``findings`` without what is judged anew when the map ends: ``judge_map`` has that."""
        return ranked(
            [
                *self._watch.lasting(),
                *outcome_findings(self._outcome()),
                *self._state.store.findings,
            ]
        )

    @property
    def failed_windows(self) -> Sequence[WindowRecord]:
        """The inputs of windows that failed, the first few of them."""
        return self._failures.records

    @property
    def mend(self) -> Tree:
        """Settings that the data proved right against ``config``, empty where there are none.

        They count for a new mapper: whoever has the measurements still, or can do without those
        that were, begins anew with them.
        """
        return self._watch.mend

    @property
    def mended(self) -> tuple[Finding, ...]:
        """The findings that ``mend`` puts right."""
        return self._watch.mended()

    @property
    def drops(self) -> Drops:
        """What was not used, by sensor and reason; any thread may ask."""
        total: Drops = Counter()
        for part in (
            self._buffer.drops,
            self._front_end.drops,
            self._failed,
            self._failures.drops,
            self._imu.drops,
            self._scans.drops,
        ):
            total.update(dict(part))  # a copy in one step: they change meanwhile
        return total

    @property
    def statistics(self) -> MapStatistics:
        """The record of all windows so far; its cost does not grow with the drive."""
        return map_statistics(
            self._settings,
            self._state,
            self._base,
            self._totals,
            drops=self.drops,
            notes=self._front_end.notes,
            late=self._buffer.late,
            unused=[item.core for item in self._carried],
            datum=self._front_end.datum,
        )

    def stats(self) -> dict[str, Any]:
        """``statistics`` as the keys of ``stats.json``, with the loops that are closed by now."""
        statistics = self.statistics
        if self._loops is not None:
            statistics = self._loops.counted(statistics)
        return statistics.to_tree()

    def _outcome(self) -> Outcome:
        notes = self._front_end.notes
        return self._watch.fit.outcome(self._state, self._totals, notes, self._failures.records)

    def close(self) -> None:
        """Let go of processes and threads; nothing may be pushed afterwards."""
        if self._loops is not None:
            self._loops.close()
        self._front_end.close()

    def _hold(self, windows: Sequence[Window]) -> None:
        """Begin to prepare the scans of closed windows."""
        self._held += [(window, self._front_end.start(window.core)) for window in windows]

    def _may_run(self, count: int) -> bool:
        """Whether the oldest ``count`` windows are ready, or have others waiting behind them."""
        if len(self._held) < count:
            return False
        oldest = [preparation for _, preparation in self._held[:count]]
        if any(self._front_end.awaits_imu(preparation) for preparation in oldest):
            return False  # what they get must not depend on how far others have come
        ready = all(preparation.done for preparation in oldest)
        return ready or len(self._held) > count + self._shedding.read_ahead

    def _next_window(self, count: int) -> tuple[Window, list[Preparation]]:
        """The oldest ``count`` windows that wait, as one."""
        taken, self._held = self._held[:count], self._held[count:]
        self._totals.merged_windows += len(taken) - 1
        return joined([window for window, _ in taken]), [begun for _, begun in taken]

    def _run(self, waiting: tuple[Window, Sequence[Preparation]]) -> WindowResult:
        window, begun = waiting
        self._watch.window(window)
        started = time.perf_counter()
        for sample in window.imu:
            self._keep_orientation(sample)
        prepared = [item for part in begun for item in self._front_end.collect(part)]
        turn = self.config.imu.matrix()[:3, :3]
        gated = self._gate.take(self._series.joined(window.imu), prepared, turn)
        self._series = gated.series
        if len(gated.refused.stamps):
            self._failed[IMU, 'contradicted'] += len(gated.refused.stamps)
            self._watch.contradicted(gated.refused.stamps)
        self._watch.prepared(prepared)
        self._watch.fixes(self._front_end.gate)
        stands = self._stands(prepared, self._series.within(window.start, window.end))
        spent = time.perf_counter() - started + sum(part.seconds for part in begun)
        seconds = {'front_end': spent}
        frame = _Frame(window.start, window.end, len(window.imu), seconds)
        if stands and (result := self._join(prepared, frame)) is not None:
            return result
        if stands:
            self._standstill.start_anew()
        return self._window(prepared, frame)

    def _stands(self, prepared: Sequence[Prepared], samples: ImuSeries) -> bool:
        """Whether the vehicle stands, and what it measured may join the newest cluster."""
        selection = self.config.selection
        # The conventional graph, which all others are compared with, has a pose for everything.
        if not selection.join_standing or selection.strategy == Strategy.BASE:
            return False
        state = self._state
        speed = float(np.linalg.norm(state.last_velocity))
        stands = self._standstill.look(prepared, samples, state.last_bias, speed)
        state.creep(self._standstill.crept)
        return stands and not self._carried and joinable(state)

    @single_threaded_blas()
    def _join(self, prepared: Sequence[Prepared], frame: '_Frame') -> WindowResult | None:
        """Let the measurements join the newest cluster; None where a fix contradicts."""
        started = time.perf_counter()
        try:
            error = join(self._state, prepared, self.config)
        except MapperError:
            raise
        except Exception:
            return self._fail(frame, prepared)
        if error is None:
            return None
        max_gap = round(self.config.preintegration.max_gap * NANOSECONDS)
        self._base.add_window(prepared, ImuStamps(self._series.stamps, max_gap))
        self._totals.standing_windows += 1
        self._totals.joined += len(prepared)
        self._grown()
        frame.seconds['append'] = time.perf_counter() - started
        return self._close(frame, prepared, None, Committed((), error), joined=len(prepared))

    def _grown(self) -> None:
        """After G(t) took a window in."""
        self._totals.solver_failures += int(not self._state.prior.healthy)
        self._georeference()
        # Samples after the last cluster stamp belong to the next window.
        frontier, self._around = self._state.frontier, self._series
        # The change of a turn at a sample is told by those around it.
        unused = min(frontier.head_stamp, frontier.newest_stamp)
        self._series = self._series.since(unused - SMOOTHED)
        self._watch.grown(self._state)

    def _keep_orientation(self, sample: ImuSample) -> None:
        if self._orientation is None and sample.orientation is not None:
            self._orientation = sample.orientation

    @single_threaded_blas()
    def _window(
        self,
        prepared: Sequence[Prepared],
        frame: '_Frame',
        force: bool = False,
    ) -> WindowResult:
        """Choose and append; measurements that no candidate connects are carried on."""
        items = sorted([*self._carried, *prepared], key=lambda item: item.core)
        if not items:
            return self._close(frame, items, None)
        started = time.perf_counter()
        try:
            problem = pose_problem(
                items,
                self._state,
                self._series,
                self._orientation,
                self._parameters,
                self.config,
                self._shedding.candidates,
            )
            frame.seconds['candidates'] = time.perf_counter() - started
            choice = self._strategy.select(problem)
        except MapperError:
            raise
        # The libraries below and strategies of users raise what they like: it costs this window.
        except Exception:
            return self._fail(frame, items)
        self._base.add_window(prepared, problem.imu)
        if choice.winner is None:
            waited = (items[-1].core.stamp - items[0].core.stamp) / NANOSECONDS
            if not force and waited < self.config.window.max_carry:
                self._carried = items
                return self._close(frame, items, choice)
            loose = [item for item in items if _loose(item)]
            if self._state.clusters and loose:
                # A guess may hold a scan that others are matched to, not one that tells nothing.
                self._failed.update((item.core.sensor, 'unmatched') for item in loose)
                self._carried = [item for item in items if not _loose(item)]
                return self._window([], frame, force)
            newest = self._state.frontier.newest
            pose = None if newest is None else self._state.pose(newest)
            choice = bridged(choice, problem, pose)
            self._totals.bridges += len(choice.extra)
        self._carried = []
        started = time.perf_counter()
        committed = commit(self._state, self._totals.windows, choice, problem)
        self._grown()
        frame.seconds['append'] = time.perf_counter() - started
        return self._close(frame, items, choice, committed)

    def _georeference(self) -> None:
        """Keep to the fixes that hold, and lay the map into ENU once they tell how it lies."""
        gate = self._front_end.gate
        refuted = gate.refuted
        if refuted:
            moved = self._front_end.refound(refuted)
            without_fixes(self._state, self.config, refuted, moved)
        if gate.certain:
            georeference(self._state, self.config)

    def _fail(self, frame: '_Frame', items: Sequence[Prepared]) -> WindowResult:
        """Leave out a window whose choice raised; G(t-1) is as it was."""
        window = self._totals.windows

        def record(raised: str) -> WindowRecord:
            return record_window(
                window,
                raised,
                items,
                self._state,
                self._series,
                self._orientation,
                self.config,
                self._shedding.candidates,
            )

        self._failures.add(window, (frame.start, frame.end), items, record)
        self._totals.failed_windows = self._failures.count
        self._carried = []
        return self._close(frame, items, None)

    def _close(
        self,
        frame: '_Frame',
        items: Sequence[Prepared],
        choice: Choice | None,
        committed: Committed = NOTHING,
        joined: int = 0,
    ) -> WindowResult:
        """Record a window's numbers."""
        totals, seconds = self._totals, frame.seconds
        placed, error = committed.placed, committed.error
        for stage, spent in (choice.seconds if choice else {}).items():
            seconds[stage] = seconds.get(stage, 0.0) + spent
        if choice is not None:
            totals.add_choice(choice)
        totals.solver_error += error
        totals.add_seconds(seconds)
        core = [item.core for item in items]
        if core:
            totals.add_stamps(core[0].stamp, core[-1].stamp)
        row = window_row(
            totals.windows, (frame.start, frame.end), core, frame.imu, choice, error, seconds
        )
        self._rows.add(row)
        totals.windows += 1
        return WindowResult(
            index=totals.windows - 1,
            start=frame.start,
            end=frame.end,
            winner=None if choice is None or not placed else choice.winner,
            clusters=placed,
            poses=tuple(self._state.pose(item.id) for item in placed),
            row=row,
            joined=joined,
            tried=() if choice is None else choice.tried,
        )
