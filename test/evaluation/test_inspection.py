"""``inspect`` shows what a window chose from; what it says is what the mapper decided."""

import csv
import json
import shutil

import pytest

from incremental_mapper.cli.main import main
from incremental_mapper.evaluation.inspection import inspect_window, why
from incremental_mapper.results.finished_run import FinishedRun

pytest.importorskip('pyarrow', reason='pyarrow is not installed (extra "report")')


@pytest.fixture(scope='module')
def folder(light_drive, tmp_path_factory):
    """A run of the method; not to be written to."""
    out = tmp_path_factory.mktemp('inspect') / 'out'
    settings = tmp_path_factory.mktemp('settings') / 'settings.yaml'
    settings.write_text('mom:\n  max_points: 100\n')
    assert main(['map', str(light_drive), str(out), '--config', str(settings)]) == 0
    return out


@pytest.fixture
def inspect(capsys):
    def run(*arguments):
        capsys.readouterr()
        status = main(['inspect', *map(str, arguments)])
        printed = capsys.readouterr()
        return status, printed.out, printed.err

    return run


def row(index, score=None, **more):
    """A row of candidates.parquet with one cluster of two measurements unless told."""
    return {
        'candidate': index, 'winner': False, 'connected': True, 'score': score, 'vertices': 6,
        'score_name': 'mom_3', 'tied': None, 'clusters': [[{'stamp_ns': 1}], [{'stamp_ns': 2}]],
    } | more  # fmt: skip


MERGED = [[{'stamp_ns': 1}, {'stamp_ns': 2}]]


@pytest.mark.parametrize(
    ('rows', 'words'),
    [
        ([], ['nothing to choose']),
        ([row(0, connected=False), row(1, connected=False)], ['None of the 2', 'carried']),
        ([row(0)], ['could be solved', 'carried']),
        ([row(0, 0.5, winner=True), row(1, connected=False)], ['only connected one']),
        ([row(0, 0.5, winner=True), row(1)], ['only one of 2 connected that was judged']),
        (
            [row(0, 0.9, winner=True), row(1, 1.0)],
            ['lowest score of the 2', '10 % below candidate 1'],
        ),
        (
            [row(0, 0.5), row(1, 0.5, winner=True, vertices=4)],
            ['shares the lowest score', 'candidate 0', 'fewest vertices', '4'],
        ),
        (
            [row(0, 0.5, winner=True), row(1, 0.5, clusters=MERGED), row(2, 0.5, vertices=9)],
            ['shares the lowest score', 'candidate 1, 2', '6 vertices', 'finest partition'],
        ),
        (
            [row(0, 0.5, winner=True), row(1, 0.5)],
            ['shares the lowest score', 'earlier cuts'],
        ),
        (
            [row(0, 0.5, winner=True), row(1, 0.6), row(2, clusters=MERGED)],
            ['lowest score', 'merge measurements were not judged', 'velocity'],
        ),
        (
            [row(0, 0.5, winner=True, clusters=MERGED), row(1, 0.6), row(2)],
            ['lowest score', '1 were not judged'],
        ),
        (
            [
                row(0, 0.50, tied=True, vertices=9),
                row(1, 0.51, tied=True, vertices=4, winner=True),
                row(2, 0.52, tied=True, vertices=2),
                row(3, 0.90, tied=False, vertices=2),
            ],
            [
                'Candidate 0 has the lowest',
                '2 others',
                'Candidate 1 is the smallest',
                '4 vertices instead of 9',
                '1 that tie are smaller still',
            ],
        ),
        ([row(0, winner=True, score_name='base')], ['won unseen', 'one cluster a measurement']),
        (
            [row(0, winner=True, score_name='base', connected=False)],
            ['not connected', 'regularising priors'],
        ),
        ([row(0, winner=True, score_name='bridged', connected=False)], ['bridge factors']),
    ],
)
def test_reasons(rows, words):
    text = ' '.join(why(rows, cut=False, strategy='mom'))
    for word in words:
        assert word in text


def test_cut_search_is_told():
    rows = [row(0, 0.5, winner=True), row(1, 0.6)]
    assert 'search was cut' in ' '.join(why(rows, cut=True, strategy='mom'))
    assert 'search was cut' not in ' '.join(why(rows, cut=False, strategy='mom'))


