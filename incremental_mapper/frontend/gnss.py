"""GNSS fixes in a local frame: WGS-84 to ENU, and the yaw between the map and ENU."""

import math
from dataclasses import astuple, dataclass

import numpy as np
import pymap3d
from numpy.typing import NDArray

from incremental_mapper.config import DatumSettings
from incremental_mapper.measurements import GnssFix


@dataclass(frozen=True, slots=True)
class Datum:
    """Origin of the local ENU frame: degrees and metres above the WGS-84 ellipsoid."""

    latitude: float
    longitude: float
    altitude: float

    def enu(self, fix: GnssFix) -> NDArray[np.float64]:
        """Move a fix into the local frame.

        Args:
            fix: A fix of the antenna.

        Returns:
            Antenna position (3,) east, north, up of the datum, metres; a fix without altitude
            lies as high as the datum.
        """
        east, north, up = pymap3d.geodetic2enu(
            fix.latitude,
            fix.longitude,
            self.altitude if math.isnan(fix.altitude) else fix.altitude,
            self.latitude,
            self.longitude,
            self.altitude,
        )
        return np.array([float(east), float(north), float(up)])

    def enu_of(self, other: 'Datum') -> NDArray[np.float64]:
        """Where another datum lies around this one (3,), metres."""
        place = pymap3d.geodetic2enu(*astuple(other), *astuple(self))
        return np.array([float(value) for value in place])

    def geodetic(self, enu: NDArray[np.float64]) -> 'Datum':
        """The place (3,) around this datum, metres, as a datum of its own."""
        place = pymap3d.enu2geodetic(*enu, *astuple(self))
        return Datum(*(float(value) for value in place))


def fixed_datum(settings: DatumSettings) -> Datum | None:
    """The datum that the settings give, None where the fixes are to tell it."""
    if not settings.fixed:
        return None
    return Datum(settings.latitude, settings.longitude, settings.altitude)


def align_track(
    enu: NDArray[np.float64],
    local: NDArray[np.float64],
    sigmas: NDArray[np.float64] | None = None,
) -> tuple[float, NDArray[np.float64]]:
    """Yaw and shift between two tracks by least squares; roll and pitch are known by gravity.

    By hand, since GTSAM's Pose3.Align fits all three angles, of which a flat track tells only one.

    Args:
        enu: Antenna positions (K, 3) by the fixes, metres.
        local: The same by odometry.
        sigmas: Standard deviations (K,) of the fixes, metres; None where they are alike.

    Returns:
        Yaw in radians and shift (3,) with p_enu ≈ R(yaw) · p_local + shift.
    """
    weights = np.ones(len(enu)) if sigmas is None else sigmas**-2.0
    enu_mean = np.average(enu, axis=0, weights=weights)
    local_mean = np.average(local, axis=0, weights=weights)
    a, b = enu - enu_mean, local - local_mean
    yaw = float(
        np.arctan2(
            np.sum(weights * (b[:, 0] * a[:, 1] - b[:, 1] * a[:, 0])),
            np.sum(weights * (b[:, 0] * a[:, 0] + b[:, 1] * a[:, 1])),
        )
    )
    cosine, sine = np.cos(yaw), np.sin(yaw)
    R_enu_local = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return yaw, enu_mean - local_mean @ R_enu_local.T
