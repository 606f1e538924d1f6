"""Sensor measurements: frozen values with integer nanosecond stamps.

Stamps are the header stamps, nanoseconds since the epoch. Arrays that a measurement holds are
never written to after it was made.
"""

import math
from collections import Counter
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.errors import MeasurementError

Points: TypeAlias = NDArray[np.float32]
Vector: TypeAlias = NDArray[np.float64]
Drops: TypeAlias = Counter[tuple[str, str]]
"""How many measurements were not used, by (sensor, reason)."""

NANOSECONDS = 1_000_000_000
LARGEST_INTENSITY = 1e9
"""What is beyond is no measure of light, and would drown what it is averaged with."""
NO_VERTICAL_SIGMA = 1e4
"""Metres; standard deviation of the vertical of a fix that has none. So large that an hour of such
fixes at 10 Hz still holds the height less than 50 m would."""


class FixStatus(IntEnum):
    """Status of a GNSS fix, with the numbers of ``sensor_msgs/NavSatStatus``."""

    NO_FIX = -1
    FIX = 0
    SBAS = 1
    GBAS = 2


@dataclass(frozen=True, slots=True)
class Remark:
    """What was wrong with a message that is used nevertheless.

    ``reason`` is a word to count by, ``text`` says what, with values and what was done about it.
    """

    reason: str
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class LidarScan:
    """One sweep of one LiDAR.

    ``points`` is (N, 3) in metres, in the LiDAR's own frame, all finite, N >= 1.
    ``point_times`` is (N,) seconds relative to ``stamp`` where the sensor tells, else None.
    ``intensities`` is (N,), finite, in the sensor's own unit, None where it measures none.
    """

    stamp: int
    sensor: str
    points: Points
    point_times: NDArray[np.float32] | None = None
    remarks: tuple[Remark, ...] = ()
    intensities: NDArray[np.float32] | None = None

    @property
    def nbytes(self) -> int:
        """Memory that it takes."""
        columns = (self.points, self.point_times, self.intensities)
        return sum(column.nbytes for column in columns if column is not None)


