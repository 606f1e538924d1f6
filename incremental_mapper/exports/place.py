"""Where a map lies on Earth: from its frame to latitude and longitude, and to a coordinate system.

pyproj comes with the extra ``formats`` and is imported when a coordinate system is asked for.
"""

from collections.abc import Callable
from dataclasses import astuple, dataclass
from typing import Any

import numpy as np
import pymap3d
from numpy.typing import NDArray

from incremental_mapper.errors import ConfigError

GEODETIC = 'EPSG:4979'
"""WGS-84: latitude, longitude and height above the ellipsoid; what receivers report."""
ELLIPSOID = (
    'VERT_CS["Ellipsoid (metre)",VERT_DATUM["Ellipsoid",2002],'
    'UNIT["metre",1,AUTHORITY["EPSG","9001"]],AXIS["Up",UP]]'
)
"""Heights above the ellipsoid in the older WKT, which knows none by itself; PROJ reads it."""


MARGIN = 3.0
"""Degrees by which a map may lie beyond what a coordinate system is made for: half a UTM zone."""


@dataclass(frozen=True, slots=True)
class Projection:
    """A coordinate system of maps.

    Attributes:
        name: What it is called.
        heights: What its heights are.
        wkt: It in WKT 1, which is what LAS files hold.
        project: Moves points (N, 3) of the map, metres, to east, north and height in it.
    """

    name: str
    heights: str
    wkt: str
    project: Callable[[NDArray[np.float64]], NDArray[np.float64]]


@dataclass(frozen=True, slots=True)
class Place:
    """The origin of a map that is local east, north, up: degrees, and metres above WGS-84."""

    latitude: float
    longitude: float
    altitude: float

    def geodetic(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Latitude and longitude, degrees, and height above the ellipsoid, metres.

        Args:
            points: (N, 3), metres in the map.

        Returns:
            (N, 3).
        """
        if len(points) == 0:
            return np.zeros((0, 3))
        return np.stack(pymap3d.enu2geodetic(*points.T, *astuple(self)), axis=1)

    def projection(self, crs: str | None) -> Projection:
        """A coordinate system around this place.

        Args:
            crs: What the user names, such as EPSG:25832 or EPSG:32652+5773; None takes the UTM
                zone of the place. Without a vertical part heights are ellipsoidal.

        Returns:
            The system.

        Raises:
            ConfigError: There is no such system, it is one of another part of the Earth or in
                degrees, or PROJ lacks a grid for it.
        """
        import pyproj

        try:
            own = pyproj.CRS.from_user_input(self._utm() if crs is None else crs)
        except pyproj.exceptions.CRSError as error:
            raise ConfigError(
                f'--crs: {crs!r} is no coordinate system; expected one such as EPSG:32632'
            ) from error
        parts = own.sub_crs_list if own.is_compound else [own]
        flat, whole = len(own.axis_info) == 2, own.to_3d()
        if not parts[0].is_projected or not (flat or own.is_compound or len(own.axis_info) == 3):
            raise ConfigError(
                f'--crs: {own.name} is not one of maps, in metres; take a projected one, such as '
                f'the UTM zone here, {self._utm()}'
            )
        horizontal = (parts[0] if own.is_compound else own.to_2d()).to_wkt('WKT1_GDAL')
        self._check_reach(own)
        heights = 'ellipsoidal'
        wkt = f'COMPD_CS["{parts[0].name} + Ellipsoid (metre)",{horizontal},{ELLIPSOID}]'
        if own.is_compound:
            whole, heights, wkt = own, parts[1].name, own.to_wkt('WKT1_GDAL')
        project = self._projector(whole)
        # One that PROJ cannot do well here is refused before anything is written.
        project(np.zeros((1, 3)))
        return Projection(own.name, heights, wkt, project)

    def _projector(self, crs: Any) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
        import pyproj

        def refusal(reason: object) -> ConfigError:
            return ConfigError(
                f'--crs: {crs.name} cannot be had here without loss ({reason}); install the grids '
                'of PROJ ("pyproj sync"), or take another'
            )

        try:
            # Where a grid is missing PROJ would else take the next best, metres off, or leave
            # heights as they are, without a word.
            transformer = pyproj.Transformer.from_crs(
                GEODETIC, crs, always_xy=True, allow_ballpark=False, only_best=True
            )
        except pyproj.exceptions.ProjError as error:
            raise refusal(error) from error

        def project(points: NDArray[np.float64]) -> NDArray[np.float64]:
            latitude, longitude, height = self.geodetic(points).T
            try:
                moved = transformer.transform(longitude, latitude, height, errcheck=True)
            except pyproj.exceptions.ProjError as error:
                raise refusal(error) from error
            made = np.stack(moved, axis=1)
            if not np.isfinite(made).all():
                raise refusal('it does not reach this place')
            return made

        return project

    def _check_reach(self, crs: Any) -> None:
        """Raise ConfigError where a coordinate system is made for another part of the Earth."""
        area = crs.area_of_use
        if area is None:
            return
        east = (self.longitude - area.west) % 360.0
        wide = (area.east - area.west) % 360.0 or 360.0
        level = area.south - MARGIN <= self.latitude <= area.north + MARGIN
        if not level or not (east <= wide + MARGIN or east >= 360.0 - MARGIN):
            raise ConfigError(
                f'--crs: {crs.name} is for {area.name}; the map lies at '
                f'{self.latitude:.4f}, {self.longitude:.4f}'
            )

    def _utm(self) -> str:
        """The UTM zone of the place on WGS-84."""
        from pyproj.aoi import AreaOfInterest
        from pyproj.database import query_utm_crs_info

        here = AreaOfInterest(self.longitude, self.latitude, self.longitude, self.latitude)
        found = query_utm_crs_info(datum_name='WGS 84', area_of_interest=here, contains=True)
        if not found:
            raise ConfigError('--crs: there is no UTM zone so far north or south; name a system')
        return f'EPSG:{found[0].code}'
