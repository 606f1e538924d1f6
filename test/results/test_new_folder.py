"""Folders that appear when they are complete, and what is left of those that never were."""

import glob
import subprocess
import sys

import pytest

from incremental_mapper.errors import OutputError
from incremental_mapper.results import new_folder
from incremental_mapper.results.new_folder import HiddenFolder, obstacle, write_folder
from incremental_mapper.results.run_folder import prepared_folder

KILLED = """
import os, signal, sys
from pathlib import Path
from incremental_mapper.results.new_folder import HiddenFolder
hidden = HiddenFolder(Path(sys.argv[1]))
for name in sys.argv[2:]:
    (hidden.path / name).write_text('a map')
os.kill(os.getpid(), signal.SIGKILL)
"""


def killed(target, *names):
    """What a program leaves that is killed while it writes into a folder."""
    done = subprocess.run([sys.executable, '-c', KILLED, str(target), *names], check=False)
    assert done.returncode == -9
    (left,) = target.parent.glob(glob.escape(f'.{target.name}.') + '*')
    return left


def write(folder):
    (folder / 'stats.json').write_text('{}')


def test_what_a_killed_program_left_is_removed_by_the_next_one(tmp_path):
    target = tmp_path / 'map [1]'
    left = killed(target, 'graph.json', '.map.ply.partial', 'failed_window_3.npz', 'map.laz')
    assert write_folder(target, write) == target
    assert not left.exists() and [path.name for path in tmp_path.iterdir()] == [target.name]


def test_what_is_not_ours_stays(tmp_path):
    target = tmp_path / 'map'
    left = killed(target, 'graph.json', 'notes.txt')
    write_folder(target, write)
    assert (left / 'notes.txt').read_text() == 'a map'


def test_what_is_being_written_stays(tmp_path):
    target = tmp_path / 'map'
    first = HiddenFolder(target)
    write(first.path)
    second = HiddenFolder(target)
    write(second.path)
    assert first.appear(target) == target
    assert second.appear(target) == tmp_path / 'map_2'
    for hidden in (first, second):
        hidden.drop()
    assert {path.name for path in tmp_path.iterdir()} == {'map', 'map_2'}
    assert (target / 'stats.json').is_file()


def test_a_name_that_is_taken_in_the_last_moment_is_passed_over(tmp_path, monkeypatch):
    target = tmp_path / 'map'
    free = new_folder.free_name

    def taken(wanted):
        place = free(wanted)
        if place == target:
            place.mkdir()
            write(place)
        return place

    monkeypatch.setattr(new_folder, 'free_name', taken)
    assert write_folder(target, write) == tmp_path / 'map_2'


def test_a_folder_with_nothing_but_an_unfinished_file_is_empty(tmp_path):
    (tmp_path / '.candidates.parquet.partial').write_text('PAR1')
    with prepared_folder(tmp_path, force=False):
        assert list(tmp_path.iterdir()) == []
    (tmp_path / '.notes.partial').touch()
    with pytest.raises(OutputError, match='not empty'), prepared_folder(tmp_path, force=False):
        pass


def test_what_is_in_the_way_of_a_folder_is_known_before_it_is_made(tmp_path):
    (tmp_path / 'file').touch()
    assert obstacle(tmp_path / 'hall') == obstacle(tmp_path / 'some' / 'hall') == ''
    assert obstacle(tmp_path / 'file' / 'hall') == f'{tmp_path}/file is no folder'
    assert not (tmp_path / 'some').exists()
