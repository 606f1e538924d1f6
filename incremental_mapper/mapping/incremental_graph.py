"""G(t-1) and a window in, G(t) out: one step of the method, with what lasts from step to step."""

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.blas import single_threaded_blas
from incremental_mapper.candidates.spans import ImuStamps
from incremental_mapper.config import Config
from incremental_mapper.config import Strategy as StrategyName
from incremental_mapper.errors import MapperError
from incremental_mapper.frontend.front_end import FrontEnd, Prepared
from incremental_mapper.frontend.imu_preintegration import (
    EMPTY_SERIES,
    SMOOTHED,
    ImuSeries,
    preintegration_parameters,
)
from incremental_mapper.frontend.prepared_scan import PreparedScan
from incremental_mapper.map.store import PointStore
from incremental_mapper.mapping.base_count import BaseCount
from incremental_mapper.mapping.commit import NOTHING, Committed, commit
from incremental_mapper.mapping.failed_windows import FailedWindows
from incremental_mapper.mapping.fix_pulls import FixPulls
from incremental_mapper.mapping.georeferencing import georeference, without_fixes
from incremental_mapper.mapping.imu_gate import ImuGate
from incremental_mapper.mapping.imu_pushes import ImuPushes
from incremental_mapper.mapping.joining import join, joinable
from incremental_mapper.mapping.measurement_intake import IMU, ClosedWindow
from incremental_mapper.mapping.newest_state import NewestState, newest_state
from incremental_mapper.mapping.result import WindowResult
from incremental_mapper.mapping.row_archive import RowArchive
from incremental_mapper.mapping.standstill import Standstill
from incremental_mapper.mapping.statistics import Totals, window_row
from incremental_mapper.mapping.watch import Watch
from incremental_mapper.measurements import NANOSECONDS, Drops, ImuSample
from incremental_mapper.selection.bridging import bridged
from incremental_mapper.selection.choice import Choice
from incremental_mapper.selection.strategies import Strategy
from incremental_mapper.selection.window_problem import WindowProblem, pose_problem
from incremental_mapper.selection.window_record import WindowRecord, record_window
from incremental_mapper.smoothing.graph_state import GraphState, recent_scans


@dataclass(frozen=True, slots=True)
class _Frame:
    """A window's bounds (ns), its number of IMU samples, and the seconds of its stages so far.

    Of its connected candidates at most ``candidates`` are solved; None solves all.
    """

    start: int
    end: int
    imu: int
    candidates: int | None
    seconds: dict[str, float]


def _loose(item: Prepared) -> bool:
    """Whether it is a scan without a match to the one before, and none for the next one."""
    return isinstance(item, PreparedScan) and item.previous is None and not item.usable


