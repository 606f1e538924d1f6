"""Clusters that an IMU span passes over: the span's own samples say where on the way they lie.

Such a cluster has no velocity and no bias, which is what makes a graph small, and without this it
hangs on the matches of its scans alone: an error of one match goes into its pose in full, neither
the local map nor the factors can tell, and what its scans know of the motion hardly reaches the
clusters around it.

It is held by the samples from the start of the span up to it, as an IMU factor of its own would
hold it, from the pose, the velocity and the bias of the start. The span has each sample's say on
the motion between its two ends already. What it leaves open is how the vehicle came from one to the
other, and only that is said here: the noise is that of white noise between two known ends, and the
velocity on the way is left free. So no sample counts twice.

A cluster so close behind another that no sample lies between can be no end of a span, and a span
that passes over it may come windows later or never. It is held by where the velocity takes it in
those few milliseconds.
"""

from dataclasses import dataclass

import gtsam
import numpy as np

from incremental_mapper.config import ImuSettings
from incremental_mapper.frontend.dead_reckoning import State
from incremental_mapper.graph.factors import (
    Factor,
    FactorKind,
    between_factor,
    describe_imu,
    pose_sigmas,
)
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.variables import bias_key, pose_key, velocity_key

LEAST_TRANSLATION, LEAST_ROTATION = 0.001, 0.0001
"""Metres and radians that dead reckoning errs by at the least: no sigma is zero."""
FREE = 1e3
"""m/s; deviation of the velocity, of which nothing is said."""
DISTRUST = 3.0
"""Factor on the velocity's standard deviation where it says where a close cluster is: a ninth of
what is known of it counts twice then."""


@dataclass(frozen=True, slots=True)
class MotionSigmas:
    """How well the state is known from which a window is dead reckoned.

    Attributes:
        velocity: Standard deviation along the worst axis, m/s.
        rate: The same of the gyroscope's bias, rad/s.
    """

    velocity: float
    rate: float


def passed_sigmas(passed: float, span: float, imu: ImuSettings) -> tuple[float, float]:
    """Standard deviations of rotation (rad) and position (m) within a span whose ends are known.

    Args:
        passed: Seconds from the start of the span to the cluster, less than ``span``.
        span: Length of the span in seconds.
        imu: Noise densities.
    """
    # What white noise w adds to the angle at t, the integral of w up to t, is known at both ends:
    # a Brownian bridge. The position is that of a given velocity at the start, which the end tells:
    # the variance of the integral of (t - u) w up to t, less t/T times that up to T.
    rest = span - passed
    rotation = imu.gyroscope_noise * np.sqrt(passed * rest / span)
    translation = imu.accelerometer_noise * passed * rest / np.sqrt(3.0 * span)
    return max(rotation, LEAST_ROTATION), max(translation, LEAST_TRANSLATION)


def passed_factor(
    clusters: tuple[int, int, int],
    stamps: tuple[int, int, int],
    preintegrated: gtsam.PreintegratedImuMeasurements,
    bias: int,
    imu: ImuSettings,
    samples: int,
) -> Factor:
    """Motion from the cluster that a span starts from to one that it passes over.

    Args:
        clusters: Numbers of the one where the span starts, of the one on the way, and of the one
            where it ends.
        stamps: Theirs, ns.
        preintegrated: The samples from the first one to the second.
        bias: Number of the cluster whose bias they have.
        imu: Noise densities.
        samples: How many they are.
    """
    start, passed, end = clusters
    seconds = [(stamp - stamps[0]) / NANOSECONDS for stamp in stamps[1:]]
    rotation, translation = passed_sigmas(seconds[0], seconds[1], imu)
    noise = gtsam.noiseModel.Diagonal.Sigmas(
        np.array([rotation] * 3 + [translation] * 3 + [FREE] * 3)
    )
    # An IMU factor wants a velocity at its end: the next one that there is stands for it.
    keys = pose_key(start), velocity_key(start), pose_key(passed), velocity_key(end), bias_key(bias)
    factor = gtsam.ImuFactor(*keys, preintegrated).cloneWithNewNoiseModel(noise)
    return Factor(
        kind=FactorKind.IMU_PART,
        keys=tuple(factor.keys()),
        factor=factor,
        stamps=stamps[:2],
        describe=describe_imu((stamps[0], stamps[1]), samples),
    )


def close_factor(
    clusters: tuple[int, int], start: State, at: State, known: MotionSigmas, imu: ImuSettings
) -> Factor:
    """Motion to a cluster so close behind another that no sample lies between.

    Args:
        clusters: Numbers of the two.
        start: The state that is dead reckoned at the stamp of the first one.
        at: The same at the stamp of the second one.
        known: How well velocity and bias are known.
        imu: Noise densities.
    """
    passed = (at.stamp - start.stamp) / NANOSECONDS
    rotation = np.hypot(imu.gyroscope_noise * np.sqrt(passed), known.rate * passed)
    translation = np.hypot(
        imu.accelerometer_noise * passed**1.5, DISTRUST * known.velocity * passed
    )
    sigmas = pose_sigmas(max(translation, LEAST_TRANSLATION), max(rotation, LEAST_ROTATION))
    return between_factor(
        FactorKind.DEAD_RECKONING,
        (pose_key(clusters[0]), pose_key(clusters[1])),
        start.pose.between(at.pose),
        np.diag(sigmas**2),
        None,
        (start.stamp, at.stamp),
    )
