"""Putting the page together.

Importing this needs jinja2 and matplotlib, which come with the extra ``report``.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from incremental_mapper.evaluation.record import RecordedEvaluation, RecordedSequence, read_record
from incremental_mapper.evaluation.report import words
from incremental_mapper.evaluation.report.charts import strategy_colours
from incremental_mapper.evaluation.report.drawings import (
    Swatch,
    drive_seconds,
    graph_stretches,
    graph_swatches,
    sequence_pictures,
    trade_picture,
)
from incremental_mapper.evaluation.report.rendering import as_yaml, write_page
from incremental_mapper.evaluation.table import (
    FURTHER_ROWS,
    PAPER_ROWS,
    ROWS,
    Row,
    Table,
    make_table,
)
from incremental_mapper.visualization.figure import PAGE, css_colour

TEMPLATE = 'page.html'


def write_report(out_dir: Path) -> Path:
    """Write ``report.html`` into an evaluation's folder; returns its path.

    Raises:
        InputError: The folder holds no evaluation.
        OutputError: The page cannot be written.
    """
    evaluation = read_record(out_dir)
    return write_page(out_dir, TEMPLATE, _context(evaluation))


def _context(evaluation: RecordedEvaluation) -> dict[str, Any]:
    """What the template is filled with."""
    record, lead = evaluation.record, words.lead_strategy(evaluation)
    strategies = evaluation.strategies
    failures = words.failures(evaluation)
    # The page tells of failures by itself.
    remarks = [
        remark
        for remark in record['remarks']
        if not any(reason in remark for _, _, reason in failures)
    ]
    tables = [('By drive', _tables(make_table(evaluation.entries(), strategies, remarks)))]
    pieces = evaluation.motion_entries()
    if pieces:
        tables.append(('By motion', _tables(make_table(pieces, strategies))))
    colours = strategy_colours(strategies, PAGE)
    return {
        'record': record,
        'strategies': [
            Swatch(name, 'line', css_colour(colours[name]), css_colour(colours[name]))
            for name in strategies
        ],
        'lead': lead,
        'what_ran': words.what_ran(evaluation),
        'verdict': [] if lead is None else words.verdict(evaluation, lead),
        'tiles': [] if lead is None else words.tiles(evaluation, lead),
        'failures': failures,
        'tables': tables,
        'trade': trade_picture(evaluation.entries(), strategies),
        'graph_legend': graph_swatches(evaluation.sequences) if lead is not None else [],
        'sequences': [
            _section(evaluation, sequence, number)
            for number, sequence in enumerate(evaluation.sequences, start=1)
        ],
        'settings': as_yaml(record['settings']),
        'effective': _effective(evaluation, lead),
    }


def _section(
    evaluation: RecordedEvaluation, sequence: RecordedSequence, number: int
) -> dict[str, Any]:
    """One drive of the page."""
    return {
        'number': number,
        'name': sequence.name,
        'input': sequence.record['input'],
        'kind': sequence.record['kind'],
        'seconds': drive_seconds(sequence),
        'facts': [] if sequence.lead is None else _facts(sequence, sequence.lead),
        'pictures': list(sequence_pictures(sequence, evaluation.strategies, number)),
        'stretches': list(graph_stretches(sequence, evaluation.strategies, number)),
        'failures': [
            (strategy, reason)
            for name, strategy, reason in words.failures(evaluation)
            if name == sequence.name
        ],
        'flagged': words.flagged(sequence),
    }


def _facts(sequence: RecordedSequence, lead: str) -> list[tuple[str, str]]:
    metrics = sequence.jobs[lead]['metrics']
    rows = {row.name: row for row in ROWS}
    wanted = (
        'compression_vertices_percent',
        'rpe_per_second_translation_rmse_m',
        'ate_rmse_m',
        'rpe_translation_rmse_m',
        'rpe_rotation_rmse_deg',
    )
    return [
        (rows[name].title, rows[name].text(metrics[name]))
        for name in wanted
        if metrics.get(name) is not None
    ]


def _tables(table: Table) -> dict[str, Any]:
    """The table turned: a line for each drive and strategy, a column for each of its rows."""
    places = {row.name: index for index, row in enumerate(ROWS)}

    def part(rows: Sequence[Row]) -> dict[str, Any]:
        return {
            # A unit stays beside its name.
            'titles': [row.title.replace(', ', ',\N{NO-BREAK SPACE}') for row in rows],
            'blocks': [
                {
                    'title': block.title,
                    'columns': [
                        {
                            'title': column.title,
                            'lines': [
                                (name, [column.cells[places[row.name]][index] for row in rows])
                                for index, name in enumerate(table.strategies)
                            ],
                        }
                        for column in block.columns
                    ],
                }
                for block in table.blocks
            ],
        }

    return {'paper': part(PAPER_ROWS), 'beside': part(FURTHER_ROWS), 'remarks': table.remarks}


def _effective(evaluation: RecordedEvaluation, lead: str | None) -> str:
    """All settings of one run of the lead; inputs differ in what they bring themselves."""
    for sequence in evaluation.sequences:
        if lead in sequence.runs and sequence.jobs[lead]['settings']:
            return as_yaml(sequence.jobs[lead]['settings'])
    return ''