def test_every_window_can_be_inspected(folder):
    run = FinishedRun(folder)
    for index, window in enumerate(run.windows):
        found = inspect_window(run, index)
        assert len(found.candidates) == int(window['candidates_enumerated'])
        assert found.reasons
        if found.candidates:
            best = found.candidates[0]
            assert best['winner'] is (window['clusters'] != '0')
            assert best['members'] == window['members']
            scores = [c['score'] for c in found.candidates if c['score'] is not None]
            assert scores[1:] == sorted(scores[1:])  # the winner is first, and may tie
            if scores:
                assert best['score'] == pytest.approx(float(window['score']), rel=1e-12)


def test_text_fits_the_terminal_and_shows_all(folder, inspect):
    status, out, _ = inspect(folder, 5)
    rows = inspect_window(FinishedRun(folder), 5).candidates
    assert status == 0
    assert max(map(len, out.splitlines())) <= 100
    assert out.startswith('Window 5, ')
    assert len(rows) > 1
    for candidate in rows:
        assert candidate['members'].replace('|', ' | ') in out
        if candidate['score'] is not None:
            assert f'{candidate["score"]:.6g}' in out
    starred = [line for line in out.splitlines() if line.startswith('*  ')]
    assert len(starred) == 1
    assert f'Candidate {rows[0]["candidate"]} ' in out


def test_long_partitions_are_wrapped(map_light, light_drive, inspect):
    config = 'window:\n  duration: 0.5\nselection:\n  max_candidates: 30\n'
    run = map_light(light_drive, config=config, strategy='min_time_shift')
    crowded = max(run.rows, key=lambda row: int(row['core']))
    assert int(crowded['core']) > 8
    status, out, _ = inspect(run.folder, crowded['window'])
    assert status == 0
    assert max(map(len, out.splitlines())) <= 100


def test_window_at_a_time(folder, inspect):
    run = FinishedRun(folder)
    window = run.windows[7]
    middle = (int(window['start_ns']) + int(window['end_ns'])) // 2
    seconds = f'{run.seconds(middle):.6f}'
    stamp = f'{middle // 10**9}.{middle % 10**9:09d}'
    texts = {inspect(folder, *words)[1] for words in (
        [7], ['--at', seconds], ['--at', stamp], ['--at', str(middle)],
    )}  # fmt: skip
    assert len(texts) == 1


def test_json_and_csv_hold_the_same(folder, inspect):
    tree = json.loads(inspect(folder, 6, '--format', 'json')[1])
    table = list(csv.DictReader(inspect(folder, 6, '--format', 'csv')[1].splitlines()))
    assert [str(c['candidate']) for c in tree['candidates']] == [c['candidate'] for c in table]
    assert [c['members'] for c in tree['candidates']] == [c['members'] for c in table]
    assert tree['window']['window'] == '6' and tree['reasons']
    for one, other in zip(tree['candidates'], table, strict=True):
        assert len(one['connections']) == len(other['connections'].split())
        assert (one['score'] is None) == (other['score'] == '')


def test_what_is_wrong_is_said(folder, inspect, tmp_path):
    last = len(FinishedRun(folder).windows) - 1
    for arguments, words in (
        ([folder, 9999], ['no window 9999', f'windows 0 to {last}']),
        ([folder, '--at', '500'], ['no window at 500.000 s']),
        ([folder, '--at', 'noon'], ["'noon' is no time"]),
        ([folder, '--at', 'nan'], ["'nan' is no time"]),
        ([folder, '--at', '1e99999999'], ["'1e99999999' is no time"]),
        ([folder, '--at', 'inf'], ["'inf' is no time"]),
        ([folder], ['either by its number or by --at']),
        ([folder, 3, '--at', '1'], ['either by its number or by --at']),
        ([tmp_path, 3], ['is no output of "incremental_mapper map"']),
        ([tmp_path / 'nowhere', 3], ['no such folder']),
    ):
        status, out, err = inspect(*arguments)
        assert status == 1 and out == '' and len(err.splitlines()) == 1
        for word in words:
            assert word in err


def test_run_without_the_table(folder, inspect, tmp_path):
    copy = shutil.copytree(folder, tmp_path / 'copy')
    (copy / 'candidates.parquet').unlink()
    assert 'map the drive again' in inspect(copy, 3)[2]
    (copy / 'candidates.parquet').write_text('no parquet')
    status, _, err = inspect(copy, 3)
    assert status == 1 and 'is no table of candidates' in err
