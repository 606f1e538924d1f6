"""Where a map goes: its place, a place beside it, the fallback, or what there is of it."""

import json
import os
from collections import Counter
from pathlib import Path

import pytest
from full_disk import largest_file

from incremental_mapper.datasets.open import open_source
from incremental_mapper.errors import OutputError
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.results.candidate_spool import CandidateSpool
from incremental_mapper.results.candidate_table import candidate_rows
from incremental_mapper.results.draw import main as draw
from incremental_mapper.results.file_names import FILES
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.results.opened_drive import effective_config
from incremental_mapper.results.run_statistics import InputFacts
from incremental_mapper.ros.saving import Snapshot, Target, save_map, write_candidates

QUICK = {'selection': {'strategy': 'min_time_shift'}, 'odometry': {'method': 'gicp'}}


@pytest.fixture(scope='module')
def mapped(light_drive):
    """A mapper that has mapped a drive, and its windows."""
    source = open_source(light_drive, QUICK)
    mapper = Mapper(effective_config(source, QUICK, 'test'))
    windows = [window for item in source.measurements() for window in mapper.push(item)]
    yield mapper, windows + mapper.flush()
    mapper.close()


@pytest.fixture(scope='module')
def snapshot(mapped):
    return Snapshot(mapped[0], Counter(), 1.0, InputFacts('here', 'test', {}), (), 1.0)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_all_data_files_and_nothing_else(snapshot, tmp_path):
    first = save_map(Target(tmp_path / 'map'), snapshot)
    assert first.folder == tmp_path / 'map' and first.trouble == ''
    assert names(first.folder) == sorted(FILES)
    assert save_map(Target(tmp_path / 'map'), snapshot).folder == tmp_path / 'map_2'
    assert names(tmp_path) == ['map', 'map_2']


def test_fallback_takes_what_the_place_cannot(snapshot, tmp_path):
    (tmp_path / 'file').touch()
    target = Target(tmp_path / 'file' / 'map', tmp_path / 'else')
    saved = save_map(target, snapshot)
    assert saved.folder == tmp_path / 'else' / 'map'
    assert names(saved.folder) == sorted(FILES)
    assert f'{target.folder}: cannot be written (File exists)' in saved.trouble


def test_trajectory_and_graph_are_saved_where_the_points_have_no_room(snapshot, tmp_path):
    whole = save_map(Target(tmp_path / 'whole'), snapshot).folder
    others = max((whole / name).stat().st_size for name in FILES if name != 'map.ply')
    assert (whole / 'map.ply').stat().st_size > others + 10_000
    with largest_file(others + 5_000):
        saved = save_map(Target(tmp_path / 'map', tmp_path / 'else'), snapshot)
    assert saved.folder == tmp_path / 'map_incomplete' and 'map.ply' in saved.trouble
    assert names(saved.folder) == sorted(set(FILES) - {'map.ply', 'files.json'})
    graphs = [json.loads((folder / 'graph.json').read_text()) for folder in (whole, saved.folder)]
    assert graphs[0] == graphs[1]
    assert names(tmp_path) == ['else', 'map_incomplete', 'whole'] and names(tmp_path / 'else') == []


def test_g2o_that_gtsam_cuts_short_is_noticed(snapshot, tmp_path):
    whole = save_map(Target(tmp_path / 'whole'), snapshot).folder
    sizes = {name: (whole / name).stat().st_size for name in FILES}
    assert sizes['graph.json'] > 2 * sizes['trajectory.tum']
    with largest_file(sizes['trajectory.tum'] + 500), pytest.raises(OutputError):
        save_map(Target(tmp_path / 'map'), snapshot)
    assert names(tmp_path) == ['whole']


def test_candidates_are_those_of_the_windows(mapped, tmp_path):
    pytest.importorskip('pyarrow', reason='pyarrow is not installed (extra "report")')
    _, windows = mapped
    spool = CandidateSpool(tmp_path)
    for window in windows:
        spool.add(window)
    assert write_candidates(tmp_path, spool) is None
    (tmp_path / 'stats.json').write_text('{"strategy": "mom"}')
    run = FinishedRun(tmp_path)
    for window in windows:
        assert [row['members'] for row in run.candidates(window.index)] == [
            row['members'] for row in candidate_rows(window)
        ]
    assert sum(len(run.candidates(window.index)) for window in windows) > len(windows)


def test_spool_without_room_ends_and_says_so(mapped, tmp_path):
    pytest.importorskip('pyarrow', reason='pyarrow is not installed (extra "report")')
    _, windows = mapped
    spool = CandidateSpool(tmp_path)
    with largest_file(3000):
        for window in windows:
            spool.add(window)
    assert 0 < len(list(spool.windows())) < len(windows)
    remark = write_candidates(tmp_path, spool)
    assert remark == f'candidates.parquet ends early: {os.strerror(27)}'


def test_pictures_are_drawn_from_the_folder(snapshot, tmp_path):
    pytest.importorskip('matplotlib', reason='matplotlib is not installed (extra "report")')
    folder = save_map(Target(tmp_path / 'map'), snapshot).folder
    assert draw([str(folder)]) == 0
    pictures = {'trajectory.png', 'map.png', 'graph.png'}
    assert set(names(folder)) == {*FILES, *pictures}
    for name in pictures:
        assert (folder / name).read_bytes().startswith(b'\x89PNG')


def test_pictures_of_no_folder_are_no_traceback(capsys):
    assert draw([str(Path('/nowhere'))]) == 1
    assert capsys.readouterr().err.count('\n') == 1
