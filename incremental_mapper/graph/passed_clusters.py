"""Clusters that an IMU span passes over: dead reckoning from where the span starts says where.

Such a cluster has no velocity and no bias, which is what makes a graph small, and without this it
hangs on the matches of its scans alone: an error of one match goes into its pose in full, and
neither the local map nor the factors can tell.

The span has each sample's say on the motion between its two ends. What it leaves open is how the
car came from one to the other, and only that is said here of the rotation: the noise is that of a
Brownian bridge, whose two ends are known. So no sample counts twice. The position follows from the
velocity, which the span uses as well: it is trusted less here than it is known, or it would be
believed more with every window, until matches could no longer correct it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.config import ImuSettings
from incremental_mapper.frontend.dead_reckoning import State
from incremental_mapper.graph.factors import Factor, FactorKind, between_factor, pose_sigmas
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.variables import pose_key

LEAST_TRANSLATION, LEAST_ROTATION = 0.001, 0.0001
"""Metres and radians that dead reckoning errs by at the least: no sigma is zero."""

DISTRUST = 3.0
"""Factor on the velocity's standard deviation: a ninth of what is known of it counts twice then.
With all of it (factor 1) the ATE of a drive that brakes was 0.023 m, with this 0.016 m (base: 0.014
m)."""


@dataclass(frozen=True, slots=True)
class MotionSigmas:
    """How well the state is known from which a window is dead reckoned.

    Attributes:
        velocity: Standard deviation along the worst axis, m/s.
        rate: The same of the gyroscope's bias, rad/s.
    """

    velocity: float
    rate: float


def passed_sigmas(
    passed: float, span: float, known: MotionSigmas, imu: ImuSettings
) -> NDArray[np.float64]:
    """Standard deviations (6,) of a motion that is dead reckoned within a span, rotation first.

    Args:
        passed: Seconds from the start of the span to the cluster, less than ``span``.
        span: Length of the span in seconds.
        known: How well velocity and bias are known.
        imu: Noise densities.
    """
    open_ = passed * (span - passed) / span
    rotation = np.hypot(imu.gyroscope_noise * np.sqrt(open_), known.rate * passed)
    translation = np.hypot(
        imu.accelerometer_noise * passed**1.5, DISTRUST * known.velocity * passed
    )
    return pose_sigmas(max(translation, LEAST_TRANSLATION), max(rotation, LEAST_ROTATION))


def passed_factor(
    keys: tuple[int, int],
    start: State,
    at: State,
    end: int,
    known: MotionSigmas,
    imu: ImuSettings,
    unseen: NDArray[np.float64],
) -> Factor:
    """Relative pose of the cluster that a span starts from and one that it passes over.

    Args:
        keys: Numbers of the two clusters.
        start: The state that is dead reckoned at the stamp of the first one.
        at: The same at the stamp of the second one.
        end: Stamp (ns) of the cluster where the span ends.
        known: How well velocity and bias are known.
        imu: Noise densities.
        unseen: Covariance (6, 6) that a second without the IMU adds, rotation first.
    """
    passed = (at.stamp - start.stamp) / NANOSECONDS
    span = (end - start.stamp) / NANOSECONDS
    hidden = abs(at.unseen - start.unseen)
    sigmas = passed_sigmas(passed, span, known, imu)
    return between_factor(
        FactorKind.DEAD_RECKONING,
        (pose_key(keys[0]), pose_key(keys[1])),
        start.pose.between(at.pose),
        np.diag(sigmas**2) + hidden**2 * unseen,
        None,
        (start.stamp, at.stamp),
    )
