"""The IMU in front of scan matching: where a scan lies to the one before, and how it is deskewed.

Rotation comes from the gyroscope, translation from a velocity that the matches tell and the
accelerometer carries on. Everything here is known to one LiDAR's chain alone, its own matches
included: what the smoother knows arrives when it is done, and a run would depend on when that is.
"""

from dataclasses import dataclass, replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.config import Config
from incremental_mapper.frontend.imu_preintegration import (
    EMPTY_SERIES,
    ImuSeries,
    hard_force,
)
from incremental_mapper.frontend.inertial_motion import Leap, Strip, make_strip
from incremental_mapper.frontend.preprocessing import Sweep, Twist
from incremental_mapper.measurements import NANOSECONDS

Array = NDArray[np.float64]

UNKNOWN_SPEED, MATCHED_SPEED = 20.0, 0.5
"""Standard deviation of a velocity, m/s, that nobody knows, and that one match told."""
REPEATED = 3.0
"""Factor on the covariance of a match: one after the other is made to much the same map, and
repeats its errors, which a filter that takes them for independent would follow."""
LEVELLED = 1.5
"""Standard deviation of gravity, m/s^2, by the mean force over a sweep: vehicles accelerate."""
HARDEST = 40.0
"""m/s^2 on the mean of some 50 ms that no vehicle feels, nor a hand: somebody knocked the IMU."""
FORCE_NOISE = 0.3
"""m/s^2 by which the mean force between two scans is off: vibration, scale, and how well the
samples between are known. It limits how far the velocity is believed over many scans."""
GRAVITY = 9.81
"""m/s^2 of which the size of the mean force between two scans is no more than a little off."""
GRAVITY_WALK = 0.1
"""m/s^2/sqrt(s) by which gravity as the IMU feels it wanders, with the biases and their turning."""
BIAS, BIAS_WALK = 0.02, 0.0002
"""Standard deviation of the gyroscope's bias at first, rad/s, and its walk, rad/s/sqrt(s)."""
TURN_NOISE = 0.005
"""Standard deviation of a match's rotation, radians, where its own covariance says less."""
TURN_OFF, SHIFT_OFF = 0.01, 0.05
"""Radians and metres by which the IMU may be further off a match than steady motion is."""
MEMORY, MOST_WRONG = 0.9, 2.2
"""A match that the IMU was further off counts as one, and so much less with each one after it. So
much of it is a knock, more is an IMU that is not as the settings say."""
UNPROVEN = 3.0
"""What counts against it at first: it leads once it has agreed with three matches of steady motion.
Rates in another unit would deskew the very sweeps by which the unit is told."""


@dataclass(frozen=True, slots=True, eq=False)
class Momentum:
    """How an IMU moves: its velocity and gravity, in base_link's axes.

    ``velocity`` (3,) is in m/s, ``gravity`` (3,) in m/s^2, ``covariance`` (6, 6) of both in this
    order. Gravity is as the accelerometer feels it: its bias is in there, as far as the vehicle
    keeps its attitude.
    """

    velocity: Array
    gravity: Array
    covariance: Array

    def carried(self, leap: Leap) -> 'Momentum':
        """The same at the end of a leap, in the axes there."""
        passed, back = leap.seconds, leap.rotation.T
        step = np.zeros((6, 6))
        step[:3, :3] = step[3:, 3:] = back
        step[:3, 3:] = passed * back
        felt = float(hard_force(leap.velocity / passed, GRAVITY)) if passed else 0.0
        shaken = FORCE_NOISE**2 + felt**2
        noise = np.repeat([shaken * passed**2, GRAVITY_WALK**2 * abs(passed)], 3)
        return Momentum(
            back @ (self.velocity + self.gravity * passed + leap.velocity),
            back @ self.gravity,
            step @ self.covariance @ step.T + np.diag(noise),
        )

    def corrected(self, leap: Leap, shift: Array, noise: Array) -> 'Momentum':
        """The same at the start of a leap, once it is known how far it went.

        Args:
            leap: What the IMU says of it.
            shift: Way (3,) of the IMU in the axes at the start, metres.
            noise: Covariance (3, 3) of the way, m^2.
        """
        passed = leap.seconds
        seen = np.hstack([passed * np.eye(3), 0.5 * passed**2 * np.eye(3)])
        off = shift - (self.velocity * passed + 0.5 * self.gravity * passed**2 + leap.position)
        gain = np.linalg.solve(seen @ self.covariance @ seen.T + noise, seen @ self.covariance).T
        change = gain @ off
        left = np.eye(6) - gain @ seen
        covariance = left @ self.covariance @ left.T + gain @ noise @ gain.T
        return Momentum(self.velocity + change[:3], self.gravity + change[3:], covariance)

    def at_first(self, corrected: 'Momentum') -> 'Momentum':
        """What was found, as uncertain as before: for matching the same two scans again."""
        return replace(corrected, covariance=self.covariance)


