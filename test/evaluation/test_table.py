"""The table: its rows, marks and means, in every format, and a reference beside it."""

import csv
import re
from pathlib import Path

import pytest

from incremental_mapper.errors import InputError
from incremental_mapper.evaluation.segments import Motion
from incremental_mapper.evaluation.table import (
    PAPER_ROWS,
    ROWS,
    Entry,
    Mark,
    Row,
    make_table,
    mean_entries,
    rank,
)
from incremental_mapper.evaluation.table_files import Reference, read_csv, write_csv
from incremental_mapper.evaluation.table_text import (
    comparison,
    latex_table,
    markdown_table,
    plain_table,
)

BEST, SECOND, NONE = Mark.BEST, Mark.SECOND, Mark.NONE
STRATEGIES = ('base', 'mom', 'min_time_shift', 'min_solver_error')
PAPER = Path(__file__).parents[2] / 'docs' / 'paper.csv'
LOW = Row('rpe_translation_rmse_m', 'RPE, m', 3)
HIGH = Row('compression_vertices_percent', 'Compression, %', 2, higher=True)


@pytest.fixture(scope='module')
def paper():
    return read_csv(PAPER)


def entry(sequence, strategy, motion=None, error=None, **metrics):
    return Entry(sequence, motion, strategy, metrics, error)


def test_rows_are_those_of_the_paper_in_its_order():
    assert [row.name for row in PAPER_ROWS] == [
        'total_time_shift_s',
        'solver_error',
        'rpe_translation_rmse_m',
        'rpe_rotation_rmse_deg',
        'clusters',
        'vertices',
        'factors',
        'compression_vertices_percent',
    ]
    assert ROWS[: len(PAPER_ROWS)] == PAPER_ROWS


@pytest.mark.parametrize(
    ('row', 'texts', 'marks'),
    [
        (LOW, ['0.3', '0.1', '0.2', '0.4'], [NONE, BEST, SECOND, NONE]),
        (HIGH, ['0.00', '31.1', '33.0', '31.2'], [NONE, NONE, BEST, SECOND]),
        (LOW, ['0.1', '0.1', '0.2', '0.3'], [BEST, BEST, NONE, NONE]),
        (LOW, ['0.1', '0.2', '0.2', '0.3'], [BEST, SECOND, SECOND, NONE]),
        (LOW, ['0.1', '0.1', '0.1'], [NONE, NONE, NONE]),
        (LOW, ['0.2', '0.1'], [NONE, BEST]),
        (LOW, ['–', '0.2', '0.1', '0.3'], [NONE, SECOND, BEST, NONE]),
        (LOW, [None, '0.2', '0.1'], [NONE, NONE, BEST]),
        (LOW, ['–', '–'], [NONE, NONE]),
        (LOW, [], []),
    ],
)
def test_best_and_second_best_are_marked(row, texts, marks):
    assert rank(row, texts) == marks


def test_base_takes_no_part_where_its_number_is_fixed():
    table = make_table(
        [
            entry('a', 'base', compression_vertices_percent=0.0, map_distance_m=0.0),
            entry('a', 'mom', compression_vertices_percent=-2.0, map_distance_m=0.02),
            entry('a', 'min_time_shift', compression_vertices_percent=-1.0, map_distance_m=0.01),
        ],
        STRATEGIES[:3],
    )
    cells = table.blocks[0].columns[0].cells
    by_name = {row.name: [cell.mark for cell in cells[i]] for i, row in enumerate(ROWS)}
    assert by_name['compression_vertices_percent'] == [NONE, NONE, BEST]
    assert by_name['map_distance_m'] == [NONE, NONE, BEST]


def test_equal_prints_are_marked_alike():
    table = make_table(
        [
            entry('a', name, rpe_translation_rmse_m=value)
            for name, value in zip(STRATEGIES, (0.00501, 0.00502, 0.2, 0.3), strict=True)
        ],
        STRATEGIES,
    )
    assert [cell.mark for cell in table.blocks[0].columns[0].cells[2]] == [BEST, BEST, NONE, NONE]


