"""Watches the measurements and the map while it is made, and asks the rules of ``checks``."""

from collections.abc import Iterable, Sequence

from incremental_mapper.checks.finding import Finding, ranked
from incremental_mapper.config import Config, Tree
from incremental_mapper.frontend.fix_gate import FixGate
from incremental_mapper.frontend.front_end import Prepared
from incremental_mapper.mapping.imu_watch import ImuWatch
from incremental_mapper.mapping.judgement import FitWatch
from incremental_mapper.mapping.presence_watch import PresenceWatch
from incremental_mapper.mapping.window_buffer import Window
from incremental_mapper.measurements import ImuSample, Measurement
from incremental_mapper.settings import merge


class Watch:
    """Gathers the evidence of one map; rules are asked when there is enough of it.

    Everything here is called for every measurement or window of a drive: it may cost next to
    nothing. Evidence of one kind is gathered in a class of its own, beside this one.
    """

    def __init__(self, config: Config) -> None:
        self._config = config
        self._findings: list[Finding] = []
        self.fit = FitWatch(config)
        self.mend: Tree = {}
        self._imu = ImuWatch(config)
        self._gate: FixGate | None = None
        self._presence = PresenceWatch()

    def measurement(self, measurement: Measurement) -> None:
        """Look at a measurement as it comes in."""
        if isinstance(measurement, ImuSample):
            for finding in self._imu.sample(measurement):
                self.add(finding)

    def window(self, window: Window) -> None:
        """Look at what a closed window holds."""
        self._presence.window(window)
        self._imu.used(window.imu)

    def prepared(self, prepared: Sequence[Prepared]) -> None:
        """Look at what the front end made of a window's core measurements."""
        for finding in self._imu.matches(prepared):
            self.add(finding)

    def fixes(self, gate: FixGate) -> None:
        """Look at what the gate made of a window's fixes."""
        self._gate = gate
        certain = gate.too_certain()
        if certain is not None:
            self.add(certain)

    def end(self) -> None:
        """Decide what waits for more measurements: none will come."""
        for finding in self._imu.end():
            self.add(finding)

    def add(self, finding: Finding) -> None:
        """Keep a finding; what one changes is asked of who runs the mapper."""
        self._findings.append(finding)
        if finding.changes:
            self.mend = merge(self.mend, finding.settings)

    def findings(self) -> tuple[Finding, ...]:
        """What was found so far, the worst first; its cost does not grow with the drive."""
        return ranked(
            [*self._findings, *self._of_fixes(), *self.fit.found, *self._presence.so_far()]
        )

    def mended(self) -> tuple[Finding, ...]:
        """The findings that ``mend`` follows from."""
        return ranked(found for found in self._findings if found.changes)

    def final(self, judged: Iterable[Finding] = ()) -> tuple[Finding, ...]:
        """The same with what only a whole map shows, as if it ended here.

        Args:
            judged: What ``judge_map`` found, in place of what was found while the map grew.
        """
        return ranked([*self._findings, *self._of_fixes(), *judged, *self._presence.findings()])

    def _of_fixes(self) -> tuple[Finding, ...]:
        return () if self._gate is None else self._gate.findings()
