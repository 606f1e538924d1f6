"""IMU spans: samples as arrays, pre-integration over a whole span, prediction, levelling."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.config import ImuSettings
from incremental_mapper.measurements import NANOSECONDS, ImuSample

SMOOTHED = 30_000_000
"""Nanoseconds to either side over which a rate of turn is averaged before its change is taken: the
noise of single samples, times a lever arm of metres, would be more than what springs do."""
HARD = 4.0
"""m/s^2 by which the size of the specific force differs from gravity where it is hard: no car's
wheels push as much, but a knock does, and so do hands and legs. It may be true, but it is believed
no further than matches say the same: its whole change of velocity may be none."""
APART = 150_000_000
"""Nanoseconds between neighbours that still tell how the turn changes: an IMU of 10 Hz, no hole."""


_SECOND, _THIRD = [1, 2, 0], [2, 0, 1]
"""The other axes, for each one, in the order of a cross product."""


@dataclass(frozen=True, slots=True, eq=False)
class ImuSeries:
    """Samples in time order: stamps (K,) ns, gyro (K, 3) rad/s, acceleration (K, 3) m/s^2.

    ``turning`` is what was made of samples and of those before them, maybe without the newest ones,
    and ``forces`` what spans are made of, where that was asked for. ``doubts`` (K,) are the
    accelerations that samples may be wrong by, m/s^2; None is none.
    """

    stamps: NDArray[np.int64]
    gyro: NDArray[np.float64]
    acceleration: NDArray[np.float64]
    turning: 'Turning | None' = None
    forces: 'SpanForces | None' = None
    doubts: NDArray[np.float64] | None = None

    @property
    def changes(self) -> NDArray[np.float64]:
        """How the turn changes around each sample (K, 3), rad/s^2 along the IMU's axes.

        Zero for the newest ones of which ``turning`` does not tell.
        """
        turning = turning_of(self.stamps, self.gyro) if self.turning is None else self.turning
        untold = len(self.stamps) - len(turning.changes)
        return np.vstack([turning.changes, np.zeros((untold, 3))]) if untold else turning.changes

    def since(self, stamp: int) -> 'ImuSeries':
        """The samples with a stamp of at least ``stamp``."""
        return self.part(int(self.stamps.searchsorted(stamp)), len(self.stamps))

    def part(self, low: int, high: int) -> 'ImuSeries':
        """The samples at positions [low, high)."""
        turning = None if self.turning is None else self.turning.part(low, high)
        forces = None if self.forces is None else self.forces.part(low, high)
        return ImuSeries(
            self.stamps[low:high],
            self.gyro[low:high],
            self.acceleration[low:high],
            turning,
            forces,
            None if self.doubts is None else self.doubts[low:high],
        )

    def within(self, start: int, end: int) -> 'ImuSeries':
        """The samples with start <= stamp < end."""
        low, high = self.stamps.searchsorted((start, end)).tolist()
        return self.part(low, high)

    def with_forces(self, parameters: gtsam.PreintegrationCombinedParams) -> 'ImuSeries':
        """This series for spans with these ``parameters``: what they share is computed once."""
        return replace(self, forces=span_forces(self, parameters))

    def chosen(self, which: NDArray[np.bool_], unsure: int | None = None) -> 'ImuSeries':
        """Some of the samples; how the turn changes is what they tell without the others.

        Args:
            which: Whether a sample is one of them, (K,).
            unsure: Position of the first sample that may be wrong, as is not known yet: it and all
                behind it have no say for now.
        """
        some = ImuSeries(
            self.stamps[which],
            self.gyro[which],
            self.acceleration[which],
            doubts=None if self.doubts is None else self.doubts[which],
        )
        if self.turning is None:
            return some
        first = int(which.argmin()) if not which.all() else len(which)
        first = first if unsure is None else min(first, unsure)
        if first == len(which):
            return replace(some, turning=self.turning)
        # What an earlier span was made with stays, as far as the others had no say in it.
        known = np.searchsorted(self.turning.ends[:first], self.stamps[first] - SMOOTHED)
        sure = int(np.count_nonzero(which[:unsure]))
        told = turning_of(some.stamps[:sure], some.gyro[:sure], self.turning.part(0, int(known)))
        return replace(some, turning=told)

    def nearest(self, stamp: int) -> 'ImuSeries':
        """The one sample nearest to ``stamp``; empty where there are none."""
        low = int(np.abs(self.stamps - stamp).argmin()) if len(self.stamps) else 0
        return self.part(low, low + 1)

    def joined(self, samples: Sequence[ImuSample]) -> 'ImuSeries':
        """This series with newer samples behind it, and how the turn changes."""
        if not samples:
            return self
        series = self.joined_series(series_of(samples))
        return replace(series, turning=turning_of(series.stamps, series.gyro, self.turning))

    def joined_series(self, newer: 'ImuSeries') -> 'ImuSeries':
        """This series with a newer one behind it."""
        none = self.doubts is None and newer.doubts is None
        return ImuSeries(
            np.concatenate([self.stamps, newer.stamps]),
            np.concatenate([self.gyro, newer.gyro]),
            np.concatenate([self.acceleration, newer.acceleration]),
            doubts=None if none else np.concatenate([self.all_doubts(), newer.all_doubts()]),
        )

    def all_doubts(self) -> NDArray[np.float64]:
        """``doubts``, with zeros for None."""
        return np.zeros(len(self.stamps)) if self.doubts is None else self.doubts


@dataclass(frozen=True, slots=True, eq=False)
class Turning:
    """How a turn changes around each sample, and the rates from which to which.

    Each sample stands for the time nearest to it. ``rates`` (K, 3) are smooth ones at the ends of
    these times, rad/s, and ``ends`` (K,) their stamps, ns; ``changes`` (K, 3) are rad/s^2.
    """

    ends: NDArray[np.int64]
    rates: NDArray[np.float64]
    changes: NDArray[np.float64]

    def part(self, low: int, high: int) -> 'Turning':
        """That of the samples at positions [low, high)."""
        return Turning(self.ends[low:high], self.rates[low:high], self.changes[low:high])


@dataclass(frozen=True, slots=True, eq=False)
class SpanForces:
    """What spans take samples for.

    ``forces`` (K, 3) are the accelerations without what a changing turn adds, m/s^2; ``hard`` (K,)
    are the forces that no vehicle feels, see ``hard_force``, or no match, the ``doubts``; None
    where all are 0, as nearly always.
    """

    forces: NDArray[np.float64]
    hard: NDArray[np.float64] | None

    def part(self, low: int, high: int) -> 'SpanForces':
        """That of the samples at positions [low, high)."""
        return SpanForces(self.forces[low:high], None if self.hard is None else self.hard[low:high])


def span_forces(samples: ImuSeries, parameters: gtsam.PreintegrationCombinedParams) -> SpanForces:
    """What spans with these parameters take samples for."""
    gravity = float(np.linalg.norm(parameters.n_gravity))
    hard = hard_force(samples.acceleration, gravity)
    if samples.doubts is not None:
        hard = np.maximum(hard, samples.doubts)
    return SpanForces(
        samples.acceleration - _swung(samples, parameters.getBodyPSensor()),
        hard if hard.any() else None,
    )


def turning_of(
    stamps: NDArray[np.int64], gyro: NDArray[np.float64], known: Turning | None = None
) -> Turning:
    """Find how a turn changes, so that changes add up to what the smooth rate changes by.

    What was found before new samples came is kept, though they would tell it better: a sample may
    have its say in a span before them and in one behind them, and what is too little in the first
    is to be too much in the second, or noise would add up from window to window.

    Args:
        stamps: Of the samples (K,), ns, in time order.
        gyro: Rates of turn (K, 3), rad/s.
        known: That of the first ones of them.

    Returns:
        That of all; no change where a sample has no neighbour.
    """
    count = len(stamps)
    first = 0 if known is None else len(known.ends)
    if known is not None and first == count:
        return known
    if count < 2:
        return Turning(stamps.copy(), gyro.copy(), np.zeros((count, 3)))
    ends = stamps.copy()
    ends[:-1] += (stamps[1:] - stamps[:-1]) // 2
    ends[-1] += min(int(stamps[-1] - stamps[-2]), APART) // 2
    index = np.arange(count)
    low = np.minimum(stamps.searchsorted(ends - SMOOTHED), index)
    beside = np.minimum(index + 2, count)
    high = np.maximum(stamps.searchsorted(ends + SMOOTHED, side='right'), beside)
    sums = np.zeros((count + 1, 3))
    np.cumsum(gyro, axis=0, out=sums[1:])
    rates = (sums[high] - sums[low]) / (high - low)[:, None]
    if known is not None:
        ends[:first], rates[:first] = known.ends, known.rates
    changes = np.zeros((count, 3))
    passed = ends[1:] - ends[:-1]
    told = (passed > 0) & (passed <= APART)
    changes[1:][told] = (rates[1:] - rates[:-1])[told] / (passed[told] / NANOSECONDS)[:, None]
    changes[0] = changes[1]  # nothing is known of what was before it
    if known is not None:
        changes[:first] = known.changes
    return Turning(ends, rates, changes)


EMPTY_SERIES = ImuSeries(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3)))


def series_of(samples: Sequence[ImuSample]) -> ImuSeries:
    """Samples in time order as a series."""
    if not samples:
        return EMPTY_SERIES
    return ImuSeries(
        np.array([sample.stamp for sample in samples], dtype=np.int64),
        np.array([sample.gyro for sample in samples]),
        np.array([sample.acceleration for sample in samples]),
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
    """As ``preintegrate``, with these ``samples``, one or more, wherever they lie.

    Their ``forces`` are taken for those with these ``parameters``.
    """
    told = samples.forces or span_forces(samples, parameters)
    if told.hard is not None and told.hard.any():
        passed = (end - start) / NANOSECONDS
        parameters = _doubting(parameters, float(told.hard.mean()), passed)
    # Stamps are subtracted as integers: doubles hold epoch nanoseconds to 256 ns only.
    moments = [stamp - start for stamp in samples.stamps.tolist()]
    ends = [(first + second) / 2.0 for first, second in pairwise(moments)]
    ends.append(float(end - start))
    make = (
        gtsam.PreintegratedImuMeasurements
        if constant_bias
        else gtsam.PreintegratedCombinedMeasurements
    )
    preintegrated = make(parameters, bias)
    begin = 0.0
    for force, rate, end_ns in zip(told.forces, samples.gyro, ends, strict=True):
        dt = (end_ns - begin) / NANOSECONDS
        if dt > 0.0:  # a sample exactly at the start has half its time in the span before
            preintegrated.integrateMeasurement(force, rate, dt)
        begin = end_ns
    return preintegrated


def _doubting(
    parameters: gtsam.PreintegrationCombinedParams, felt: float, seconds: float
) -> gtsam.PreintegrationCombinedParams:
    """Parameters with which a hard force that is felt in the mean over a span may be none."""
    eye = np.eye(3)
    made = gtsam.PreintegrationCombinedParams.MakeSharedU(
        float(np.linalg.norm(parameters.n_gravity))
    )
    # White noise of this density adds up to the whole change of velocity.
    made.setAccelerometerCovariance(
        parameters.getAccelerometerCovariance() + eye * felt**2 * max(seconds, 0.0)
    )
    made.setGyroscopeCovariance(parameters.getGyroscopeCovariance())
    made.setBiasAccCovariance(parameters.getBiasAccCovariance())
    made.setBiasOmegaCovariance(parameters.getBiasOmegaCovariance())
    made.setIntegrationCovariance(parameters.getIntegrationCovariance())
    placed = parameters.getBodyPSensor()
    if placed is not None:
        made.setBodyPSensor(placed)
    return made


def hard_force(force: NDArray[np.float64], gravity: float) -> NDArray[np.float64]:
    """How much of a specific force is motion where it is more than vehicles feel, whichever way up.

    Args:
        force: Specific forces (..., 3), m/s^2.
        gravity: Its magnitude, m/s^2.

    Returns:
        The force (...) across gravity that makes the whole, m/s^2; 0 where it is not ``HARD``.
    """
    square = np.square(force).sum(axis=-1)
    hard = np.abs(np.sqrt(square) - gravity) > HARD
    felt: NDArray[np.float64] = np.where(hard, np.sqrt(np.abs(square - gravity**2)), 0.0)
    return felt


def _swung(samples: ImuSeries, T_base_imu: gtsam.Pose3 | None) -> NDArray[np.float64]:
    """Acceleration (K, 3) of an IMU beside base_link as the turn changes, in its axes, m/s^2.

    GTSAM takes off what a steady turn does to a sensor off the centre, but not this. In a hand the
    turn changes by 4 rad/s in a few tenths of a second, which over 0.1 m is 0.4 m/s. A car sinks
    back by 12 mrad as it pulls away at 2 m/s^2: an IMU on its roof, 1.7 m up, comes 20 mm less far.
    """
    arm = np.zeros(3)
    if T_base_imu is not None:
        arm = T_base_imu.rotation().unrotate(T_base_imu.translation())
    if not arm.any():
        return np.zeros((len(samples.stamps), 3))
    changes = samples.changes
    # np.cross takes ten times as long for the few samples of a window.
    swung: NDArray[np.float64] = (
        changes[:, _SECOND] * arm[_THIRD] - changes[:, _THIRD] * arm[_SECOND]
    )
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
