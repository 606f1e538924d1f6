"""Findings at the end of a command's output: the worst last, where the eye rests."""

import shutil
import sys
import textwrap
from collections.abc import Iterable

from incremental_mapper.checks.finding import Finding, ranked

WIDEST = 100
"""Columns beyond which a line of text is hard to read, however wide the terminal is."""
NARROWEST = 40
INDENT = 4


def print_findings(findings: Iterable[Finding]) -> None:
    """Print findings to stderr: in a terminal wrapped, else one a line, as programs want them.

    Args:
        findings: In any order; warnings come before errors.
    """
    width = shutil.get_terminal_size().columns if sys.stderr.isatty() else None
    for finding in reversed(ranked(findings)):
        lines = [finding.titled()] if width is None else wrapped(finding, width)
        print('\n'.join(lines), file=sys.stderr)


def wrapped(finding: Finding, width: int) -> list[str]:
    """A finding in lines of a terminal, its remedy beginning one of its own.

    Args:
        finding: What was found.
        width: Columns of the terminal.

    Returns:
        The lines; a word that is longer than a line, such as a path, is left whole.
    """
    room = max(min(width, WIDEST), NARROWEST) - 1  # the last column wraps in some terminals
    said, _, remedy = finding.titled().partition(f' ({finding.rule}); ')
    texts = [f'{said} ({finding.rule})', f'-> {remedy}'] if remedy else [said]
    lines = []
    for number, text in enumerate(texts):
        indent = ' ' * INDENT if number else ''
        lines += textwrap.wrap(
            text,
            room,
            initial_indent=indent,
            subsequent_indent=' ' * (INDENT + 3 * bool(number)),
            break_long_words=False,
            break_on_hyphens=False,
        )
    return lines
