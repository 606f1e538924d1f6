"""The table as plain text, Markdown and LaTeX, and as Markdown beside a reference.

By hand: tabulate would save 25 lines, but has no heads over several columns, so that one
could not see where a sequence ends and the next begins.
"""

from collections.abc import Iterator, Sequence
from statistics import fmean

from incremental_mapper.evaluation.table import (
    MEAN,
    NO_VALUE,
    PAPER_ROWS,
    ROWS,
    Cell,
    Column,
    Entry,
    Mark,
    Row,
    Table,
)

SIDE_BY_SIDE = 3
"""Sequences beside each other in Markdown and LaTeX, as in the paper."""
HEAD_WIDTH = 10
"""Longest line of a strategy's name in the head of the plain table, where it has spaces."""
PLAIN_MARKS = {Mark.BEST: '*', Mark.SECOND: '+', Mark.NONE: ' '}
LATEX_ESCAPES = str.maketrans(
    {
        '\\': r'\textbackslash{}',
        '&': r'\&',
        '%': r'\%',
        '$': r'\$',
        '#': r'\#',
        '_': r'\_',
        '{': r'\{',
        '}': r'\}',
        '~': r'\textasciitilde{}',
        '^': r'\textasciicircum{}',
        '–': '--',
        '²': r'$^2$',
    }
)


