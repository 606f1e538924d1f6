"""Watches the measurements and the map while it is made, and asks the rules of ``checks``."""

import functools
import logging
from collections.abc import Callable, Iterable, Sequence
from typing import Concatenate, ParamSpec

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding, Severity, ranked
from incremental_mapper.checks.fixes import Drawn, drawn_away
from incremental_mapper.checks.imu_pushed import Pushes, pushed_findings
from incremental_mapper.config import Config, Tree
from incremental_mapper.frontend.fix_gate import FixGate
from incremental_mapper.frontend.front_end import Prepared
from incremental_mapper.mapping.beat_watch import BeatWatch
from incremental_mapper.mapping.fit_watch import FitWatch
from incremental_mapper.mapping.imu_watch import ImuWatch
from incremental_mapper.mapping.mount_watch import MountWatch
from incremental_mapper.mapping.presence_watch import PresenceWatch
from incremental_mapper.mapping.range_watch import RangeWatch
from incremental_mapper.mapping.window import Window
from incremental_mapper.measurements import ImuSample, LidarScan, Measurement
from incremental_mapper.settings import merge
from incremental_mapper.smoothing.graph_state import GraphState

LOGGER = logging.getLogger('incremental_mapper')
Arguments = ParamSpec('Arguments')


def _guarded(
    look: Callable[Concatenate['Watch', Arguments], None],
) -> Callable[Concatenate['Watch', Arguments], None]:
    """A look that must not cost the map: what it raises is logged once and told of."""

    @functools.wraps(look)
    def guarded(watch: 'Watch', /, *args: Arguments.args, **more: Arguments.kwargs) -> None:
        try:
            look(watch, *args, **more)
        # The evidence is whatever a recording holds, and the map is worth more than any rule.
        except Exception as error:
            watch.failed(error)

    return guarded


class Watch:
    """Gathers the evidence of one map; rules are asked when there is enough of it.

    Everything here is called for every measurement or window of a drive: it may cost next to
    nothing. Evidence of one kind is gathered in a class of its own, beside this one. ``pushes`` and
    ``drawn`` are counted where samples and fixes are believed less.
    """

    def __init__(self, config: Config) -> None:
        self._config = config
        self._findings: list[Finding] = []
        self.fit = FitWatch(config)
        self.mend: Tree = {}
        self._imu = ImuWatch(config)
        self._mounts = MountWatch(config)
        self._gate: FixGate | None = None
        self.pushes = Pushes()
        self.drawn = Drawn()
        self._presence = PresenceWatch()
        self._beat = BeatWatch()
        self._ranges = RangeWatch(config)
        self._has_failed = False

    def failed(self, error: Exception) -> None:
        """Tell of a rule that raised; must be called while it is handled."""
        level = logging.DEBUG if self._has_failed else logging.ERROR
        LOGGER.log(level, 'a check of the recording failed; the map goes on', exc_info=True)
        if self._has_failed:
            return  # hostile samples may make it fail thousands of times
        self._has_failed = True
        text = f'a check of the recording failed ({" ".join(repr(error).split())[:200]})'
        remedy = 'the map was made without it; the log has the trace, please report it'
        self._findings.append(Finding('check_failed', Severity.WARNING, '', text, remedy))

    def measurement(self, measurement: Measurement) -> None:
        """Look at a measurement as it comes in."""
        if isinstance(measurement, LidarScan):
            self._scan(measurement)
        if not isinstance(measurement, ImuSample):
            return
        # What ``_guarded`` does, without its cost for every sample of an IMU.
        try:
            if self._mounts.wanted:
                self._mounts.sample(measurement)
            for finding in self._imu.sample(measurement):
                self.add(finding)
        except Exception as error:
            self.failed(error)

    @_guarded
    def _scan(self, scan: LidarScan) -> None:
        finding = self._ranges.scan(scan)
        if finding is not None:
            self.add(finding)

    @_guarded
    def window(self, window: Window) -> None:
        """Look at what a closed window holds."""
        self._presence.window(window)
        self._imu.used(window.imu)

    @_guarded
    def contradicted(self, stamps: NDArray[np.int64]) -> None:
        """Look at the stamps (ns) of samples that are left out for the matches beside them."""
        self._imu.contradicted(stamps)

    @_guarded
    def prepared(self, prepared: Sequence[Prepared]) -> None:
        """Look at what the front end made of a window's core measurements."""
        looks = (self._mounts.matches, self._imu.matches, self._beat.scans)
        for finding in (one for look in looks for one in look(prepared)):
            self.add(finding)

    @_guarded
    def fixes(self, gate: FixGate) -> None:
        """Look at what the gate made of a window's fixes."""
        self._gate = gate
        wrong = gate.misshapen() or gate.too_certain() or gate.misplaced()
        if wrong is not None:
            self.add(wrong)

    @_guarded
    def grown(self, state: GraphState) -> None:
        """Look at the newest stretch of G(t)."""
        self.fit.window(state)

    @_guarded
    def end(self) -> None:
        """Decide what waits for more measurements: none will come."""
        for finding in (*self._mounts.end(), *self._imu.end()):
            self.add(finding)
        if self._gate is not None:
            wrong = self._gate.misshapen(last=True) or self._gate.misplaced(last=True)
            if wrong is not None:
                self.add(wrong)

    def add(self, finding: Finding) -> None:
        """Keep a finding; what one changes is asked of who runs the mapper."""
        self._findings.append(finding)
        if finding.changes:
            self.mend = merge(self.mend, finding.settings)

    def findings(self) -> tuple[Finding, ...]:
        """What was found so far, the worst first; its cost does not grow with the drive."""
        more = [
            *self._asked(self._of_fixes),
            *self._asked(self._of_imu),
            *self.fit.found,
            *self._asked(self._presence.so_far),
        ]
        return ranked([*self._findings, *more])

    def lasting(self) -> tuple[Finding, ...]:
        """``findings`` without those of the fit, which a whole map is judged for anew."""
        judges = (self._of_fixes, self._of_imu, self._presence.so_far)
        more = [finding for judge in judges for finding in self._asked(judge)]
        return ranked([*self._findings, *more])

    def mended(self) -> tuple[Finding, ...]:
        """The findings that ``mend`` follows from."""
        return ranked(found for found in self._findings if found.changes)

    def final(self, *judges: Callable[[], Iterable[Finding]]) -> tuple[Finding, ...]:
        """The same with what only a whole map shows, as if it ended here.

        Args:
            judges: What judges the map, in place of what was found while the map grew.
        """
        asked = (self._of_all_fixes, self._of_imu, *judges, self._presence.findings)
        more = [finding for judge in asked for finding in self._asked(judge)]
        return ranked([*self._findings, *more])

    def _asked(self, judge: Callable[[], Iterable[Finding]]) -> tuple[Finding, ...]:
        """What a judge finds; nothing where it raises, which is told of."""
        try:
            return tuple(judge())
        # As in _guarded.
        except Exception as error:
            self.failed(error)
            return ()

    def _of_fixes(self, ended: bool = False) -> tuple[Finding, ...]:
        if self._gate is None:
            return ()
        return (*self._gate.findings(), *drawn_away(self._gate.sensor, self.drawn, ended))

    def _of_all_fixes(self) -> tuple[Finding, ...]:
        return self._of_fixes(ended=True)

    def _of_imu(self) -> tuple[Finding, ...]:
        return pushed_findings(self.pushes)
