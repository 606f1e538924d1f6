"""From the map to coordinate systems, against PROJ's own way; what cannot be had is refused."""

import struct

import numpy as np
import pytest

from incremental_mapper.errors import ConfigError
from incremental_mapper.exports.place import Place

pyproj = pytest.importorskip('pyproj', reason='pyproj is not installed (extra "formats")')

HERE = Place(36.4, 129.0, 90.0)


@pytest.mark.parametrize(
    ('latitude', 'longitude', 'zone'),
    [(36.4, 129.0, 'zone 52N'), (-33.9, 151.2, 'zone 56S'), (60.4, 5.3, 'zone 31N'),
     (48.1, 11.6, 'zone 32N'), (0.0, -179.9, 'zone 1'), (37.4, -122.1, 'zone 10N')],
)  # fmt: skip
def test_the_zone_is_that_of_the_place(latitude, longitude, zone):
    projection = Place(latitude, longitude, 10.0).projection(None)
    assert zone in projection.name and projection.heights == 'ellipsoidal'
    wanted = pyproj.Transformer.from_crs(
        'EPSG:4326', pyproj.CRS.from_wkt(projection.wkt).to_2d(), always_xy=True
    ).transform(longitude, latitude)
    made = projection.project(np.array([[0.0, 0.0, 3.0]]))
    assert made[0] == pytest.approx([*wanted, 13.0], abs=1e-4)


def test_a_system_of_the_country_has_its_own_coordinates():
    projection = HERE.projection('EPSG:5186')
    east, north = pyproj.Transformer.from_crs('EPSG:4326', 'EPSG:5186', always_xy=True).transform(
        129.0, 36.4
    )
    assert projection.project(np.zeros((1, 3)))[0] == pytest.approx([east, north, 90.0], abs=1e-4)
    assert pyproj.CRS.from_wkt(projection.wkt).axis_info[2].name == 'Ellipsoidal height'


def test_far_points_are_where_the_ellipsoid_has_them():
    """Up of the map is not up there: 10 km away the ground lies 7.8 m lower."""
    projection = HERE.projection(None)
    (point,) = projection.project(np.array([[10_000.0, 0.0, 0.0]]))
    assert point[2] - 90.0 == pytest.approx(10_000.0**2 / 2 / 6.39e6, abs=0.05)


def test_heights_above_the_sea_need_a_grid():
    with pytest.raises(ConfigError, match=r'cannot be had here without loss .*egm96'):
        HERE.projection('EPSG:32652+5773')


def test_heights_above_the_sea_are_those_of_the_grid(tmp_path):
    """The grid lies 25 m above the ellipsoid everywhere, as no real one does."""
    head = struct.pack('>4d2i', -90.0, -180.0, 1.0, 1.0, 181, 361)
    grid = np.full((181, 361), 25.0, dtype='>f4')
    (tmp_path / 'egm96_15.gtx').write_bytes(head + grid.tobytes())
    before = pyproj.datadir.get_data_dir()
    pyproj.datadir.append_data_dir(str(tmp_path))
    try:
        projection = HERE.projection('EPSG:32652+5773')
        made = projection.project(np.array([[0.0, 0.0, 1.0]]))
    finally:
        pyproj.datadir.set_data_dir(before)
    assert projection.heights == 'EGM96 height'
    assert made[0, 2] == pytest.approx(90.0 + 1.0 - 25.0, abs=1e-3)
    assert pyproj.CRS.from_wkt(projection.wkt).is_compound


@pytest.mark.parametrize(
    ('crs', 'words'),
    [
        ('EPSG:4326', 'is not one of maps, in metres'),
        ('EPSG:4978', 'is not one of maps, in metres'),
        ('EPSG:27700', 'is for United Kingdom'),
        ('EPSG:32632', 'is for Between 6°E and 12°E'),
        ('EPSG:1', 'is no coordinate system'),
        ('here', 'is no coordinate system'),
    ],
)
def test_what_would_make_a_wrong_map_is_refused(crs, words):
    with pytest.raises(ConfigError, match=words):
        HERE.projection(crs)


def test_a_neighbouring_zone_will_do():
    assert HERE.projection('EPSG:32651').name.endswith('51N')
