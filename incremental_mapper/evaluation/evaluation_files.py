"""The files of an evaluation: ``table.csv``, ``table.md`` and ``table.tex``."""

from dataclasses import dataclass

from incremental_mapper.errors import OutputError
from incremental_mapper.evaluation import cache
from incremental_mapper.evaluation.record import Evaluation, entries
from incremental_mapper.evaluation.reference import comparison
from incremental_mapper.evaluation.table import Entry, Table, make_table, mean_entries
from incremental_mapper.evaluation.table_csv import write_csv
from incremental_mapper.evaluation.table_formats import latex_table, markdown_table


@dataclass(frozen=True, slots=True)
class Reference:
    """Numbers to stand beside ours, and what they are called."""

    title: str
    entries: tuple[Entry, ...]


def write_tables(evaluation: Evaluation, by_motion: bool, reference: Reference | None) -> Table:
    """Write the table in all formats; returns it. Raises OutputError."""
    found = entries(evaluation, by_motion)
    table = make_table(found, evaluation.strategies, evaluation.remarks)
    beside = '' if reference is None else comparison(found, reference.entries, reference.title)
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


def _page(evaluation: Evaluation, table: Table, beside: str) -> str:
    parts = ['# Strategies compared', markdown_table(table)]
    if evaluation.caption:
        parts.insert(1, evaluation.caption)
    if beside:
        parts += ['## Beside the reference', beside]
    parts += ['## Made by', _origin(evaluation)]
    return '\n\n'.join(parts) + '\n'


def _origin(evaluation: Evaluation) -> str:
    versions = ', '.join(f'{name} {version}' for name, version in cache.program().items())
    return '\n'.join(
        [
            '```sh',
            evaluation.command,
            '```',
            '',
            f'Settings: {evaluation.settings_from}. Versions: {versions}.',
        ]
    )
