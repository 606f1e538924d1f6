"""``export`` and ``map.formats``, on a drive that is mapped."""

import json
from importlib.resources import files

import numpy as np
import pytest

from incremental_mapper.cli.main import main
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.results.run_folder import prepared_folder

FORMATS = ('pcd', 'csv', 'kitti', 'kml', 'geojson')


@pytest.fixture(scope='module')
def run(light_drive, tmp_path_factory):
    """A run with formats of its own; not to be written to."""
    folder = tmp_path_factory.mktemp('export')
    settings = folder / 'settings.yaml'
    settings.write_text(f'map:\n  formats: [{", ".join(FORMATS)}, ply]\n')
    words = ['--strategy', 'min_solver_error', '--config', str(settings)]
    assert main(['map', str(light_drive), str(folder / 'out'), *words]) == 0
    return folder / 'out'


@pytest.fixture
def call(capsys):
    def call(*words):
        capsys.readouterr()
        status = main(['export', *map(str, words)])
        return status, *capsys.readouterr()

    return call


def test_map_saves_the_formats_that_the_settings_name(run):
    names = {path.name for path in run.iterdir()}
    assert {'map.pcd', 'trajectory.csv', 'trajectory.kitti', 'trajectory.kml'} <= names
    assert 'trajectory.geojson' in names and not any('partial' in name for name in names)


def test_force_removes_them_too(run, tmp_path):
    for path in run.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    (tmp_path / 'map.mine').write_text('')
    with prepared_folder(tmp_path, force=True):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ['map.mine']


def test_files_are_written_and_named(run, call, tmp_path):
    status, out, err = call(run, '--to', tmp_path / 'a.pcd', '--to', tmp_path / 'b.tum')
    assert status == 0 and out.split() == [str(tmp_path / 'a.pcd'), str(tmp_path / 'b.tum')]
    assert err == ''
    assert (tmp_path / 'a.pcd').read_bytes() == (run / 'map.pcd').read_bytes()
    assert (tmp_path / 'b.tum').read_bytes() == (run / 'trajectory.tum').read_bytes()


def test_points_know_the_scans_of_the_drive(run):
    finished = FinishedRun(run)
    members = [item for cluster in finished.graph['clusters'] for item in cluster['members']]
    known = {(item['stamp_ns'] / 1e9, item['sensor']) for item in members}
    windows = {
        (item['stamp_ns'] / 1e9, item['sensor']): cluster['window']
        for cluster in finished.graph['clusters']
        for item in cluster['members']
    }
    records = np.concatenate(list(finished.map.records()))
    assert finished.map.lidars == ('left', 'right')
    names = [finished.map.lidars[number] for number in records['lidar']]
    seen = set(zip(records['time'].tolist(), names, records['window'].tolist(), strict=True))
    assert {key[:2] for key in seen} <= known and len(seen) > 20
    assert all(windows[key[:2]] == key[2] for key in seen)


@pytest.mark.parametrize(
    ('words', 'told'),
    [
        (['--to', 'a.xyz'], "the suffix '.xyz' tells no format"),
        (['--to', 'a.tum', '--format', 'nothing'], 'known formats'),
        (['--to', 'a.csv', '--crs', 'EPSG:32652'], 'csv holds no coordinate system'),
        (['--to', 'nowhere/a.csv'], 'cannot be written'),
    ],
)
def test_refusals_are_a_line_and_leave_nothing(run, call, words, told, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, out, err = call(run, *words)
    assert status == 1 and out == '' and told in err and err.count('\n') == 1
    assert list(tmp_path.iterdir()) == []


def test_a_run_is_not_written_over(run, call):
    before = (run / 'trajectory.tum').read_bytes()
    status, _, err = call(run, '--to', run / 'trajectory.tum', '--format', 'kitti')
    assert status == 1 and 'is a file of the run itself' in err
    assert (run / 'trajectory.tum').read_bytes() == before


def test_a_folder_that_is_no_run_is_named(call, tmp_path):
    status, _, err = call(tmp_path, '--to', tmp_path / 'a.csv')
    assert status == 1 and 'is no output of' in err


def test_formats_are_checked_before_anything_is_mapped(run_map, light_drive, settings):
    path = settings('map:\n  formats: [lax]\n')
    run_map(light_drive, '--config', path).assert_refused('map.formats', "'lax'")


def test_graph_is_what_the_schema_says(run, call, tmp_path):
    jsonschema = pytest.importorskip('jsonschema', reason='jsonschema is not installed')
    text = files('incremental_mapper.exports').joinpath('graph.schema.json').read_text('utf-8')
    schema = json.loads(text)
    jsonschema.Draft202012Validator.check_schema(schema)
    check = jsonschema.Draft202012Validator(schema)
    assert call(run, '--to', tmp_path / 'graph.json')[0] == 0
    graph = json.loads((tmp_path / 'graph.json').read_text())
    assert not list(check.iter_errors(graph))
    kinds = {item['kind'] for item in graph['factors']}
    assert {'odometry', 'gnss', 'imu', 'prior_pose', 'prior_velocity', 'prior_bias'} <= kinds
    for kind in kinds:  # it tells wrong ones
        wrong = next(dict(item) for item in graph['factors'] if item['kind'] == kind)
        wrong.pop(next(name for name in wrong if name not in ('kind', 'sensor')))
        del wrong[list(wrong)[-1]]
        assert list(check.iter_errors({**graph, 'factors': [wrong]})), kind
    assert list(check.iter_errors({**graph, 'format': 2}))
