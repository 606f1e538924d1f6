"""candidates.parquet holds every candidate that the windows tell of, and reads back the same."""

import json
import os
import subprocess
import sys

import pytest

from incremental_mapper.datasets.open import open_source
from incremental_mapper.errors import InputError, OutputError
from incremental_mapper.results import candidate_table
from incremental_mapper.results.candidate_table import (
    COLUMNS,
    FILE_NAME,
    candidate_recorder,
    candidate_rows,
    read_window,
)
from incremental_mapper.results.offline_run import map_source
from incremental_mapper.results.opened_drive import effective_config
from incremental_mapper.settings import make_config

parquet = pytest.importorskip('pyarrow.parquet', reason='pyarrow is not installed (extra "report")')
MOM = {'mom': {'max_points': 100}, 'selection': {'tie_confidence': 0.95}}


@pytest.fixture(scope='module')
def recorded(light_drive, tmp_path_factory):
    """The windows of a run, and the file that was written while it ran."""
    path = tmp_path_factory.mktemp('table') / FILE_NAME
    source = open_source(light_drive)
    windows = []
    with candidate_recorder(path) as record:

        def observe(window):
            windows.append(window)
            record(window)

        map_source(source, effective_config(source, MOM, 'test'), observe=observe)
        assert not path.exists(), 'the file has its name only once it is whole'
    return windows, path


def test_what_was_tried_reads_back_the_same(recorded):
    windows, path = recorded
    assert sum(len(window.tried) for window in windows) > 50
    for window in windows:
        rows = read_window(path, window.index)
        assert len(rows) == len(window.tried)
        for row, tried in zip(rows, window.tried, strict=True):
            candidate = tried.candidate
            assert [
                [(core['sensor'], core['stamp_ns']) for core in cluster]
                for cluster in row['clusters']
            ] == [
                [(core.sensor, core.stamp) for core in cluster.members]
                for cluster in candidate.clusters
            ]
            assert [tuple(link.values()) for link in row['connections']] == [
                (link.start, link.end, link.start_stamp, link.end_stamp, link.first_sample)
                for link in candidate.connections
            ]
            assert (row['connected'], row['score'], row['solver_error']) == (
                tried.connected, tried.score, tried.solver_error,
            )  # fmt: skip
            assert row['solved'] is (tried.solver_error is not None)
            assert row['vertices'] == candidate.vertices
            assert row['time_shift_s'] == candidate.time_shift / 1e9
            assert row['winner'] is (candidate == window.winner)
            assert (row['start_ns'], row['end_ns']) == (window.start, window.end)


def test_nothing_imports_pandas_to_write_it(light_drive, tmp_path):
    """It takes half a second, and pyarrow does so for a look at any list."""
    (tmp_path / 'pandas.py').write_text("raise AssertionError('imported')", encoding='utf-8')
    paths = os.pathsep.join([str(tmp_path), os.environ.get('PYTHONPATH', '')])
    code = (
        'import sys; from incremental_mapper import map_drive; '
        "map_drive(*sys.argv[1:], {'selection': {'strategy': 'min_time_shift'}})"
    )
    words = [sys.executable, '-c', code, str(light_drive), str(tmp_path / 'out')]
    subprocess.run(words, check=True, env={**os.environ, 'PYTHONPATH': paths})
    assert (tmp_path / 'out' / FILE_NAME).is_file()


def test_every_window_with_a_winner_has_one(recorded):
    windows, path = recorded
    table = parquet.read_table(path)
    winners = [
        index
        for index, won in zip(table['window'].to_pylist(), table['winner'].to_pylist(), strict=True)
        if won
    ]
    assert winners == [window.index for window in windows if window.winner is not None]


def test_winner_has_the_lowest_score_or_is_smaller_and_ties_with_it(recorded):
    windows, path = recorded
    judged = 0
    for window in windows:
        rows = read_window(path, window.index)
        scores = [row['score'] for row in rows if row['score'] is not None]
        if window.winner is not None and scores:
            judged += 1
            (winner,) = (row for row in rows if row['winner'])
            scored = [row for row in rows if row['score'] is not None]
            lowest = min(scored, key=lambda row: (row['score'], row['vertices']))
            assert lowest['tied'] and winner['tied']
            saved = lowest['vertices'] - winner['vertices']
            assert saved == window.row['saved_vertices']
            assert saved > 0 or winner['score'] == min(scores)
            assert sum(bool(row['tied']) for row in rows) == window.row['tied']
            assert all(row['connected'] and row['solved'] for row in rows if row['winner'])
            assert {row['score_name'] for row in rows} == {window.row['score_name']}
    assert judged > 10
    assert sum(window.row['saved_vertices'] for window in windows) > 5


def test_file_describes_its_columns(recorded):
    schema = parquet.read_schema(recorded[1])
    assert schema.names == list(COLUMNS)
    for field in schema:
        assert field.metadata[b'description'].decode() == COLUMNS[field.name]
    assert json.loads(schema.metadata[b'columns']) == COLUMNS


