"""The paper's table: which rows it has, in which order, and what is marked in it.

``table_text`` prints it, ``table_files`` writes its files.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeAlias

from incremental_mapper.evaluation.metrics import FINDINGS, Metrics
from incremental_mapper.evaluation.segments import Motion, motion_of_name

NO_VALUE = '–'
MEAN = 'mean'
BASE = 'base'


class Mark(StrEnum):
    """The place of a number among the strategies of one sequence."""

    BEST = 'best'
    SECOND = 'second'
    NONE = ''


@dataclass(frozen=True, slots=True)
class Row:
    """One row: the name of its number, its title, and how it is printed.

    Numbers are multiplied by ``scale`` and printed with ``decimals``. ``higher`` tells that more is
    better; of an ``unranked`` row nothing is marked. ``fixed_for_base`` marks rows in which base
    has its number by definition, so that it takes no part in the ranking.
    """

    name: str
    title: str
    decimals: int
    scale: float = 1.0
    higher: bool = False
    fixed_for_base: bool = False
    unranked: bool = False

    def text(self, value: float | int | None) -> str:
        """A number as the table shows it."""
        if value is None:
            return NO_VALUE
        return f'{value * self.scale:.{self.decimals}f}'

    def mean_text(self, value: float | int | None) -> str:
        """A mean as the table shows it: that of counts has a decimal."""
        if value is None:
            return NO_VALUE
        return f'{value * self.scale:.{max(self.decimals, 1)}f}'


PAPER_ROWS = (
    Row('total_time_shift_s', 'Total time shift, s', 4),
    Row('solver_error', 'Solver error', 4),
    Row('rpe_translation_rmse_m', 'RPE, m', 4),
    Row('rpe_rotation_rmse_deg', 'RPE, deg', 3),
    Row('clusters', 'Clusters', 0),
    Row('vertices', 'Vertices', 0),
    Row('factors', 'Factors', 0),
    Row('compression_vertices_percent', 'Compression, %', 2, higher=True, fixed_for_base=True),
)
"""The rows of the paper, in its order."""
FURTHER_ROWS = (
    Row('compression_factors_percent', 'Fewer factors, %', 2, higher=True, fixed_for_base=True),
    Row('components', 'Components', 0),
    Row('ate_rmse_m', 'ATE, m', 4),
    Row('rpe_per_second_translation_rmse_m', 'RPE per second, m', 4),
    Row('rpe_per_second_rotation_rmse_deg', 'RPE per second, deg', 3),
    Row('map_distance_m', 'Distance to base map, cm', 2, scale=100.0, fixed_for_base=True),
    Row('plane_variance_m2', 'Plane variance, cm²', 2, scale=1e4),
    Row('window_median_s', 'Time per window, ms', 0, scale=1e3),
    Row('real_time_factor', 'Real-time factor', 2, higher=True),
    Row(FINDINGS, 'Warnings', 0, unranked=True),
)
"""What stands beside them."""
ROWS = (*PAPER_ROWS, *FURTHER_ROWS)


@dataclass(frozen=True, slots=True)
class Entry:
    """The numbers of one sequence, or of its pieces of one motion, under one strategy.

    ``error`` is the reason where there are none.
    """

    sequence: str
    motion: Motion | None
    strategy: str
    metrics: Metrics
    error: str | None = None


Groups: TypeAlias = dict[Motion | None, dict[str, dict[str, Entry]]]


@dataclass(frozen=True, slots=True)
class Cell:
    """A printed number and its mark."""

    text: str
    mark: Mark = Mark.NONE


@dataclass(frozen=True, slots=True)
class Column:
    """The cells of one sequence: a row for each of ``ROWS``, in it a cell for each strategy."""

    title: str
    cells: tuple[tuple[Cell, ...], ...]


@dataclass(frozen=True, slots=True)
class Block:
    """Columns that belong together: those of one motion, or the means."""

    title: str
    columns: tuple[Column, ...]


@dataclass(frozen=True, slots=True)
class Table:
    """The whole table, ready to be printed in any format."""

    strategies: tuple[str, ...]
    blocks: tuple[Block, ...]
    remarks: tuple[str, ...]


def make_table(
    entries: Sequence[Entry], strategies: Sequence[str], remarks: Iterable[str] = ()
) -> Table:
    """Arrange entries as the paper does: blocks by motion, columns by sequence and strategy.

    Args:
        entries: The numbers; their order gives that of the columns in a block.
        strategies: Names, in the order of the columns of one sequence.
        remarks: Lines that stand below the table.

    Returns:
        The table, with a block of means where there are several sequences.
    """
    groups = _grouped(entries)
    # Where each name tells its block's motion, the column need not repeat it.
    short = all(motion_of_name(entry.sequence)[0] is entry.motion for entry in entries)
    blocks = [
        Block(
            motion_title(motion),
            tuple(
                _column(
                    motion_of_name(sequence)[1] if short else sequence,
                    [found.get(name) for name in strategies],
                )
                for sequence, found in sequences.items()
            ),
        )
        for motion, sequences in groups.items()
    ]
    means = tuple(
        _mean_column(motion_title(motion) or f'all {len(found)}', found, strategies)
        for motion, found in _mean_groups(groups)
    )
    if means:
        blocks.append(Block('Means', means))
    return Table(tuple(strategies), tuple(blocks), (*remarks, *_mean_remarks(groups, strategies)))


def motion_title(motion: Motion | None) -> str:
    """The heading of a block."""
    return '' if motion is None else str(motion).replace('_', ' ').capitalize()


def mean_metrics(found: Sequence[Mapping[str, Entry]], strategies: Sequence[str]) -> list[Metrics]:
    """Means over sequences, for each strategy.

    A number counts for a sequence only where every strategy has it, else the strategies would be
    compared on different drives.

    Args:
        found: The entries of each sequence, by strategy.
        strategies: Names.

    Returns:
        The means in the order of the strategies.
    """
    means: list[Metrics] = [{} for _ in strategies]
    for row in ROWS:
        complete = [
            values
            for entries in found
            if None not in (values := _values(row.name, entries, strategies))
        ]
        for index, metrics in enumerate(means):
            column = [float(values[index] or 0.0) for values in complete]
            metrics[row.name] = sum(column) / len(column) if column else None
    return means


def _column(title: str, entries: Sequence[Entry | None], mean: bool = False) -> Column:
    metrics = [{} if entry is None else entry.metrics for entry in entries]
    names = [None if entry is None else entry.strategy for entry in entries]
    return Column(title, tuple(_cells(row, metrics, names, mean) for row in ROWS))


def _cells(
    row: Row, metrics: Sequence[Metrics], strategies: Sequence[str | None], mean: bool
) -> tuple[Cell, ...]:
    write = row.mean_text if mean else row.text
    texts = [write(item.get(row.name)) for item in metrics]
    marks = rank(
        row,
        [
            None if row.fixed_for_base and strategy == BASE else text
            for strategy, text in zip(strategies, texts, strict=True)
        ],
    )
    return tuple(Cell(text, mark) for text, mark in zip(texts, marks, strict=True))


def rank(row: Row, texts: Sequence[str | None]) -> list[Mark]:
    """Marks of the best and the second best of printed numbers; None takes no part.

    What is printed decides, so that numbers that look equal are marked alike. Nothing is marked
    where all are equal, and no second where only two are compared.
    """
    values = [
        None if text is None or text == NO_VALUE or row.unranked else float(text) for text in texts
    ]
    order = sorted({value for value in values if value is not None}, reverse=row.higher)
    compared = sum(value is not None for value in values)
    if len(order) < 2:
        return [Mark.NONE] * len(texts)
    best = sum(value == order[0] for value in values)
    marks = {order[0]: Mark.BEST}
    if compared > 2 and best == 1:
        marks[order[1]] = Mark.SECOND
    return [Mark.NONE if value is None else marks.get(value, Mark.NONE) for value in values]


def mean_entries(entries: Sequence[Entry], strategies: Sequence[str]) -> list[Entry]:
    """Means of each motion and of everything, as entries of the sequence ``mean``."""
    return [
        Entry(MEAN, motion, strategy, metrics)
        for motion, found in _mean_groups(_grouped(entries))
        for strategy, metrics in zip(strategies, mean_metrics(found, strategies), strict=True)
    ]


def _grouped(entries: Sequence[Entry]) -> Groups:
    """Entries by motion in the paper's order, sequence and strategy."""
    groups: Groups = {motion: {} for motion in (*Motion, None)}
    for entry in entries:
        groups[entry.motion].setdefault(entry.sequence, {})[entry.strategy] = entry
    return {motion: found for motion, found in groups.items() if found}


