"""The trajectory in formats of others, read back by others' libraries."""

import csv
import json
from datetime import UTC, datetime
from xml.etree import ElementTree

import numpy as np
import pymap3d
import pytest
from finished_runs import DATUM, write_run

from incremental_mapper.errors import InputError
from incremental_mapper.exports.formats import export, find_format


@pytest.fixture
def run(tmp_path):
    return write_run(tmp_path / 'run')


def write(run, path, name=None):
    return export(run, find_format(path, name), path)


def geodetic(run):
    return np.stack(pymap3d.enu2geodetic(*run.trajectory.positions.T, *DATUM), axis=1)


def seconds(moments):
    return np.array([moment.replace(tzinfo=UTC).timestamp() for moment in moments])


def test_evo_reads_tum(run, tmp_path):
    file_interface = pytest.importorskip('evo.tools.file_interface', reason='evo is not installed')
    write(run, tmp_path / 'a.tum')
    read = file_interface.read_tum_trajectory_file(str(tmp_path / 'a.tum'))
    assert read.positions_xyz == pytest.approx(run.trajectory.positions, abs=1e-9)
    assert read.timestamps == pytest.approx(run.trajectory.stamps / 1e9, abs=1e-6)


@pytest.mark.parametrize('name', ['a.kitti', 'a.txt'])
def test_evo_reads_kitti(run, tmp_path, name):
    file_interface = pytest.importorskip('evo.tools.file_interface', reason='evo is not installed')
    assert 'no stamps' in write(run, tmp_path / name)[0]
    read = file_interface.read_kitti_poses_file(str(tmp_path / name))
    assert np.array(read.poses_se3) == pytest.approx(run.trajectory.matrices(), abs=1e-8)


def test_csv_has_stamps_to_the_nanosecond_and_places(run, tmp_path):
    write(run, tmp_path / 'a.csv')
    with (tmp_path / 'a.csv').open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row['stamp_ns']) for row in rows] == run.trajectory.stamps.tolist()
    turns = [[float(row[name]) for name in ('qx', 'qy', 'qz', 'qw')] for row in rows]
    assert np.array(turns) == pytest.approx(run.trajectory.quaternions, abs=1e-9)
    places = [[float(row[name]) for name in ('latitude', 'longitude', 'height')] for row in rows]
    assert np.array(places) == pytest.approx(geodetic(run), abs=1e-4)
    assert np.array(places)[:, :2] == pytest.approx(geodetic(run)[:, :2], abs=1e-9)


def test_gpxpy_reads_gpx(run, tmp_path):
    gpxpy = pytest.importorskip('gpxpy', reason='gpxpy is not installed (extra "formats")')
    assert 'above the WGS-84 ellipsoid' in write(run, tmp_path / 'a.gpx')[0]
    (track,) = gpxpy.parse((tmp_path / 'a.gpx').read_text()).tracks
    points = track.segments[0].points
    places = np.array([[point.latitude, point.longitude, point.elevation] for point in points])
    assert places[:, :2] == pytest.approx(geodetic(run)[:, :2], abs=2e-9)
    assert places[:, 2] == pytest.approx(geodetic(run)[:, 2], abs=1e-3)
    times = seconds([point.time for point in points])
    assert times == pytest.approx(run.trajectory.stamps / 1e9, abs=2e-6)


def test_kml_has_as_many_times_as_places(run, tmp_path):
    write(run, tmp_path / 'a.kml')
    tree = ElementTree.parse(tmp_path / 'a.kml')
    kml, gx = '{http://www.opengis.net/kml/2.2}', '{http://www.google.com/kml/ext/2.2}'
    track = tree.find(f'.//{gx}Track')
    whens = [datetime.fromisoformat(item.text) for item in track.findall(f'{kml}when')]
    assert seconds(whens) == pytest.approx(run.trajectory.stamps / 1e9, abs=2e-6)
    coords = np.array([item.text.split() for item in track.findall(f'{gx}coord')], dtype=float)
    assert coords[:, :2] == pytest.approx(geodetic(run)[:, 1::-1], abs=2e-9)


def test_geojson_is_longitude_first(run, tmp_path):
    write(run, tmp_path / 'a.geojson')
    (feature,) = json.loads((tmp_path / 'a.geojson').read_text())['features']
    line = np.array(feature['geometry']['coordinates'])
    assert feature['geometry']['type'] == 'LineString'
    assert line[:, :2] == pytest.approx(geodetic(run)[:, 1::-1], abs=2e-9)
    assert line[:, 2] == pytest.approx(geodetic(run)[:, 2], abs=1e-3)
    assert len(feature['properties']['coordTimes']) == len(line)


def test_one_pose_is_no_line(tmp_path):
    run = write_run(tmp_path / 'run', poses=1)
    write(run, tmp_path / 'a.geojson')
    (feature,) = json.loads((tmp_path / 'a.geojson').read_text())['features']
    assert feature['geometry']['type'] == 'MultiPoint'


@pytest.mark.parametrize('name', ['gpx', 'kml', 'geojson'])
def test_without_a_place_there_is_nothing_to_draw_on_earth(name, tmp_path):
    if name == 'gpx':
        pytest.importorskip('gpxpy', reason='gpxpy is not installed (extra "formats")')
    run = write_run(tmp_path / 'run', datum=None)
    with pytest.raises(InputError, match='not georeferenced'):
        write(run, tmp_path / f'a.{name}')
    assert [path.name for path in tmp_path.iterdir()] == ['run']
    assert write(run, tmp_path / 'a.csv') == ()
    assert 'latitude' not in (tmp_path / 'a.csv').read_text()