def test_papers_own_table_comes_out_as_it_was_printed(paper):
    table = make_table(paper, STRATEGIES)
    assert [block.title for block in table.blocks] == [
        'Zero speed',
        'Acceleration',
        'Constant speed',
        'Deceleration',
        'Means',
    ]
    for block in table.blocks[:4]:
        assert [column.title for column in block.columns] == ['urban-26', 'urban-33', 'urban-38']
    first = table.blocks[0].columns[0].cells
    rpe = [cell.mark for cell in first[2]]
    compression = [cell.mark for cell in first[7]]
    assert rpe == [BEST, SECOND, NONE, NONE]  # as in the paper's colours
    assert compression == [NONE, NONE, SECOND, BEST]
    assert [cell.text for cell in first[4]] == ['211', '165', '210', '202']
    means = table.blocks[4].columns
    assert [column.title for column in means][-1] == 'all 12'
    assert float(means[-1].cells[7][1].text) == pytest.approx(29.28, abs=0.01)
    assert float(means[0].cells[7][1].text) == pytest.approx((31.17 + 27.32 + 16.59) / 3, abs=0.01)


def test_means_are_over_sequences_where_every_strategy_has_the_number():
    entries = [
        entry('a', 'base', clusters=10, ate_rmse_m=1.0),
        entry('a', 'mom', clusters=8, ate_rmse_m=0.5),
        entry('b', 'base', clusters=20),
        entry('b', 'mom', clusters=14, ate_rmse_m=100.0),
        entry('c', 'base', error='broken'),
        entry('c', 'mom', clusters=1000),
    ]
    base, mom = mean_entries(entries, STRATEGIES[:2])
    assert (base.metrics['clusters'], mom.metrics['clusters']) == (15.0, 11.0)
    assert (base.metrics['ate_rmse_m'], mom.metrics['ate_rmse_m']) == (1.0, 0.5)
    assert base.metrics['factors'] is None
    remarks = make_table(entries, STRATEGIES[:2], ['first']).remarks
    assert remarks[0] == 'first'
    assert [
        remark for remark in remarks if remark.startswith('Means over 2 of 3') and 'Clu' in remark
    ]
    assert [
        remark for remark in remarks if remark.startswith('Means over 1 of 3') and 'ATE' in remark
    ]
    assert not [remark for remark in remarks if 'Factors' in remark]


def test_one_sequence_has_no_means(paper):
    assert [block.title for block in make_table(paper[:4], STRATEGIES).blocks] == ['Zero speed']
    assert mean_entries(paper[:4], STRATEGIES) == []


def test_drive_cut_by_motion_keeps_its_name():
    entries = [entry('zero_speed_a', 'mom', motion=motion, clusters=3) for motion in Motion]
    blocks = make_table(entries, ['mom']).blocks
    assert {column.title for block in blocks[:4] for column in block.columns} == {'zero_speed_a'}


@pytest.mark.parametrize('width', [40, 80, 132, 400])
def test_plain_table_holds_every_number_at_any_width(paper, width):
    table = make_table(paper, STRATEGIES, ['a remark'])
    text = plain_table(table, width)
    assert text.count('Compression, %') >= (15 if width == 40 else 1)
    if width >= 80:
        assert max(map(len, text.splitlines())) <= width
    for item in paper:
        assert f'{item.metrics["vertices"]:.0f}' in text
    assert table.remarks[0] == 'a remark'
    assert text.splitlines()[-len(table.remarks) :] == list(table.remarks)
    lines = [line for line in text.splitlines() if line.startswith('Compression, %')]
    best = [word for line in lines for word in line.split() if word.endswith('*')]
    assert '34.81*' in best and '31.65+' in text


def test_markdown_has_a_cell_for_every_column(paper):
    text = markdown_table(make_table(paper, STRATEGIES, ['see_this | there']))
    rows = [line for line in text.splitlines() if line.startswith('|')]
    groups = {line.count('|') for line in rows}
    assert groups <= {1 + 1 + 4 * count for count in (1, 2, 3)}
    assert '**34.81**' in text and '_31.65_' in text
    assert '- see\\_this \\| there' in text
    assert 'min_time' not in text  # underscores would begin italics


