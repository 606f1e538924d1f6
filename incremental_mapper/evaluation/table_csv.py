"""``table.csv``: the table's numbers for programs, a line a sequence, motion and strategy.

The columns after ``sequence``, ``motion``, ``strategy`` and ``error`` have the names and units of
``stats.json``; a number that does not exist is left empty. Lines of the sequence ``mean`` hold
means. The same layout is read as a reference that stands beside the table: an earlier
``table.csv``, or the paper's numbers.
"""

import csv
from collections.abc import Iterable
from pathlib import Path

from incremental_mapper.errors import InputError
from incremental_mapper.evaluation.segments import Motion
from incremental_mapper.evaluation.table import MEAN, ROWS, Entry

KEYS = ('sequence', 'motion', 'strategy', 'error')


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
    """Read such a file; columns that are missing hold no number. Raises InputError."""
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