def test_rows_are_written_in_groups(recorded, tmp_path, monkeypatch):
    windows, path = recorded
    monkeypatch.setattr(candidate_table, 'ROWS_A_GROUP', 20)
    with candidate_recorder(tmp_path / 'small.parquet') as record:
        for window in windows:
            record(window)
    written = parquet.ParquetFile(tmp_path / 'small.parquet')
    groups = [written.metadata.row_group(i).num_rows for i in range(written.num_row_groups)]
    assert len(groups) > 3
    assert all(rows >= 20 for rows in groups[:-1])
    assert written.read().equals(parquet.read_table(path))


def test_windows_of_many_measurements_wait_in_smaller_groups(recorded, tmp_path, monkeypatch):
    """A thousand candidates of a hundred fixes each would else take half a gigabyte."""
    monkeypatch.setattr(candidate_table, 'MEMBERS_A_GROUP', 40)
    path = tmp_path / FILE_NAME
    with candidate_recorder(path) as record:
        for window in recorded[0]:
            record(window)
    written = parquet.ParquetFile(path)
    most = max(
        sum(len(cluster) for cluster in row['clusters'])
        for window in recorded[0]
        for row in candidate_rows(window)
    )
    for group in range(written.num_row_groups):
        rows = written.read_row_group(group).column('clusters').to_pylist()
        assert sum(len(cluster) for row in rows for cluster in row) < 40 + most
    assert written.num_row_groups > 3
    assert written.read().equals(parquet.read_table(recorded[1]))


def test_winner_that_was_not_tried_gets_a_row(recorded):
    """A bridge may take a candidate that the search had left out."""
    from dataclasses import replace

    window = next(item for item in recorded[0] if item.winner is not None and len(item.tried) > 1)
    others = tuple(tried for tried in window.tried if tried.candidate != window.winner)
    rows = list(candidate_rows(replace(window, tried=others)))
    assert len(rows) == len(others) + 1
    assert [row['winner'] for row in rows] == [False] * len(others) + [True]
    assert not rows[-1]['connected'] and not rows[-1]['solved'] and rows[-1]['score'] is None


def test_base_has_a_row_a_window(light_drive, tmp_path):
    source = open_source(light_drive)
    config = effective_config(source, {'selection': {'strategy': 'base'}}, 'test')
    with candidate_recorder(tmp_path / FILE_NAME) as record:
        run = map_source(source, config, observe=record)
    table = parquet.read_table(tmp_path / FILE_NAME)
    assert table.num_rows == sum(row['clusters'] > 0 for row in run.result.rows)
    assert all(table['winner'].to_pylist())
    assert set(table['score_name'].to_pylist()) == {'base'}
    assert table['score'].null_count == table.num_rows


def test_run_that_fails_leaves_no_table(tmp_path):
    with pytest.raises(InputError), candidate_recorder(tmp_path / FILE_NAME):
        raise InputError('the input cannot be used')
    assert list(tmp_path.iterdir()) == []


def test_folder_that_is_missing_is_named(tmp_path):
    with (
        pytest.raises(OutputError, match='nowhere'),
        candidate_recorder(tmp_path / 'nowhere' / FILE_NAME),
    ):
        pass


def test_map_writes_the_table(map_light, light_drive):
    run = map_light(light_drive)
    table = parquet.read_table(run.folder / FILE_NAME)
    assert table.num_rows == run.stats['candidates_enumerated']
    assert sum(table['connected'].to_pylist()) == run.stats['candidates_connected']
    assert sum(table['solved'].to_pylist()) == run.stats['candidates_solved']
    won = [row for row in table.to_pylist() if row['winner']]
    assert sum(row['vertices'] for row in won) == run.stats['vertices']
    shifts = sum(row['time_shift_s'] for row in won)
    assert shifts == pytest.approx(run.stats['total_time_shift_s'], abs=1e-9)


def test_without_pyarrow_the_rest_is_written(map_light, light_drive, monkeypatch):
    monkeypatch.setitem(sys.modules, 'pyarrow', None)
    run = map_light(light_drive, strategy='base')
    assert run.status == 0
    notes = [line for line in run.err.splitlines() if 'missing' in line]
    assert notes == [
        'note: no candidates.parquet and no pictures: pyarrow, matplotlib are missing; '
        'pip install "incremental_mapper[report]"'
    ]
    assert 'real-time factor' in run.out
    assert FILE_NAME not in run.names()


def test_winner_is_told_where_the_search_was_cut(light_drive):
    source = open_source(light_drive)
    tree = {
        'window': {'duration': 0.3},
        'selection': {'max_candidates': 10, 'strategy': 'min_solver_error'},
        'mom': {'max_points': 100},
    }
    seen = []
    map_source(source, make_config(tree | dict(source.info.settings), 'test'), observe=seen.append)
    assert any(window.row['cut'] for window in seen)
    for window in seen:
        won = sum(row['winner'] for row in candidate_rows(window))
        assert won == (window.winner is not None)
