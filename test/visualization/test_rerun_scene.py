"""What Rerun is given, without a viewer: the numbers of a recording are those of the run."""

import subprocess
import sys

import numpy as np
import pytest

from incremental_mapper.errors import InputError, OutputError
from incremental_mapper.visualization import rerun_scene
from incremental_mapper.visualization.rerun_scene import (
    RerunScene,
    check_rrd,
    load_rerun,
)
from incremental_mapper.visualization.shown_candidates import SHOWN, ShownCandidate, table_text

SECOND = 1_000_000_000


def candidate(score, winner=False, members='left|right', tied=None):
    return ShownCandidate(members, 6, score, 0.004, 1.5, winner, tied)


def test_missing_library_is_told_with_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, 'rerun', None)
    with pytest.raises(InputError, match=r'rerun-sdk is missing.*incremental_mapper\[view\]'):
        load_rerun()


def test_file_of_another_suffix_or_in_no_folder_is_refused(tmp_path):
    with pytest.raises(OutputError, match=r'name one with \.rrd'):
        check_rrd(tmp_path / 'run.bag')
    with pytest.raises(OutputError, match='no such folder'):
        check_rrd(tmp_path / 'nowhere' / 'run.rrd')
    check_rrd(tmp_path / 'run.rrd')


def test_table_has_the_best_and_the_winner_wherever_it_is():
    some = [candidate(0.01 + 0.001 * number) for number in range(20)]
    winner = candidate(0.5, winner=True, members='left+right')
    text = table_text([*some, winner], 'mom_3')
    rows = text.splitlines()[4:]
    assert len(rows) == SHOWN + 1
    assert rows[-1].startswith('| **winner** | 0.5 | 4900.000 |') and 'left+right' in rows[-1]
    assert all('left / right' in row for row in rows[:-1])  # a stroke would end the cell


def test_window_without_candidates_has_no_empty_table():
    assert table_text([], '') == 'no candidates: there was nothing to choose in this window'


def test_colours_run_with_the_height_above_the_car():
    colours = rerun_scene._colours(np.array([-50.0, -3.0, 12.0, 90.0]))
    assert np.array_equal(colours[0], colours[1]) and np.array_equal(colours[2], colours[3])
    assert not np.array_equal(colours[1], colours[2])


@pytest.fixture(scope='module')
def printed(tmp_path_factory):
    """A recording as Rerun's own program prints it."""
    pytest.importorskip('rerun', reason='rerun-sdk is not installed (extra "view")')
    path = tmp_path_factory.mktemp('rerun') / 'run.rrd'
    scene = RerunScene(path)
    scene.at(5 * SECOND + 7, 3)
    scene.points(np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]), 0.0)
    scene.turned(np.eye(4))
    scene.points(np.array([[7.0, 8.0, 9.0]]), 0.0)
    # Twice as sure along x as along y, and turned by a quarter about z.
    scene.fixes(np.array([[10.0, 11.0, 12.0]]), np.diag([0.01, 0.04, 0.09])[None])
    scene.candidates([candidate(0.02), candidate(0.01, winner=True)], 'mom_3')
    scene.close()
    command = [sys.executable, '-m', 'rerun_cli', 'rrd', 'print', '-vvv', str(path)]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def test_points_fixes_and_candidates_are_in_the_file(printed):
    for place in ('map/points/0', 'map/points/1', 'map/fixes', 'candidates/table', 'numbers/score'):
        assert f'/{place}' in printed


def test_both_time_lines_are_there(printed):
    assert 'stamp' in printed and 'window' in printed
    assert '1970-01-01T00:00:05.000000007' in printed


def test_axes_of_a_fix_are_three_standard_deviations(printed):
    assert '[0.3, 0.6, 0.9]' in printed.replace('0.90000004', '0.9').replace('0.6000000', '0.6')
