"""The files that hold the table: ``table.csv``, ``table.md`` and ``table.tex``.

``table.csv`` has the numbers for programs, a line a sequence, motion and strategy. The columns
after ``sequence``, ``motion``, ``strategy`` and ``error`` have the names and units of
``stats.json``; a number that does not exist is left empty. Lines of the sequence ``mean`` hold
means. The same layout is read as a reference that stands beside the table: an earlier
``table.csv``, or the paper's numbers.
"""

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from incremental_mapper.errors import InputError, OutputError
from incremental_mapper.evaluation import cache
from incremental_mapper.evaluation.record import Evaluation, entries
from incremental_mapper.evaluation.segments import Motion
from incremental_mapper.evaluation.table import (
    MEAN,
    ROWS,
    Entry,
    Table,
    make_table,
    mean_entries,
)
from incremental_mapper.evaluation.table_text import comparison, latex_table, markdown_table

KEYS = ('sequence', 'motion', 'strategy', 'error')


@dataclass(frozen=True, slots=True)
class Reference:
    """Numbers to stand beside ours, and what they are called.

    ``names`` are the sequences of the reference by ours, where they are called otherwise.
    """

    title: str
    entries: tuple[Entry, ...]
    names: Mapping[str, str] = field(default_factory=dict)

    @property
    def sequences(self) -> list[str]:
        """Names of its sequences."""
        return list(dict.fromkeys(entry.sequence for entry in self.entries))

    def beside(self, own: Sequence[Entry]) -> list[Entry]:
        """Its entries under the names and motions of ours.

        Args:
            own: Our entries. Where ``names`` says nothing, sequences of one name go together,
                and the only one of ours with the only one of the reference.
        """
        ours = list(dict.fromkeys(entry.sequence for entry in own))
        alone = {ours[0]: self.sequences[0]} if len(ours) == len(self.sequences) == 1 else {}
        names = {name: name for name in ours} | alone | dict(self.names)
        motions = {entry.sequence: entry.motion for entry in own}
        return [
            replace(entry, sequence=name, motion=motions.get(name) if pinned else entry.motion)
            for name, theirs in names.items()
            for pinned in [name in self.names or name in alone]
            for entry in self.entries
            if entry.sequence == theirs
        ]


def write_tables(evaluation: Evaluation, by_motion: bool, reference: Reference | None) -> Table:
    """Write the table in all formats.

    Args:
        evaluation: What was run and found.
        by_motion: Whether rows are pieces of drives by motion, instead of whole drives.
        reference: Numbers to stand beside ours in ``table.md``.

    Returns:
        The table.

    Raises:
        OutputError: A file cannot be written.
    """
    found = entries(evaluation, by_motion)
    table = make_table(found, evaluation.strategies, evaluation.remarks)
    beside = ''
    if reference is not None:
        beside = comparison(found, reference.beside(found), reference.title)
    folder = evaluation.out_dir
    try:
        write_csv(folder / 'table.csv', [*found, *mean_entries(found, evaluation.strategies)])
        (folder / 'table.md').write_text(_page(evaluation, table, beside), encoding='utf-8')
        (folder / 'table.tex').write_text(
            latex_table(table, evaluation.caption) + '\n', encoding='utf-8'
        )
    except OSError as error:
        raise OutputError(f'{folder}: cannot be written ({error.strerror})') from error
    return table


def write_csv(path: Path, entries: Iterable[Entry]) -> None:
    """Write the numbers as they are, not rounded as in the table."""
    names = [row.name for row in ROWS]
    with path.open('w', encoding='utf-8', newline='') as file:
        writer = csv.writer(file, lineterminator='\n')
        writer.writerow([*KEYS, *names])
        for entry in entries:
            keys = [entry.sequence, entry.motion or '', entry.strategy, entry.error or '']
            numbers = [entry.metrics.get(name) for name in names]
            writer.writerow([*keys, *('' if number is None else number for number in numbers)])


def read_csv(path: Path) -> list[Entry]:
    """Read a ``table.csv``; columns that are missing hold no number, lines of means are left out.

    Raises:
        InputError: It is no such file, or holds no number.
    """
    try:
        with path.open(encoding='utf-8', newline='') as file:
            lines = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f'{path}: cannot be read ({error})') from error
    entries = []
    for number, line in enumerate(lines, start=2):
        try:
            if line['sequence'] == MEAN:
                continue
            motion = Motion(line['motion']) if line.get('motion') else None
            metrics = {row.name: float(line[row.name]) for row in ROWS if line.get(row.name)}
            entries.append(Entry(line['sequence'], motion, line['strategy'], {**metrics}))
        except (KeyError, ValueError) as error:
            raise InputError(
                f'{path}: line {number} cannot be used ({error}); expected the columns of a '
                'table.csv'
            ) from error
    if not entries:
        raise InputError(f'{path}: holds no numbers; expected the columns of a table.csv')
    return entries


def _page(evaluation: Evaluation, table: Table, beside: str) -> str:
    parts = ['# Strategies compared', markdown_table(table)]
    if evaluation.caption:
        parts.insert(1, evaluation.caption)
    if beside:
        parts += ['## Beside the reference', beside]
    parts += ['## Made by', _origin(evaluation)]
    return '\n\n'.join(parts) + '\n'


def _origin(evaluation: Evaluation) -> str:
    versions = ', '.join(f'{name} {version}' for name, version in cache.own_program().items())
    return '\n'.join(
        [
            '```sh',
            evaluation.command,
            '```',
            '',
            f'Settings: {evaluation.settings_from}. Versions: {versions}.',
        ]
    )