class ImuGuide:
    """The IMU's samples for one LiDAR's chain, its bias, and whether it is to be believed.

    It is once it has agreed with some matches about as well as steady motion does, and as long as
    it does: no sweep is deskewed by an IMU that nothing speaks for. Where its extrinsics, units or
    clock are wrong it does not once the vehicle turns, and matches stay what they are without it.
    """

    def __init__(self, config: Config) -> None:
        """Make ready; without ``odometry.imu_guess`` there is no strip ever."""
        turn = config.imu.matrix()
        self._turn, self._arm = turn[:3, :3], turn[:3, 3]
        self._on = config.odometry.imu_guess
        self._max_gap = config.preintegration.max_gap
        self._noise = (config.odometry.sigma_rotation, config.odometry.sigma_translation)
        self._series = EMPTY_SERIES
        self._bias, self._bias_variance = np.zeros(3), BIAS**2
        self._wrong = UNPROVEN  # matches that it was further off than steady motion, of late

    def take(self, samples: ImuSeries, since: int) -> None:
        """Take in newer samples, in the IMU's axes, and forget those before a stamp (ns)."""
        if self._on and len(samples.stamps):
            self._series = self._series.joined_series(
                ImuSeries(
                    samples.stamps,
                    samples.gyro @ self._turn.T,
                    samples.acceleration @ self._turn.T,
                )
            ).since(since - round(self._max_gap * NANOSECONDS))

    @property
    def trusted(self) -> bool:
        """Whether it agrees with the matches."""
        return self._wrong <= MOST_WRONG

    def strip(self, sweep: Sweep, *more: float) -> Strip | None:
        """The samples over a sweep and more moments, seconds after its stamp, integrated.

        Args:
            sweep: Its stamp, its middle, its first and its last point become nodes.
            more: What else does.

        Returns:
            The strip; None where there is a hole, nothing to integrate, or a knock.
        """
        if len(self._series.stamps) == 0:
            return None
        ends = () if sweep.times is None else (float(sweep.times.min()), float(sweep.times.max()))
        series = replace(self._series, gyro=self._series.gyro - self._bias)
        moments = (0.0, sweep.middle, *ends, *more)
        strip = make_strip(series, sweep.stamp, moments, self._arm, self._max_gap)
        return None if strip is None or strip.hardest() > HARDEST else strip

    def begin(self, strip: Strip, moment: float, twist: Twist | None) -> Momentum:
        """What is known at a moment, a node, without any momentum before.

        Args:
            strip: Samples around it.
            moment: Seconds after the sweep's stamp.
            twist: The motion by a match; None where there is none yet.
        """
        sigma = UNKNOWN_SPEED if twist is None else MATCHED_SPEED
        velocity = np.zeros(3)
        if twist is not None:
            velocity = twist.linear + np.cross(twist.angular, self._arm)
        return Momentum(
            velocity,
            -strip.mean_force(moment),
            np.diag(np.repeat([sigma**2, LEVELLED**2], 3)),
        )

    def follow(
        self,
        before: Momentum,
        leap: Leap,
        motion: gtsam.Pose3,
        covariance: Array | None,
    ) -> tuple[Momentum, Momentum]:
        """Learn from a match how the IMU moved.

        Args:
            before: What was known at the start of the leap.
            leap: What the samples say of the way from the one scan to the other.
            motion: What the match says of it, T_previous_current.
            covariance: Of the match (6, 6), in the current scan's frame; None takes the sigmas.

        Returns:
            The momentum at the start, and at the end.
        """
        turn = motion.rotation().matrix()
        own = np.diag(np.repeat(np.square(self._noise), 3)) if covariance is None else covariance
        own = REPEATED * own
        self._learn_bias(leap, turn, own)
        shift = motion.translation() - self._arm + turn @ self._arm
        corrected = before.corrected(leap, shift, turn @ own[3:, 3:] @ turn.T)
        return corrected, corrected.carried(leap)

    def _learn_bias(self, leap: Leap, turn: Array, covariance: Array) -> None:
        off = gtsam.Rot3.Logmap(gtsam.Rot3(turn.T @ leap.rotation)) / leap.seconds
        noise = max(float(np.trace(covariance[:3, :3])) / 3.0, TURN_NOISE**2) / leap.seconds**2
        if float(off @ off) > 9.0 * 3.0 * (noise + self._bias_variance):
            return  # a knock, or a wrong match
        gain = self._bias_variance / (self._bias_variance + noise)
        self._bias = self._bias + gain * off
        self._bias_variance = (1.0 - gain) * self._bias_variance + BIAS_WALK**2 * leap.seconds

    def judge(self, motion: gtsam.Pose3, expected: gtsam.Pose3, steady: gtsam.Pose3) -> None:
        """Hold a match against what the IMU and what steady motion expected."""
        allowed = squares(motion, steady) + np.square([TURN_OFF, SHIFT_OFF])
        wrong = bool((squares(motion, expected) > allowed).any())
        self._wrong = MEMORY * self._wrong + float(wrong)


def squares(one: gtsam.Pose3, other: gtsam.Pose3) -> Array:
    """Squares (2,) of the angle and the distance between two poses."""
    apart = other.between(one)
    angle = gtsam.Rot3.Logmap(apart.rotation())
    shift = apart.translation()
    return np.array([angle @ angle, shift @ shift])