def _mean_groups(groups: Groups) -> list[tuple[Motion | None, list[dict[str, Entry]]]]:
    """What means are taken over: each motion with several sequences, then everything."""
    means: list[tuple[Motion | None, list[dict[str, Entry]]]] = [
        (motion, list(found.values()))
        for motion, found in groups.items()
        if motion is not None and len(groups) > 1 and len(found) > 1
    ]
    everything = [item for found in groups.values() for item in found.values()]
    return [*means, (None, everything)] if len(everything) > 1 else means


def _mean_column(
    title: str, found: Sequence[Mapping[str, Entry]], strategies: Sequence[str]
) -> Column:
    entries = [
        Entry(MEAN, None, strategy, metrics)
        for strategy, metrics in zip(strategies, mean_metrics(found, strategies), strict=True)
    ]
    return _column(title, entries, mean=True)


def _mean_remarks(groups: Groups, strategies: Sequence[str]) -> list[str]:
    """Which rows have a mean over fewer sequences than there are."""
    found = [item for sequences in groups.values() for item in sequences.values()]
    short: dict[int, list[str]] = {}
    for row in ROWS:
        complete = sum(None not in _values(row.name, item, strategies) for item in found)
        known = any(entry.metrics.get(row.name) is not None for e in found for entry in e.values())
        if known and complete < len(found) > 1:
            short.setdefault(complete, []).append(row.title)
    return [
        f'Means over {count} of {len(found)}, where every strategy has the number: '
        f'{"; ".join(titles)}.'
        for count, titles in sorted(short.items())
    ]


def _values(
    name: str, entries: Mapping[str, Entry], strategies: Sequence[str]
) -> list[float | int | None]:
    return [
        entries[strategy].metrics.get(name) if strategy in entries else None
        for strategy in strategies
    ]
