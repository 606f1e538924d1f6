"""The map in formats of others, read back by others' libraries."""

import numpy as np
import pytest
from finished_runs import START, write_run

from incremental_mapper.errors import ConfigError
from incremental_mapper.exports.formats import export, find_format
from incremental_mapper.exports.point_files import gps_seconds
from incremental_mapper.measurements import NANOSECONDS


def write(run, path, crs=None):
    return export(run, find_format(path), path, crs)


def all_records(run):
    return np.concatenate(list(run.map.records()))


def enu_to_utm(points):
    """By PROJ's own local frame, of which the package uses nothing."""
    pyproj = pytest.importorskip('pyproj', reason='pyproj is not installed (extra "formats")')
    pipeline = (
        '+proj=pipeline +step +inv +proj=topocentric +lat_0=36.4 +lon_0=129 +h_0=90 +ellps=WGS84 '
        '+step +inv +proj=cart +ellps=WGS84 +step +proj=utm +zone=52 +ellps=WGS84'
    )
    return np.stack(pyproj.Transformer.from_pipeline(pipeline).transform(*points.T), axis=1)


@pytest.mark.parametrize('suffix', ['laz', 'las'])
def test_las_has_every_point_at_its_place_on_earth(suffix, tmp_path):
    laspy = pytest.importorskip('laspy', reason='laspy is not installed (extra "formats")')
    run = write_run(tmp_path / 'run')
    remarks = write(run, tmp_path / f'a.{suffix}')
    assert remarks == ('coordinates in WGS 84 / UTM zone 52N; heights: ellipsoidal',)
    read, wanted = laspy.read(tmp_path / f'a.{suffix}'), all_records(run)
    assert read.header.are_points_compressed is (suffix == 'laz')
    enu = np.stack([wanted[axis] for axis in 'xyz'], axis=1).astype(float)
    assert np.c_[read.x, read.y, read.z] == pytest.approx(enu_to_utm(enu), abs=0.0006)
    assert np.array_equal(read.intensity, np.rint(wanted['intensity']))
    assert np.array_equal(read.lidar, wanted['lidar'])
    assert np.array_equal(read.window, wanted['window'])
    leaps = 18  # seconds that GPS was ahead of UTC in 2018
    unix = np.array(read.gps_time) + 1e9 + 315964800 - leaps
    assert unix == pytest.approx(wanted['time'], abs=1e-6)
    crs = read.header.parse_crs()
    assert crs.name == 'WGS 84 / UTM zone 52N' and crs.axis_info[2].name == 'Ellipsoidal height'
    described = {item.name: item.description for item in read.point_format.extra_dimensions}
    assert described['lidar'] == '0 left, 1 right'


def test_same_run_makes_the_same_file(tmp_path):
    pytest.importorskip('laspy', reason='laspy is not installed (extra "formats")')
    run = write_run(tmp_path / 'run')
    for name in 'ab':
        write(run, tmp_path / f'{name}.laz')
    assert (tmp_path / 'a.laz').read_bytes() == (tmp_path / 'b.laz').read_bytes()


@pytest.mark.parametrize(('light', 'scale'), [(0.9, True), (1e6, True), (60_000.0, False)])
def test_intensities_that_las_cannot_hold_are_scaled_and_told(light, scale, tmp_path):
    laspy = pytest.importorskip('laspy', reason='laspy is not installed (extra "formats")')
    run = write_run(tmp_path / 'run', light=light)
    remarks = write(run, tmp_path / 'a.laz')
    assert any('intensities are multiplied by' in remark for remark in remarks) is scale
    own, wanted = laspy.read(tmp_path / 'a.laz').intensity, all_records(run)['intensity']
    assert np.array_equal(own, np.rint(wanted * (65535 / wanted.max() if scale else 1.0)))


def test_a_map_without_a_place_on_earth_stays_in_its_metres(tmp_path):
    laspy = pytest.importorskip('laspy', reason='laspy is not installed (extra "formats")')
    run = write_run(tmp_path / 'run', light=0.0, datum=None)
    (remark,) = write(run, tmp_path / 'a.laz')
    assert 'not georeferenced' in remark
    read, wanted = laspy.read(tmp_path / 'a.laz'), all_records(run)
    assert np.array(read.x) == pytest.approx(wanted['x'].astype(float), abs=0.0006)
    assert read.header.parse_crs() is None
    with pytest.raises(ConfigError, match='not georeferenced'):
        write(run, tmp_path / 'b.laz', 'EPSG:32652')
    assert not (tmp_path / 'b.laz').exists()


def test_a_map_larger_than_a_piece_is_whole(tmp_path, monkeypatch):
    laspy = pytest.importorskip('laspy', reason='laspy is not installed (extra "formats")')
    monkeypatch.setattr('incremental_mapper.map.ply.CHUNK', 2000)
    run = write_run(tmp_path / 'run')
    write(run, tmp_path / 'a.laz')
    read, wanted = laspy.read(tmp_path / 'a.laz'), all_records(run)
    assert len(read) == 5000
    assert np.array_equal(read.window, wanted['window'])


@pytest.mark.parametrize('light', [0.0, 80.0])
def test_pcd_is_read_by_another_library(light, tmp_path):
    pypcd4 = pytest.importorskip('pypcd4', reason='pypcd4 is not installed (extra "test")')
    run = write_run(tmp_path / 'run', light=light)
    assert write(run, tmp_path / 'a.pcd') == ()
    read, wanted = pypcd4.PointCloud.from_path(tmp_path / 'a.pcd'), all_records(run)
    assert read.fields == wanted.dtype.names
    for name in wanted.dtype.names:
        assert np.array_equal(read.pc_data[name].ravel(), wanted[name]), name


def test_gps_time_knows_the_leap_seconds_of_its_days():
    moments = np.array([315964800.0, 1483228799.0, 1483228800.0, START / NANOSECONDS])
    ahead = gps_seconds(moments) - (moments - 315964800)
    assert ahead.tolist() == [0.0, 17.0, 18.0, 18.0]


def test_ply_is_read_by_another_library(tmp_path):
    trimesh = pytest.importorskip('trimesh', reason='trimesh is not installed (extra "test")')
    run = write_run(tmp_path / 'run')
    write(run, tmp_path / 'a.ply')
    read, wanted = trimesh.load(tmp_path / 'a.ply', process=False), all_records(run)
    data = read.metadata['_ply_raw']['vertex']['data']
    for name in wanted.dtype.names:
        assert np.array_equal(data[name].ravel(), wanted[name]), name
