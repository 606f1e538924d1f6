"""What was found wrong with settings, inputs and map: what log and /diagnostics tell of it."""

from collections.abc import Iterable

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.impl.rcutils_logger import RcutilsLogger

from incremental_mapper.checks.finding import Finding, Severity, ranked
from incremental_mapper.ros.rclpy_types import MESSAGES

SUSPICIONS = 'nothing suspicious'
LEVELS = {
    Severity.ERROR: DiagnosticStatus.ERROR,
    Severity.WARNING: DiagnosticStatus.WARN,
    Severity.MENDED: DiagnosticStatus.WARN,
}


class KnownFindings:
    """Findings of all parts of the node; used in the executor's thread, ``lasting`` by any.

    Those of settings and inputs last, those of the map end with it. The log has each rule and
    sensor once, and again only where it has become worse.
    """

    def __init__(self, logger: RcutilsLogger) -> None:
        self._logger = logger
        self._of_part: dict[str, tuple[Finding, ...]] = {}
        self._of_map: tuple[Finding, ...] = ()
        self._told: dict[tuple[str, str], bytes] = {}

    def add(self, findings: Iterable[Finding]) -> None:
        """Take findings that last, beside those that there are."""
        self.of_part('', ranked([*self._of_part.get('', ()), *findings]))

    def of_part(self, part: str, findings: Iterable[Finding]) -> None:
        """Take all findings of a part of the inputs as it is now, in place of those before.

        Args:
            part: A name of the part.
            findings: All that there are.
        """
        self._of_part = {**self._of_part, part: tuple(findings)}
        self._tell(self._of_part[part])

    def of_map(self, findings: tuple[Finding, ...], told: bool = False) -> None:
        """Take all findings of the map as it is now, in place of those before.

        Args:
            findings: All that there are.
            told: Whether the log has them already.
        """
        self._of_map = findings
        if told:
            self._told |= {(item.rule, item.sensor): LEVELS[item.severity] for item in findings}
        self._tell(findings)

    def lasting(self) -> tuple[Finding, ...]:
        """Those of settings and inputs; any thread may ask."""
        return ranked(found for part in self._of_part.values() for found in part)

    def status(self, node: str) -> DiagnosticStatus:
        """All findings as a diagnostic status, as bad as the worst and with its line.

        Args:
            node: name of the node.
        """
        found = ranked([*self.lasting(), *self._of_map])
        level, message = DiagnosticStatus.OK, SUSPICIONS
        if found:
            level, message = LEVELS[found[0].severity], found[0].line()
        values = {
            f'{item.rule} {item.sensor}'.strip(): f'{item.severity}: {item.line()}'
            for item in found
        }
        return MESSAGES.status(f'{node}: checks', level, message, values)

    def _tell(self, findings: Iterable[Finding]) -> None:
        for finding in findings:
            key, level = (finding.rule, finding.sensor), LEVELS[finding.severity]
            if self._told.get(key, DiagnosticStatus.OK) >= level:
                continue
            self._told[key] = level
            if level == DiagnosticStatus.ERROR:
                self._logger.error(finding.line())
            else:
                self._logger.warning(finding.line())