@dataclass(frozen=True, slots=True, eq=False)
class GnssFix:
    """One satellite fix of the antenna.

    Latitude and longitude in degrees and ellipsoidal altitude in metres (WGS-84), NaN where the
    receiver has none; ``covariance`` is (3, 3) in m^2, east, north, up, or None where the receiver
    does not know it.
    """

    stamp: int
    sensor: str
    latitude: float
    longitude: float
    altitude: float
    status: FixStatus
    covariance: Vector | None = None
    remarks: tuple[Remark, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class ImuSample:
    """One inertial sample in the IMU's frame.

    ``gyro`` is (3,) rad/s; ``acceleration`` is (3,) m/s^2 and contains gravity (+9.81 on the
    upward axis at rest); ``orientation`` is the quaternion x, y, z, w of T_enu_imu, or None.
    """

    stamp: int
    sensor: str
    gyro: Vector
    acceleration: Vector
    orientation: Vector | None = None


CoreInput: TypeAlias = LidarScan | GnssFix
"""What creates a variable: the core measurements."""
Measurement: TypeAlias = CoreInput | ImuSample


def make_scan(
    stamp: int,
    sensor: str,
    points: NDArray[np.floating],
    point_times: NDArray[np.floating] | None = None,
    min_points: int = 1,
    intensities: NDArray[Any] | None = None,
) -> LidarScan:
    """Build a scan; non-finite points and points at the sensor's origin are removed.

    Args:
        stamp: Header stamp, ns.
        sensor: Name of the LiDAR.
        points: Raw points (N, 3) in the LiDAR's own frame, metres.
        point_times: Seconds (N,) after ``stamp``, where they are known.
        min_points: Fewest points that make a scan.
        intensities: Numbers (N,) of any kind, in the sensor's own unit, where it measures them;
            what is not finite, or absurd, counts as 0.

    Returns:
        The scan, in single precision.

    Raises:
        MeasurementError: ``points`` are not (N, 3), or fewer than ``min_points`` remain.
    """
    if points.ndim != 2 or points.shape[1] != 3:
        raise MeasurementError(
            'bad_shape', f'{sensor} at {stamp}: points have shape {points.shape}, expected (N, 3)'
        )
    # Not finite where a coordinate is not, and 0 at the origin only; one pass over each column.
    with np.errstate(over='ignore', invalid='ignore'):
        distance = np.abs(points[:, 0]) + np.abs(points[:, 1]) + np.abs(points[:, 2])
    keep = np.isfinite(distance) & (distance > 0)
    if point_times is not None:
        keep &= np.isfinite(point_times)
    count = int(keep.sum())
    if count < max(min_points, 1):
        reason = 'empty_cloud' if len(points) == 0 else 'no_finite_points'
        raise MeasurementError(
            reason,
            f'{sensor} at {stamp}: {count} of {len(points)} points are usable, '
            f'{max(min_points, 1)} are needed',
        )
    kept, times, light = points, point_times, intensities
    if count < len(points):
        kept = points[keep]
        times = None if point_times is None else point_times[keep]
        light = None if intensities is None else intensities[keep]
    return LidarScan(
        stamp=stamp,
        sensor=sensor,
        points=_single(kept),
        point_times=None if times is None else np.ascontiguousarray(times, dtype=np.float32),
        intensities=None if light is None else _plausible(light),
    )


def _single(points: NDArray[np.floating]) -> Points:
    """Points (N, 3) in single precision, one behind the other."""
    if points.flags.c_contiguous and points.dtype == np.float32:
        return points
    single = np.empty(points.shape, dtype=np.float32)
    for column in range(3):  # numpy copies one after the other several times as fast as all at once
        single[:, column] = points[:, column]
    return single


def _plausible(intensities: NDArray[Any]) -> NDArray[np.float32]:
    """Intensities in single precision, 0 where they are none."""
    with np.errstate(invalid='ignore', over='ignore'):  # signalling NaNs, large doubles
        single = intensities.astype(np.float32)
        return np.where(np.abs(single) <= LARGEST_INTENSITY, single, np.float32(0.0))


HIGHEST = 1e5
"""Metres above and below the ellipsoid, beyond which no vehicle is."""


def make_fix(
    stamp: int,
    sensor: str,
    latitude: float,
    longitude: float,
    altitude: float,
    status: int,
    covariance: NDArray[np.floating] | None,
) -> GnssFix:
    """Build a fix of the antenna.

    Args:
        stamp: Header stamp, ns.
        sensor: Name of the receiver.
        latitude: Degrees, WGS-84; one above 90 that the longitude could be is swapped with it.
        longitude: Degrees, WGS-84.
        altitude: Metres above the ellipsoid; what is not within ``HIGHEST`` is no altitude.
        status: As in ``sensor_msgs/NavSatStatus``; what is above GBAS counts as GBAS.
        covariance: Nine numbers in m^2, east, north, up; None, or without positive finite
            horizontal variances, where it is not known. A vertical variance that is none costs
            the vertical only.

    Returns:
        The fix; one without a known vertical has a vertical deviation of ``NO_VERTICAL_SIGMA``.

    Raises:
        MeasurementError: The status says that there is no fix, or the position is no place.
    """
    where = f'{sensor} at {stamp}'
    if status < FixStatus.FIX:
        raise MeasurementError('no_fix', f'{where}: status {status} says there is no fix')
    if not np.isfinite([latitude, longitude]).all():
        raise MeasurementError(
            'not_finite', f'{where}: position {latitude}, {longitude} is not finite'
        )
    swapped = 90.0 < abs(latitude) <= 180.0 and 0.0 < abs(longitude) <= 90.0
    if swapped:
        latitude, longitude = longitude, latitude
    if abs(latitude) > 90.0 or abs(longitude) > 360.0 or (latitude == 0.0 and longitude == 0.0):
        raise MeasurementError(
            'out_of_range', f'{where}: latitude {latitude}, longitude {longitude} are no place'
        )
    if not abs(altitude) <= HIGHEST:
        remarks: tuple[Remark, ...] = (
            Remark('no_altitude', f'altitude {altitude:g}: only the horizontal part is used'),
        )
        altitude = math.nan
    else:
        remarks = ()
    known, more = _known_covariance(altitude, covariance)
    # An unknown height has no variance either, which need not be said too.
    remarks += tuple(item for item in more if not (remarks and 'vertical' in item.reason))
    if swapped:
        text = f'latitude {longitude:.6f} is none, longitude {latitude:.6f} would be: swapped'
        remarks = (*remarks, Remark('swapped_fix', text))
    return GnssFix(
        stamp=stamp,
        sensor=sensor,
        latitude=float(latitude),
        longitude=float(longitude),
        altitude=float(altitude),
        status=FixStatus(min(int(status), FixStatus.GBAS)),
        covariance=known,
        remarks=remarks,
    )


def _known_covariance(
    altitude: float, covariance: NDArray[np.floating] | None
) -> tuple[Vector | None, tuple[Remark, ...]]:
    """What is known of a fix's uncertainty (3, 3), and a remark where it is not what it says."""
    if covariance is None:
        return None, ()
    matrix: Vector = np.asarray(covariance, dtype=np.float64).reshape(3, 3)
    if not np.isfinite(matrix[:2, :2]).all() or not (np.diag(matrix)[:2] > 0).all():
        east, north = np.diag(matrix)[:2]
        text = (
            f'variances {east:g} and {north:g} m^2, said to be known, cannot be: '
            'fixes.default_sigma is used'
        )
        return None, (Remark('no_variance', text),)
    if math.isfinite(altitude) and np.isfinite(matrix).all() and matrix[2, 2] > 0:
        return matrix, ()
    flat: Vector = np.zeros((3, 3))
    flat[:2, :2] = matrix[:2, :2]
    flat[2, 2] = NO_VERTICAL_SIGMA**2
    text = f'vertical variance {matrix[2, 2]:g}: only the horizontal part is used'
    return flat, (Remark('no_vertical_variance', text),)


def make_imu(
    stamp: int,
    sensor: str,
    gyro: NDArray[np.floating],
    acceleration: NDArray[np.floating],
    orientation: NDArray[np.floating] | None = None,
) -> ImuSample:
    """Build an inertial sample.

    Args:
        stamp: Header stamp, ns.
        sensor: Name of the IMU.
        gyro: Angular rate (3,) in the IMU's frame, rad/s.
        acceleration: Specific force (3,) in the IMU's frame, m/s^2; +9.81 upwards at rest.
        orientation: Quaternion x, y, z, w of T_enu_imu; left out where its norm is not near 1.

    Returns:
        The sample.

    Raises:
        MeasurementError: A rate or an acceleration is not finite.
    """
    rate = np.asarray(gyro, dtype=np.float64).reshape(3)
    force = np.asarray(acceleration, dtype=np.float64).reshape(3)
    # There are hundreds a second: on plain floats this is several times as quick.
    if not all(map(math.isfinite, (*rate.tolist(), *force.tolist()))):
        raise MeasurementError(
            'not_finite', f'{sensor} at {stamp}: gyro {rate}, acceleration {force} are not finite'
        )
    turn = None
    if orientation is not None:
        turn = np.asarray(orientation, dtype=np.float64).reshape(4)
        norm = math.hypot(*turn.tolist())
        turn = turn / norm if abs(norm - 1.0) < 0.1 else None
    return ImuSample(stamp=stamp, sensor=sensor, gyro=rate, acceleration=force, orientation=turn)
