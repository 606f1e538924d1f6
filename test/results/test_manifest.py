"""Checksums of a run's files: who builds on a damaged folder refuses it, who looks at it warns."""

import json

import numpy as np
import pytest

from incremental_mapper.cli.main import main
from incremental_mapper.errors import InputError
from incremental_mapper.map.ply import MapCloud, write_ply
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.results.journal.recovery import find_journals
from incremental_mapper.results.manifest import FILE, FORMAT, Manifest, require_whole


@pytest.fixture
def folder(tmp_path):
    write_ply(tmp_path / 'map.ply', MapCloud.bare(np.ones((5, 3), dtype=np.float32)))
    (tmp_path / 'stats.json').write_text('{"strategy": "mom"}')
    names = ['map.ply', 'stats.json']
    (tmp_path / FILE).write_text(Manifest.of(tmp_path, names).to_text())
    return tmp_path


def change(path):
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(data)


def test_whole_folder_is_taken_and_not_spoken_of(folder, caplog):
    assert set(require_whole(folder).files) == {'map.ply', 'stats.json'}
    run = FinishedRun(folder)
    assert len(run.points) == 5 and run.stats == {'strategy': 'mom'}
    assert caplog.text == ''
    assert find_journals(folder) == []


def test_recovering_a_whole_folder_is_no_failure_unless_a_map_is_wanted_elsewhere(folder, capsys):
    assert main(['recover', str(folder)]) == 0
    told = capsys.readouterr()
    assert told.out == f'{folder}: is the folder of a finished run, and whole; nothing is missing\n'
    assert told.err == ''
    wanted = folder.parent / 'elsewhere'
    assert main(['recover', str(folder), '--out', str(wanted)]) == 1
    told = capsys.readouterr()
    assert f'finished run, and whole; {wanted} was not made' in told.err
    assert told.out == '' and not wanted.exists()


def test_damaged_file_is_refused_by_name_and_read_with_a_warning(folder, caplog):
    change(folder / 'map.ply')
    for refuse in (require_whole, find_journals):
        with pytest.raises(InputError, match=r'map\.ply cannot be trusted: damaged or changed'):
            refuse(folder)
    run = FinishedRun(folder)
    assert run.stats == {'strategy': 'mom'} and caplog.text == ''
    assert len(run.points) == 5
    run.check()
    (record,) = caplog.records
    assert 'map.ply: damaged or changed since it was written' in record.getMessage()


def test_missing_file_is_no_whole_folder(folder):
    (folder / 'stats.json').unlink()
    with pytest.raises(InputError, match=r'stats\.json cannot be trusted'):
        require_whole(folder)


def test_older_folder_is_refused_and_read_without_a_word(folder, caplog):
    (folder / FILE).unlink()
    with pytest.raises(InputError, match=r'has no files\.json: it is not complete, or an older'):
        require_whole(folder)
    assert len(FinishedRun(folder).points) == 5 and caplog.text == ''


def test_folder_of_another_format_is_refused_with_both_numbers(folder, caplog):
    tree = json.loads((folder / FILE).read_text())
    (folder / FILE).write_text(json.dumps({**tree, 'format': FORMAT + 1}))
    with pytest.raises(InputError, match=f'has format {FORMAT + 1} of version .* reads {FORMAT}'):
        require_whole(folder)
    assert len(FinishedRun(folder).points) == 5
    assert f'has format {FORMAT + 1}' in caplog.text


@pytest.mark.parametrize('text', ['', '[]', '{"format": 1}', '{"format": 1, "files": 3}'])
def test_damaged_list_is_refused_and_read_with_a_warning(folder, caplog, text):
    (folder / FILE).write_text(text)
    with pytest.raises(InputError, match='is damaged, or no list of the files of a run'):
        require_whole(folder)
    assert len(FinishedRun(folder).points) == 5
    assert caplog.text.count('is damaged') == 1