def test_latex_is_balanced_and_escaped(paper):
    entries = [*paper, entry('odd_name #1 & {50%}', 'base', clusters=3)]
    text = latex_table(make_table(entries, STRATEGIES, ['no_truth']), 'Drives_of 100 %')
    body = '\n'.join(line for line in text.splitlines() if not line.startswith('%'))
    for name in ('table*', 'adjustbox', 'tabular'):
        begun = body.count(rf'\begin{{{name}}}')
        assert begun == body.count(rf'\end{{{name}}}') > 0
    bare = re.sub(r'\\[&%$#_{}]', '', body)
    assert bare.count('{') == bare.count('}')
    assert not re.search('[_#%]', bare)
    assert r'odd\_name \#1 \& \{50\%\}' in body
    assert r'\textbf{34.81}' in body and r'\underline{31.65}' in body
    for tabular in re.findall(r'\\begin{tabular}{l(r+)}(.*?)\\end{tabular}', bare, re.DOTALL):
        columns, content = tabular
        for line in content.split(r'\\'):
            if '&' in line and 'multicolumn' not in line:
                assert line.count('&') == len(columns)
    assert '–' not in body and '²' not in body
    for rule in (r'\toprule', r'\midrule', r'\bottomrule'):
        assert rule in body


def test_csv_keeps_numbers_as_they_are(tmp_path):
    path = tmp_path / 'table.csv'
    entries = [
        entry(
            'a', 'base', motion=Motion.ZERO, clusters=12, ate_rmse_m=0.1 + 0.2, solver_error=1e-26
        ),
        entry('b', 'base', error='was "broken", really'),
    ]
    write_csv(path, [*entries, Entry('mean', None, 'base', {'clusters': 5.0})])
    found = read_csv(path)
    assert len(found) == 2
    assert found[0].motion is Motion.ZERO
    assert found[0].metrics == {'clusters': 12.0, 'ate_rmse_m': 0.1 + 0.2, 'solver_error': 1e-26}
    assert found[1].metrics == {}
    with path.open(newline='') as file:
        lines = list(csv.reader(file))
    assert lines[2][:4] == ['b', '', 'base', 'was "broken", really']
    assert {len(line) for line in lines} == {4 + len(ROWS)}


@pytest.mark.parametrize(
    'text',
    [
        '',
        'sequence,strategy\n',
        'a,b\n1,2\n',
        'sequence,motion,strategy,clusters\na,flying,b,3\n',
        'sequence,motion,strategy,clusters\na,,b,many\n',
    ],
)
def test_other_files_are_no_reference(tmp_path, text):
    path = tmp_path / 'other.csv'
    path.write_text(text)
    with pytest.raises(InputError, match=r'other.csv: .*expected the columns of a table.csv'):
        read_csv(path)


def test_reference_stands_beside_what_it_has_too(paper):
    own = [
        entry(
            'zero_speed_urban-26',
            'mom',
            motion=Motion.ZERO,
            rpe_translation_rmse_m=0.0021,
            compression_vertices_percent=30.0,
        ),
        entry(
            'zero_speed_urban-33',
            'mom',
            motion=Motion.ZERO,
            rpe_translation_rmse_m=0.0041,
            compression_vertices_percent=40.0,
        ),
        entry('elsewhere', 'mom', rpe_translation_rmse_m=7.0),
    ]
    text = comparison(own, paper, 'paper')
    lines = text.splitlines()
    assert lines[0] == 'Ours / paper:'
    assert '0.0021 / 0.0040' in text and '30.00 / 31.17' in text
    assert 'elsewhere' not in text and '7.0' not in text
    assert '35.00 / 29.25' in lines[-1] and '0.0031 / 0.0065' in lines[-1]
    assert '– / 165' in text
    assert comparison(own[2:], paper, 'paper') == ''


def test_reference_of_other_names_is_matched_by_what_the_user_says():
    own = [Entry('my_drive', None, 'mom', {'clusters': 10.0})]
    theirs = (
        Entry('zero_speed_urban-26', Motion.ZERO, 'mom', {'clusters': 20.0}),
        Entry('zero_speed_urban-33', Motion.ZERO, 'mom', {'clusters': 30.0}),
    )
    assert Reference('paper', theirs).beside(own) == []
    named = Reference('paper', theirs, {'my_drive': 'zero_speed_urban-33'})
    assert '10 / 30' in comparison(own, named.beside(own), 'paper')


def test_the_only_sequence_goes_with_the_only_one_of_the_reference():
    own = [Entry('my_drive', None, 'mom', {'clusters': 10.0})]
    theirs = (Entry('yesterday', None, 'mom', {'clusters': 20.0}),)
    assert '10 / 20' in comparison(own, Reference('before', theirs).beside(own), 'before')