class IncrementalGraph:
    """Takes the windows in one after the other (Algorithm 1).

    ``state`` is G(t), ``totals`` and ``rows`` are the numbers of its windows, ``base`` is what the
    conventional graph of the same windows would have, ``failures`` the windows that failed,
    ``carried`` the core measurements that wait for a window that connects them, and ``drops``
    counts what was not used.
    """

    def __init__(
        self,
        config: Config,
        strategy: Strategy,
        store: PointStore,
        front_end: FrontEnd,
        watch: Watch,
    ) -> None:
        """Begin with an empty graph.

        Args:
            config: All settings.
            strategy: Chooses a window's candidate.
            store: Keeps the points of the scans.
            front_end: Prepares the windows' measurements.
            watch: Looks at the measurements and at the map.
        """
        self._config = config
        self._strategy = strategy
        self._front_end = front_end
        self._watch = watch
        self._parameters = preintegration_parameters(config.preintegration, config.imu.matrix())
        self._series, self._gate = EMPTY_SERIES, ImuGate()
        self._pushes = ImuPushes(config.imu.matrix())
        self._pulls = FixPulls(config.gnss.matrix()[:3, 3])
        watch.pushes, watch.drawn = self._pushes.told, self._pulls.told
        self._around = EMPTY_SERIES  # samples before and behind the newest cluster
        self._orientation: NDArray[np.float64] | None = None
        self._standstill = Standstill()
        self.state = GraphState(store=store, recent=recent_scans(config.mom.submap_scans))
        self.carried: list[Prepared] = []
        self.base = BaseCount(round(config.preintegration.max_gap * NANOSECONDS))
        self.totals = Totals()
        self.rows = RowArchive()
        self.failures = FailedWindows()
        self.drops: Drops = Counter()

    def take(self, closed: ClosedWindow, candidates: int | None) -> WindowResult:
        """Take a window in: its measurements join the newest cluster, or a candidate is chosen.

        Args:
            closed: The window; scans that are not prepared yet are waited for.
            candidates: Of its connected candidates at most so many are solved; None solves all.

        Returns:
            What became of it.
        """
        window, begun = closed.window, closed.begun
        self.totals.merged_windows += len(begun) - 1
        self._watch.window(window)
        started = time.perf_counter()
        for sample in window.imu:
            self._keep_orientation(sample)
        prepared = [item for part in begun for item in self._front_end.collect(part)]
        turn = self._config.imu.matrix()[:3, :3]
        gated = self._gate.take(self._series.joined(window.imu), prepared, turn)
        self._series = self._pushes.take(gated.series, prepared)
        self.totals.doubted_imu = self._pushes.told.seconds
        if len(gated.refused.stamps):
            self.drops[IMU, 'contradicted'] += len(gated.refused.stamps)
            self._watch.contradicted(gated.refused.stamps)
        self._watch.prepared(prepared)
        self._watch.fixes(self._front_end.gate)
        stands = self._stands(prepared, self._series.within(window.start, window.end))
        spent = time.perf_counter() - started + sum(part.seconds for part in begun)
        seconds = {'front_end': spent}
        frame = _Frame(window.start, window.end, len(window.imu), candidates, seconds)
        if stands and (result := self._join(prepared, frame)) is not None:
            return result
        if stands:
            self._standstill.start_anew()
        return self._choose(prepared, frame)

    def end(self, candidates: int | None) -> WindowResult | None:
        """Bridge to what still waits for a window that connects it: none will come.

        Args:
            candidates: Of the connected candidates at most so many are solved; None solves all.

        Returns:
            What became of it; None where nothing waits.
        """
        if not self.carried:
            return None
        last = self.carried[-1].core.stamp
        return self._choose([], _Frame(last, last + 1, 0, candidates, {}), force=True)

    def newest(self) -> NewestState | None:
        """Newest pose with covariance and twist, None before the first window; constant cost."""
        return newest_state(self.state, self._around, self._config)

    def _stands(self, prepared: Sequence[Prepared], samples: ImuSeries) -> bool:
        """Whether the vehicle stands, and what it measured may join the newest cluster."""
        selection = self._config.selection
        # The conventional graph, which all others are compared with, has a pose for everything.
        if not selection.join_standing or selection.strategy == StrategyName.BASE:
            return False
        state = self.state
        speed = float(np.linalg.norm(state.last_velocity))
        stands = self._standstill.look(prepared, samples, state.last_bias, speed)
        state.creep(self._standstill.crept)
        return stands and not self.carried and joinable(state)

    @single_threaded_blas()
    def _join(self, prepared: Sequence[Prepared], frame: _Frame) -> WindowResult | None:
        """Let the measurements join the newest cluster; None where a fix contradicts."""
        started = time.perf_counter()
        try:
            error = join(self.state, prepared, self._config, self._series.stamps)
        except MapperError:
            raise
        except Exception:
            return self._fail(frame, prepared)
        if error is None:
            return None
        max_gap = round(self._config.preintegration.max_gap * NANOSECONDS)
        self.base.add_window(prepared, ImuStamps(self._series.stamps, max_gap))
        self.totals.standing_windows += 1
        self.totals.joined += len(prepared)
        self._grown()
        frame.seconds['append'] = time.perf_counter() - started
        return self._close(frame, prepared, None, Committed((), error), joined=len(prepared))

    @single_threaded_blas()
    def _choose(
        self,
        prepared: Sequence[Prepared],
        frame: _Frame,
        force: bool = False,
    ) -> WindowResult:
        """Choose and append; measurements that no candidate connects are carried on."""
        items = sorted([*self.carried, *prepared], key=lambda item: item.core)
        if not items:
            return self._close(frame, items, None)
        started = time.perf_counter()
        try:
            problem = self._problem(items, frame)
            judged = self._pulls.look(items, self.state, problem.inputs)
            if judged is not None:
                items, problem = judged, self._problem(judged, frame)
            frame.seconds['candidates'] = time.perf_counter() - started
            choice = self._strategy.select(problem)
        except MapperError:
            raise
        # The libraries below and strategies of users raise what they like: it costs this window.
        except Exception:
            return self._fail(frame, items)
        self.base.add_window(prepared, problem.imu)
        if choice.winner is None:
            waited = (items[-1].core.stamp - items[0].core.stamp) / NANOSECONDS
            if not force and waited < self._config.window.max_carry:
                self.carried = items
                return self._close(frame, items, choice)
            loose = [item for item in items if _loose(item)]
            if self.state.clusters and loose:
                # A guess may hold a scan that others are matched to, not one that tells nothing.
                self.drops.update((item.core.sensor, 'unmatched') for item in loose)
                self.carried = [item for item in items if not _loose(item)]
                return self._choose([], frame, force)
            newest = self.state.frontier.newest
            pose = None if newest is None else self.state.pose(newest)
            choice = bridged(choice, problem, pose)
            self.totals.bridges += len(choice.extra)
        self.carried = []
        started = time.perf_counter()
        committed = commit(self.state, self.totals.windows, choice, problem)
        self._grown()
        frame.seconds['append'] = time.perf_counter() - started
        return self._close(frame, items, choice, committed)

    def _problem(self, items: Sequence[Prepared], frame: _Frame) -> WindowProblem:
        """The window's problem; nothing is solved yet."""
        return pose_problem(
            items,
            self.state,
            self._series,
            self._orientation,
            self._parameters,
            self._config,
            frame.candidates,
        )

    def _grown(self) -> None:
        """After G(t) took a window in."""
        self.totals.solver_failures += int(not self.state.prior.healthy)
        self._georeference()
        # Samples after the last cluster stamp belong to the next window.
        frontier, self._around = self.state.frontier, self._series
        # The change of a turn at a sample is told by those around it.
        unused = min(frontier.head_stamp, frontier.newest_stamp)
        self._series = self._series.since(unused - SMOOTHED)
        self._watch.grown(self.state)

    def _georeference(self) -> None:
        """Keep to the fixes that hold, and lay the map into ENU once they tell how it lies."""
        gate = self._front_end.gate
        refuted = gate.refuted
        if refuted:
            moved = self._front_end.refound(refuted)
            without_fixes(self.state, self._config, refuted, moved)
        if gate.certain:
            georeference(self.state, self._config)

    def _keep_orientation(self, sample: ImuSample) -> None:
        if self._orientation is None and sample.orientation is not None:
            self._orientation = sample.orientation

    def _fail(self, frame: _Frame, items: Sequence[Prepared]) -> WindowResult:
        """Leave out a window whose choice raised; G(t-1) is as it was."""
        window = self.totals.windows

        def record(raised: str) -> WindowRecord:
            return record_window(
                window,
                raised,
                items,
                self.state,
                self._series,
                self._orientation,
                self._config,
                frame.candidates,
            )

        self.failures.add(window, (frame.start, frame.end), items, record)
        self.totals.failed_windows = self.failures.count
        self.carried = []
        return self._close(frame, items, None)

    def _close(
        self,
        frame: _Frame,
        items: Sequence[Prepared],
        choice: Choice | None,
        committed: Committed = NOTHING,
        joined: int = 0,
    ) -> WindowResult:
        """Record a window's numbers."""
        totals, seconds = self.totals, frame.seconds
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
        self.rows.add(row)
        totals.windows += 1
        return WindowResult(
            index=totals.windows - 1,
            start=frame.start,
            end=frame.end,
            winner=None if choice is None or not placed else choice.winner,
            clusters=placed,
            poses=tuple(self.state.pose(item.id) for item in placed),
            row=row,
            joined=joined,
            tried=() if choice is None else choice.tried,
        )
