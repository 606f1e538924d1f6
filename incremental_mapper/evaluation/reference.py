"""Our numbers beside those of a reference: the paper, or an earlier evaluation."""

from collections.abc import Sequence
from statistics import fmean

from incremental_mapper.evaluation.table import MEAN, NO_VALUE, PAPER_ROWS, Entry, Row
from incremental_mapper.evaluation.table_formats import spaced


def comparison(entries: Sequence[Entry], reference: Sequence[Entry], title: str) -> str:
    """A Markdown table of "ours / theirs" for what both have; empty where they share nothing.

    A sequence is found by its name, motion and strategy. Means are over what both have.
    """
    theirs = {(item.sequence, item.motion, item.strategy): item for item in reference}
    pairs = [
        (entry, theirs[key])
        for entry in entries
        if (key := (entry.sequence, entry.motion, entry.strategy)) in theirs
    ]
    if not pairs:
        return ''
    heads = ['sequence', 'strategy', *(row.title for row in PAPER_ROWS)]
    lines = [
        f'Ours / {title}:',
        '',
        '| ' + ' | '.join(heads) + ' |',
        '|---|---|' + '--:|' * len(PAPER_ROWS),
    ]
    for own, other in pairs:
        cells = [
            _both(row, own.metrics.get(row.name), other.metrics.get(row.name)) for row in PAPER_ROWS
        ]
        name = own.sequence.replace('_', '\\_')
        lines.append(f'| {name} | {spaced(own.strategy)} | ' + ' | '.join(cells) + ' |')
    for strategy in dict.fromkeys(own.strategy for own, _ in pairs):
        cells = [
            _means(row, [pair for pair in pairs if pair[0].strategy == strategy])
            for row in PAPER_ROWS
        ]
        lines.append(f'| **{MEAN}** | **{spaced(strategy)}** | ' + ' | '.join(cells) + ' |')
    return '\n'.join(lines)


def _both(row: Row, own: float | int | None, other: float | int | None) -> str:
    if own is None and other is None:
        return NO_VALUE
    return f'{row.text(own)} / {row.text(other)}'


def _means(row: Row, pairs: Sequence[tuple[Entry, Entry]]) -> str:
    both = [
        (own, other)
        for mine, reference in pairs
        if (own := mine.metrics.get(row.name)) is not None
        and (other := reference.metrics.get(row.name)) is not None
    ]
    if not both:
        return NO_VALUE
    own, other = (fmean(column) for column in zip(*both, strict=True))
    return f'{row.mean_text(own)} / {row.mean_text(other)}'
