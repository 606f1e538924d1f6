"""The folder of a run: what lies in it before, and what becomes of that."""

import gtsam
import numpy as np
import pytest

from incremental_mapper.errors import InputError, OutputError
from incremental_mapper.map.ply import MapCloud, write_ply
from incremental_mapper.mapping.result import MapResult
from incremental_mapper.results.file_names import EXTRA_FILES, FILES
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.results.run_folder import prepared_folder, write_result
from incremental_mapper.trajectory import Trajectory

RUN = (*FILES, *EXTRA_FILES, 'failed_window_12.npz')
FOREIGN = ('notes.txt', 'failed_window_mine.txt', 'bag.mcap')


def fill(folder, *names):
    folder.mkdir()
    return fill_in(folder, *names)


def fill_in(folder, *names):
    for name in names:
        (folder / name).write_text('old')
    return folder


def names(folder):
    return {path.name for path in folder.iterdir()}


def test_force_removes_what_an_earlier_run_wrote_and_nothing_else(tmp_path):
    folder = fill(tmp_path / 'out', *RUN, *FOREIGN)
    with prepared_folder(folder, force=True):
        pass
    assert names(folder) == set(FOREIGN)


def test_files_of_like_names_stay_where_no_run_has_been(tmp_path):
    folder = fill(tmp_path / 'out', 'map.ply', 'trajectory.tum', 'map.png')
    with prepared_folder(folder, force=True):
        pass
    assert names(folder) == {'map.ply', 'trajectory.tum', 'map.png'}


def test_without_force_nothing_is_touched(tmp_path):
    folder = fill(tmp_path / 'out', *RUN)
    with (
        pytest.raises(OutputError, match='--force'),
        prepared_folder(folder, force=False),
    ):
        pass
    assert names(folder) == set(RUN)


@pytest.mark.parametrize('force', [False, True])
def test_no_second_run_writes_into_a_folder_meanwhile(force, tmp_path):
    folder = tmp_path / 'out'
    with prepared_folder(folder, force):
        with (
            pytest.raises(OutputError, match='another run is writing into it'),
            prepared_folder(folder, force),
        ):
            pass
        fill_in(folder, *RUN)
        with pytest.raises(OutputError, match='another'), prepared_folder(folder, force=True):
            pass
        assert names(folder) == set(RUN)
    with prepared_folder(folder, force=True):
        assert names(folder) == set()


@pytest.mark.parametrize('columns', [3, 4])
def test_points_and_intensities_are_read_back(columns, tmp_path):
    cloud = np.arange(6 * columns, dtype=np.float32).reshape(6, columns)
    write_ply(tmp_path / 'map.ply', MapCloud.bare(cloud))
    run = FinishedRun(tmp_path)
    assert np.array_equal(run.points, cloud[:, :3]) and run.points.dtype == np.float64
    if columns == 3:
        assert run.intensities is None
    else:
        assert np.array_equal(run.intensities, cloud[:, 3])
    data = (tmp_path / 'map.ply').read_bytes()
    (tmp_path / 'map.ply').write_bytes(data[:-1])
    with pytest.raises(InputError, match='damaged'):
        _ = FinishedRun(tmp_path).points


def result(position):
    """A map of one pose, in the trajectory alone."""
    trajectory = Trajectory(np.array([7]), np.array([position]), np.array([[0.0, 0.0, 0.0, 1.0]]))
    nothing = np.zeros((0, 3))
    return MapResult((), (), gtsam.Values(), trajectory, (), nothing, (), None)


def test_numbers_that_are_not_finite_reach_no_file(tmp_path):
    points = np.ones((5, 4), dtype=np.float32)
    cloud, wrong = MapCloud.bare(points), MapCloud.bare(points.copy())
    wrong.points[2, 3] = np.nan
    with pytest.raises(OutputError, match=r'trajectory.tum: not written: 1 of 3 .* positions'):
        write_result(tmp_path, result([1.0, np.inf, 0.0]), cloud, {})
    assert names(tmp_path) == set()
    with pytest.raises(OutputError, match=r'stats.json: not written'):
        write_result(tmp_path, result([1.0, 2.0, 0.0]), cloud, {'wall_s': float('nan')})
    with pytest.raises(OutputError, match=r'map.ply: not written: 1 of 20 numbers of points'):
        write_result(tmp_path, result([1.0, 2.0, 0.0]), wrong, {})
    assert 'map.ply' not in names(tmp_path) and 'trajectory.tum' in names(tmp_path)
    write_result(tmp_path, result([1.0, 2.0, 0.0]), cloud, {})
    assert names(tmp_path) == set(FILES)
