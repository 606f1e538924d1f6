"""What a window chose from, as a table to be read."""

from collections.abc import Sequence
from dataclasses import dataclass

from incremental_mapper.scoring.score_names import SCORE_NAMES

SHOWN = 12
"""Candidates in the table of a window, the best of them."""


@dataclass(frozen=True, slots=True)
class ShownCandidate:
    """A candidate of a window; a number that it did not get is None."""

    members: str
    vertices: int
    score: float | None
    time_shift: float
    solver_error: float | None
    winner: bool
    tied: bool | None


def table_text(ranked: Sequence[ShownCandidate], score_name: str) -> str:
    """The best candidates, and the winner where it is none of them, as Markdown.

    Args:
        ranked: They, the best first.
        score_name: What their scores are.
    """
    if not ranked:
        return 'no candidates: there was nothing to choose in this window'
    shown = [item for place, item in enumerate(ranked) if place < SHOWN or item.winner]
    lines = [
        f'{len(ranked)} candidates, score: {SCORE_NAMES.get(score_name, score_name) or "none"}',
        '',
        '| | score | % above the lowest | vertices | time shift s | solver error | clusters |',
        '|---|--:|--:|--:|--:|--:|---|',
    ]
    for item in shown:
        mark = '**winner**' if item.winner else 'ties' if item.tied else ''
        members = item.members.replace('|', ' / ')
        lines.append(
            f'| {mark} | {_number(item.score)} | {_above(item.score, ranked[0].score)} '
            f'| {item.vertices} | {item.time_shift:.4f} '
            f'| {_number(item.solver_error)} | {members} |'
        )
    return '\n'.join(lines)


def _above(score: float | None, lowest: float | None) -> str:
    """By how many percent a score is above the lowest, which differ in the fourth digit."""
    return f'{100.0 * (score / lowest - 1.0):.3f}' if score is not None and lowest else ''


def _number(value: float | None) -> str:
    return '' if value is None else f'{value:.5g}'
