"""Watches the measurements and the map while it is made, and asks the rules of ``checks``."""

from incremental_mapper.checks.finding import Finding, Severity, ranked
from incremental_mapper.config import Config, Tree
from incremental_mapper.measurements import Measurement
from incremental_mapper.settings import merge


class Watch:
    """Gathers the evidence of one map; rules are asked when there is enough of it.

    Everything here is called for every measurement or window of a drive: it may cost next to
    nothing. Evidence of one kind is gathered in a class of its own, beside this one.
    """

    def __init__(self, config: Config) -> None:
        self._config = config
        self._findings: list[Finding] = []
        self.mend: Tree = {}

    def measurement(self, measurement: Measurement) -> None:
        """Look at a measurement as it comes in."""

    def add(self, finding: Finding) -> None:
        """Keep a finding; what a mended one puts right is asked of who runs the mapper."""
        self._findings.append(finding)
        if finding.severity is Severity.MENDED and finding.settings:
            self.mend = merge(self.mend, finding.settings)

    def findings(self) -> tuple[Finding, ...]:
        """What was found so far, the worst first; its cost does not grow with the drive."""
        return ranked(self._findings)

    def mended(self) -> tuple[Finding, ...]:
        """The findings that ``mend`` puts right."""
        return ranked(found for found in self._findings if found.severity is Severity.MENDED)

    def final(self) -> tuple[Finding, ...]:
        """The same with what only a whole map shows, as if it ended here."""
        return self.findings()