def plain_table(table: Table, width: int) -> str:
    """The table for a terminal ``width`` characters wide; as many sequences a line as fit."""
    heads = [_wrapped(name) for name in table.strategies]
    columns = [column for block in table.blocks for column in block.columns]
    cells = [cell for column in columns for row in column.cells for cell in row]
    longest = max((len(cell.text) for cell in cells), default=0)
    cell_width = 2 + max([longest, *(len(line) for head in heads for line in head)])
    label_width = max(len(row.title) for row in ROWS)
    column_width = len(heads) * cell_width
    fitting = max((width - label_width) // (column_width + 2), 1)
    lines = []
    for block in table.blocks:
        for group in _groups(block.columns, fitting):
            titles = (f'  {column.title:^{column_width}}' for column in group)
            lines.append(f'{block.title:<{label_width}}' + ''.join(titles))
            for line in range(max(map(len, heads))):
                # The last line of every head stands on the numbers; short heads have fewer.
                words = [_line(head, line, max(map(len, heads))) for head in heads]
                row = '  ' + ''.join(f'{word:>{cell_width - 1}} ' for word in words)
                lines.append(' ' * label_width + row * len(group))
            for index, row_of_table in enumerate(ROWS):
                if index in (0, len(PAPER_ROWS)):
                    lines.append('-' * (label_width + len(group) * (column_width + 2)))
                parts = [
                    '  ' + ''.join(_plain_cell(cell, cell_width) for cell in column.cells[index])
                    for column in group
                ]
                lines.append(f'{row_of_table.title:<{label_width}}' + ''.join(parts))
            lines.append('')
    lines += ['* best, + second best of a row and sequence', *table.remarks]
    return '\n'.join(line.rstrip() for line in lines)


def markdown_table(table: Table) -> str:
    """The table in Markdown: best bold, second best in italics."""
    lines = []
    for block in table.blocks:
        if block.title:
            lines += [f'### {block.title}', '']
        for group in _groups(block.columns, SIDE_BY_SIDE):
            heads = [
                (f'**{_markdown(column.title)}**<br>' if index == 0 else '') + spaced(name)
                for column in group
                for index, name in enumerate(table.strategies)
            ]
            lines.append('| ' + ' | '.join(['', *heads]) + ' |')
            lines.append('|---|' + '--:|' * len(heads))
            for index, row in enumerate(ROWS):
                cells = [_markdown_cell(cell) for column in group for cell in column.cells[index]]
                lines.append('| ' + ' | '.join([row.title, *cells]) + ' |')
            lines.append('')
    lines += ['Best of a row and sequence in bold, second best in italics.']
    lines += ['', *(f'- {_markdown(remark)}' for remark in table.remarks)]
    return '\n'.join(lines).rstrip()


def latex_table(table: Table, caption: str) -> str:
    """The table in LaTeX, a float for every three sequences; best bold, second best underlined.

    One float of everything would be longer than a page.
    """
    lines = [r'% needs \usepackage{adjustbox,booktabs}', *(f'% {text}' for text in table.remarks)]
    for block in table.blocks:
        about = ', '.join(
            text for text in ((caption or 'Strategies compared').rstrip('.'), block.title) if text
        )
        for group in _groups(block.columns, SIDE_BY_SIDE):
            lines += [
                r'\begin{table*}[t]',
                r'\centering',
                rf'\caption{{{about.translate(LATEX_ESCAPES)}: best of a row and sequence in bold, '
                r'second best underlined.}',
                r'\begin{adjustbox}{max width=\textwidth}',
                *_latex_tabular(table.strategies, group),
                r'\end{adjustbox}',
                r'\end{table*}',
            ]
    return '\n'.join(lines)


def comparison(entries: Sequence[Entry], reference: Sequence[Entry], title: str) -> str:
    """A Markdown table of "ours / theirs" for what both have.

    Args:
        entries: Our numbers.
        reference: Those of the paper, or of an earlier evaluation. A sequence is found by its
            name, motion and strategy.
        title: What the reference is called.

    Returns:
        The table, with means over what both have; empty where they share nothing.
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


def spaced(name: str) -> str:
    """The name of a strategy as people write it."""
    return name.replace('_', ' ')


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


def _latex_tabular(strategies: Sequence[str], group: Sequence[Column]) -> Iterator[str]:
    count = len(strategies)
    titles = [column.title.translate(LATEX_ESCAPES) for column in group]
    names = [spaced(name).translate(LATEX_ESCAPES) for name in strategies]
    yield rf'\begin{{tabular}}{{l{"r" * count * len(group)}}}'
    yield r'\toprule'
    yield _latex_line(['', *(rf'\multicolumn{{{count}}}{{c}}{{{title}}}' for title in titles)])
    yield ' '.join(
        rf'\cmidrule(lr){{{2 + index * count}-{1 + (index + 1) * count}}}'
        for index in range(len(group))
    )
    yield _latex_line(['', *names * len(group)])
    for index, row in enumerate(ROWS):
        if index in (0, len(PAPER_ROWS)):
            yield r'\midrule'
        cells = [_latex_cell(cell) for column in group for cell in column.cells[index]]
        yield _latex_line([row.title.translate(LATEX_ESCAPES), *cells])
    yield r'\bottomrule'
    yield r'\end{tabular}'


def _latex_line(cells: Sequence[str]) -> str:
    return ' & '.join(cells) + r' \\'


def _latex_cell(cell: Cell) -> str:
    text = cell.text.translate(LATEX_ESCAPES)
    commands = {Mark.BEST: r'\textbf', Mark.SECOND: r'\underline'}
    return rf'{commands[cell.mark]}{{{text}}}' if cell.mark in commands else text


def _markdown_cell(cell: Cell) -> str:
    signs = {Mark.BEST: '**', Mark.SECOND: '_', Mark.NONE: ''}
    return f'{signs[cell.mark]}{cell.text}{signs[cell.mark]}'


def _markdown(text: str) -> str:
    """Text in which nothing is taken for markup."""
    return ''.join(f'\\{sign}' if sign in '\\`*_|<>[]' else sign for sign in text)


def _plain_cell(cell: Cell, width: int) -> str:
    return f'{cell.text:>{width - 1}}{PLAIN_MARKS[cell.mark]}'


def _wrapped(name: str) -> list[str]:
    """The words of a strategy's name in lines of ``HEAD_WIDTH`` characters, if they are short."""
    lines: list[str] = []
    for word in name.split('_'):
        if lines and len(lines[-1]) + 1 + len(word) <= HEAD_WIDTH:
            lines[-1] += f' {word}'
        else:
            lines.append(word)
    return lines


def _line(head: Sequence[str], line: int, lines: int) -> str:
    index = line - (lines - len(head))
    return head[index] if index >= 0 else ''


def _groups(columns: Sequence[Column], size: int) -> Iterator[Sequence[Column]]:
    for start in range(0, len(columns), size):
        yield columns[start : start + size]
