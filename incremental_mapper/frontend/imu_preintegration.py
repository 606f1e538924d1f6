"""IMU spans: samples as arrays, pre-integration over a whole span, prediction, levelling."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.config import ImuSettings
from incremental_mapper.measurements import NANOSECONDS, ImuSample


@dataclass(frozen=True, slots=True, eq=False)
class ImuSeries:
    """Samples in time order: stamps (K,) ns, gyro (K, 3) rad/s, acceleration (K, 3) m/s^2."""

    stamps: NDArray[np.int64]
    gyro: NDArray[np.float64]
    acceleration: NDArray[np.float64]

    def since(self, stamp: int) -> 'ImuSeries':
        """The samples with a stamp of at least ``stamp``."""
        low = int(np.searchsorted(self.stamps, stamp, side='left'))
        return self.part(low, len(self.stamps))

    def part(self, low: int, high: int) -> 'ImuSeries':
        """The samples at positions [low, high)."""
        return ImuSeries(self.stamps[low:high], self.gyro[low:high], self.acceleration[low:high])

    def within(self, start: int, end: int) -> 'ImuSeries':
        """The samples with start <= stamp < end."""
        low, high = np.searchsorted(self.stamps, (start, end), side='left')
        return self.part(int(low), int(high))

    def nearest(self, stamp: int) -> 'ImuSeries':
        """The one sample nearest to ``stamp``; empty where there are none."""
        low = int(np.abs(self.stamps - stamp).argmin()) if len(self.stamps) else 0
        return self.part(low, low + 1)

    def joined(self, samples: Sequence[ImuSample]) -> 'ImuSeries':
        """This series with newer samples behind it."""
        return self if not samples else self.joined_series(series_of(samples))

    def joined_series(self, newer: 'ImuSeries') -> 'ImuSeries':
        """This series with a newer one behind it."""
        return ImuSeries(
            np.append(self.stamps, newer.stamps),
            np.vstack([self.gyro, newer.gyro]),
            np.vstack([self.acceleration, newer.acceleration]),
        )


QUICK_CHANGE = 0.3
"""rad/s by which the turn changes within a span of a vehicle that is carried or jolted."""

EMPTY_SERIES = ImuSeries(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3)))


def series_of(samples: Sequence[ImuSample]) -> ImuSeries:
    """Samples in time order as a series."""
    if not samples:
        return EMPTY_SERIES
    return ImuSeries(
        np.array([sample.stamp for sample in samples], dtype=np.int64),
        np.stack([sample.gyro for sample in samples]),
        np.stack([sample.acceleration for sample in samples]),
    )


def preintegration_parameters(
    settings: ImuSettings, T_base_imu: NDArray[np.float64]
) -> gtsam.PreintegrationCombinedParams:
    """GTSAM parameters with every covariance set; its defaults are the identity.

    Args:
        settings: Noise densities and bias walks; they are never estimated from a few samples.
        T_base_imu: Pose of the IMU in base_link, (4, 4).

    Returns:
        The parameters; gravity points down in the map.
    """
    eye = np.eye(3)
    parameters = gtsam.PreintegrationCombinedParams.MakeSharedU(settings.gravity)
    parameters.setAccelerometerCovariance(eye * settings.accelerometer_noise**2)
    parameters.setGyroscopeCovariance(eye * settings.gyroscope_noise**2)
    parameters.setBiasAccCovariance(eye * settings.accelerometer_bias_walk**2)
    parameters.setBiasOmegaCovariance(eye * settings.gyroscope_bias_walk**2)
    parameters.setIntegrationCovariance(eye * settings.integration_sigma**2)
    parameters.setBodyPSensor(gtsam.Pose3(T_base_imu))
    return parameters


def preintegrate(
    series: ImuSeries,
    start: int,
    end: int,
    parameters: gtsam.PreintegrationCombinedParams,
    bias: gtsam.imuBias.ConstantBias,
    constant_bias: bool = False,
) -> gtsam.PreintegratedCombinedMeasurements | gtsam.PreintegratedImuMeasurements:
    """Integrate the whole span between two cluster stamps with the samples inside it.

    Each sample stands for the time nearest to it, so the pieces before the first and after the
    last sample are covered too.

    Args:
        series: IMU samples.
        start: Stamp of the cluster where the span begins, ns.
        end: Stamp of the cluster where it ends, ns.
        parameters: Noise and gravity of the pre-integration.
        bias: Bias around which it is linearised.
        constant_bias: Whether the bias is the same all along, as one is that serves many spans.

    Returns:
        The pre-integrated span.

    Raises:
        ValueError: The span holds no sample.
    """
    samples = series.within(start, end)
    if len(samples.stamps) == 0:
        raise ValueError(f'no IMU sample between {start} and {end}')
    return integrate(samples, start, end, parameters, bias, constant_bias)


def integrate(
    samples: ImuSeries,
    start: int,
    end: int,
    parameters: gtsam.PreintegrationCombinedParams,
    bias: gtsam.imuBias.ConstantBias,
    constant_bias: bool = False,
) -> gtsam.PreintegratedCombinedMeasurements | gtsam.PreintegratedImuMeasurements:
    """As ``preintegrate``, with these ``samples``, one or more, wherever they lie."""
    # Stamps are subtracted as integers: doubles hold epoch nanoseconds to 256 ns only.
    moments = [stamp - start for stamp in samples.stamps.tolist()]
    edges = [(first + second) / 2.0 for first, second in pairwise(moments)]
    make = (
        gtsam.PreintegratedImuMeasurements
        if constant_bias
        else gtsam.PreintegratedCombinedMeasurements
    )
    preintegrated = make(parameters, bias)
    begin = 0.0
    forces = samples.acceleration - _swung(samples, parameters.getBodyPSensor())
    for force, rate, end_ns in zip(forces, samples.gyro, [*edges, float(end - start)], strict=True):
        dt = (end_ns - begin) / NANOSECONDS
        if dt > 0.0:  # a sample exactly at the start has half its time in the span before
            preintegrated.integrateMeasurement(force, rate, dt)
        begin = end_ns
    return preintegrated


def _swung(samples: ImuSeries, T_base_imu: gtsam.Pose3 | None) -> NDArray[np.float64]:
    """Acceleration (K, 3) of an IMU beside base_link as the turn changes, in its axes, m/s^2.

    GTSAM takes off what a steady turn does to a sensor off the centre, but not this: in a hand the
    turn changes by 4 rad/s in a few tenths of a second, which over 0.1 m is 0.4 m/s. Where it
    changes by little it is the gyroscope's noise that would be taken off: on a car with the IMU
    1.7 m above the ground that is much more than what springs do.
    """
    few = len(samples.stamps) < 2
    if T_base_imu is None or few or np.ptp(samples.gyro, axis=0).max() < QUICK_CHANGE:
        return np.zeros((len(samples.stamps), 3))
    seconds = (samples.stamps - samples.stamps[0]) / NANOSECONDS
    change = np.gradient(samples.gyro, seconds, axis=0)
    arm = T_base_imu.rotation().matrix().T @ T_base_imu.translation()
    swung: NDArray[np.float64] = np.cross(change, arm)
    return swung


def level_rotation(acceleration: NDArray[np.float64], yaw: float) -> gtsam.Rot3:
    """Rotation that is level by gravity and has a given yaw.

    Args:
        acceleration: Mean specific force (3,) in base_link, which points upwards at rest, m/s^2.
        yaw: Yaw in the map, radians.

    Returns:
        R_map_base; level where the force is too small to tell.
    """
    up = np.asarray(acceleration, dtype=np.float64)
    norm = float(np.linalg.norm(up))
    if not norm > 1.0:  # free fall or a dead sensor: nothing to level by
        return gtsam.Rot3.Yaw(yaw)
    x, y, z = up / norm
    roll = float(np.arctan2(y, z))
    pitch = float(np.arctan2(-x, np.hypot(y, z)))
    return gtsam.Rot3.Ypr(yaw, pitch, roll)
