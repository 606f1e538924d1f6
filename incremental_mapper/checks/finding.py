"""What a rule found: something of a recording that is not as it says."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any


def listed(names: Sequence[str]) -> str:
    """Names in words."""
    *others, last = names
    return f'{", ".join(others)} and {last}' if others else last


class Severity(StrEnum):
    """What follows from a finding."""

    MENDED = 'mended'
    """The data were put right; the map is as good as if they had been so."""
    WARNING = 'warning'
    """The map may be worse than it should be, or lacks something."""
    ERROR = 'error'
    """The map is none, or is not to be trusted: the exit status is 1."""


_ORDER = {Severity.ERROR: 0, Severity.WARNING: 1, Severity.MENDED: 2}


@dataclass(frozen=True, slots=True)
class Finding:
    """One suspicion that proved true.

    Attributes:
        rule: A word to look for in the documentation and to count by, such as ``imu_in_g``.
        severity: What follows.
        sensor: Name of the sensor, or '' where it is the whole input or map.
        text: What is wrong: what, where, and the value.
        remedy: The line to write, the command to call, or what was done.
        settings: What puts it right, as a tree of settings; empty where settings cannot. Of a
            ``MENDED`` finding it is in force; of a ``WARNING`` it is a proposal, unless it is
            ``in_force``.
        in_force: Whether the run goes by ``settings`` though they do not put it right, such as
            without the sensor.
    """

    rule: str
    severity: Severity
    sensor: str
    text: str
    remedy: str = ''
    settings: dict[str, Any] = field(default_factory=dict, compare=False)
    in_force: bool = False

    @property
    def changes(self) -> bool:
        """Whether a run goes by ``settings`` because of it."""
        return bool(self.settings) and (self.severity is Severity.MENDED or self.in_force)

    def line(self) -> str:
        """The finding in one line, as the terminal and the log show it."""
        subject = f'{self.sensor}: ' if self.sensor else ''
        remedy = f'; {self.remedy}' if self.remedy else ''
        return f'{subject}{self.text} ({self.rule}){remedy}'

    def titled(self) -> str:
        """``line`` with a word in front that says how bad it is."""
        titles = {
            Severity.ERROR: 'error',
            Severity.WARNING: 'warning',
            Severity.MENDED: 'warning (mended)',
        }
        return f'{titles[self.severity]}: {self.line()}'

    def to_tree(self) -> dict[str, Any]:
        """Plain values, as ``stats.json`` has them under ``warnings``."""
        return {
            'rule': self.rule,
            'severity': str(self.severity),
            'sensor': self.sensor,
            'text': self.text,
            'remedy': self.remedy,
            'settings': self.settings,
        }


def ranked(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """One finding for every rule and sensor, the newest; the worst come first.

    Args:
        findings: In the order in which they were made.
    """
    newest = {(finding.rule, finding.sensor): finding for finding in findings}
    return tuple(sorted(newest.values(), key=lambda finding: _ORDER[finding.severity]))
