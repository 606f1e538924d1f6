"""Measurements in, G(t), poses, map and statistics out: what users of the method hold."""

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

from incremental_mapper.blas import single_threaded_blas
from incremental_mapper.checks.finding import Finding, ranked
from incremental_mapper.checks.outcome import Outcome, outcome_findings
from incremental_mapper.compiled import waiting
from incremental_mapper.config import Config, Tree
from incremental_mapper.frontend import inertial_motion, preprocessing
from incremental_mapper.map.store import PointStore, make_store
from incremental_mapper.mapping.final_solve import final_values
from incremental_mapper.mapping.incremental_graph import IncrementalGraph
from incremental_mapper.mapping.judgement import judge_map
from incremental_mapper.mapping.live_closing import LiveLoops, LoopNews, Runner
from incremental_mapper.mapping.live_closing import live as closes_live
from incremental_mapper.mapping.load_shedding import NO_SHEDDING, LoadShedding
from incremental_mapper.mapping.loop_closing import close_loops
from incremental_mapper.mapping.measurement_intake import MeasurementIntake
from incremental_mapper.mapping.newest_state import NewestState
from incremental_mapper.mapping.result import MapResult, WindowResult, fixes_in_map, trajectory_of
from incremental_mapper.mapping.statistics import MapStatistics, map_statistics
from incremental_mapper.mapping.watch import Watch
from incremental_mapper.measurements import (
    Drops,
    Measurement,
)
from incremental_mapper.selection.strategies import find_strategy
from incremental_mapper.selection.window_record import WindowRecord
from incremental_mapper.settings import to_tree
from incremental_mapper.smoothing import linear_system, relative_covariance
from incremental_mapper.smoothing.graph_state import GraphState


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
        strategy = find_strategy(config.selection.strategy)
        if store is None:
            store = make_store(config.map)  # may fail, so before any process is started
        self._intake = MeasurementIntake(config, sensors, predict)
        with waiting():  # while the front end's processes start
            preprocessing.warm_up()
            inertial_motion.warm_up()
            linear_system.warm_up()
            strategy.warm_up()
            if config.closure.enabled:
                relative_covariance.warm_up()  # no search need wait for it, nor take its seconds
        self._watch = Watch(config)
        front_end = self._intake.front_end
        self._graph = IncrementalGraph(config, strategy, store, front_end, self._watch)
        closes = searches is not None and closes_live(config)
        self._loops = LiveLoops(self.state, config, searches) if searches and closes else None
        self._settings = to_tree(config)

    @property
    def state(self) -> GraphState:
        """G(t)."""
        return self._graph.state

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
        self._graph.totals.received[measurement.sensor] += 1
        self._watch.measurement(measurement)
        self._intake.push(measurement)
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
        return self._intake.waits

    def go_on(self, shedding: LoadShedding = NO_SHEDDING) -> Iterator[WindowResult]:
        """Run the closed windows whose scans are prepared by now.

        Args:
            shedding: Limits what is spent on the windows.

        Yields:
            They, oldest first.
        """
        while self._intake.ready(shedding):
            yield self._graph.take(self._intake.next(shedding.windows), shedding.candidates)

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
        self._intake.flush()
        while self._intake.waits:
            yield self._graph.take(self._intake.next(shedding.windows), shedding.candidates)
        last = self._graph.end(shedding.candidates)
        if last is not None:
            yield last
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
        values, failed = final_values(self.state, self.config)
        self._graph.totals.solver_failures += int(failed)
        if self._loops is None:
            closed = close_loops(self.state, values, self.config)
        else:
            closed = self._loops.of_all(values, most)
        values = closed.values
        clusters = tuple(self.state.clusters)
        return MapResult(
            clusters=clusters,
            factors=(*self.state.factors.unpacked(), *closed.factors),
            values=values,
            trajectory=trajectory_of(clusters, values),
            scans=tuple(self.state.scans),
            fixes=fixes_in_map(self.state),
            rows=self._graph.rows.all(),
            statistics=closed.counted(self.statistics),
            findings=self._watch.final(
                lambda: judge_map(self.state, values, self.config),
                lambda: outcome_findings(self._outcome()),
                lambda: self.state.store.findings,
            ),
            failed=tuple(self._graph.failures.records),
        )

    def newest(self) -> NewestState | None:
        """Newest pose with covariance and twist, None before the first window; constant cost."""
        return self._graph.newest()

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What was found wrong with the measurements so far, the worst first."""
        return ranked(
            [
                *self._watch.findings(),
                *outcome_findings(self._outcome()),
                *self.state.store.findings,
            ]
        )

    @property
    def lasting_findings(self) -> tuple[Finding, ...]:
        """``findings`` without what is judged anew when the map ends: ``judge_map`` has that."""
        return ranked(
            [
                *self._watch.lasting(),
                *outcome_findings(self._outcome()),
                *self.state.store.findings,
            ]
        )

    @property
    def failed_windows(self) -> Sequence[WindowRecord]:
        """The inputs of windows that failed, the first few of them."""
        return self._graph.failures.records

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
        for part in (*self._intake.drops, self._graph.drops, self._graph.failures.drops):
            total.update(dict(part))  # a copy in one step: they change meanwhile
        return total

    @property
    def statistics(self) -> MapStatistics:
        """The record of all windows so far; its cost does not grow with the drive."""
        return map_statistics(
            self._settings,
            self.state,
            self._graph.base,
            self._graph.totals,
            drops=self.drops,
            notes=self._intake.front_end.notes,
            late=self._intake.late,
            unused=[item.core for item in self._graph.carried],
            datum=self._intake.front_end.datum,
        )

    def stats(self) -> dict[str, Any]:
        """``statistics`` as the keys of ``stats.json``, with the loops that are closed by now."""
        statistics = self.statistics
        if self._loops is not None:
            statistics = self._loops.counted(statistics)
        return statistics.to_tree()

    def _outcome(self) -> Outcome:
        notes = self._intake.front_end.notes
        return self._watch.fit.outcome(
            self.state, self._graph.totals, notes, self._graph.failures.records
        )

    def close(self) -> None:
        """Let go of processes and threads; nothing may be pushed afterwards."""
        if self._loops is not None:
            self._loops.close()
        self._intake.close()
