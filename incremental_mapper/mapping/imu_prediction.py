"""Where the car is between two windows: the newest state, carried on by the IMU's samples since."""

from collections import deque
from dataclasses import dataclass
from enum import StrEnum

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.config import Config
from incremental_mapper.frontend.imu_preintegration import preintegration_parameters
from incremental_mapper.mapping.imu_intake import ImuIntake
from incremental_mapper.mapping.newest_state import NewestState
from incremental_mapper.mapping.odometry_frame import OdometryPose
from incremental_mapper.measurements import NANOSECONDS, ImuSample

UNKNOWN_SPEED = 0.5
"""m/s, deviation of a velocity of which the graph says no covariance; it predicts by no worse."""


class Stopped(StrEnum):
    """Why nothing is predicted."""

    NO_STATE = 'no window has told velocity and bias yet'
    TOO_OLD = 'the last window is too old'
    HOLE = 'a hole in the IMU since the last window'


@dataclass(frozen=True, slots=True, eq=False)
class _Start:
    """Where the prediction starts from: the newest state, and where it is in ``odom``."""

    newest: NewestState
    odometry: OdometryPose
    bias: gtsam.imuBias.ConstantBias
    state: gtsam.NavState


class ImuPrediction:
    """Carries the newest state on in ``odom``, and starts anew from every window at once.

    What is predicted jumps by what the IMU drifted since the window before, ``correction``; the
    frame itself does not. ``stopped`` says why nothing is predicted, None while it is.
    """

    def __init__(self, config: Config) -> None:
        """Make ready for the first sample; ``config`` tells of the IMU and the limits."""
        self.stopped: Stopped | None = Stopped.NO_STATE
        self.correction = 0.0
        """Metres by which the newest window moved what had been predicted for its sample."""
        self.predicted = 0
        self._config = config
        self._intake = ImuIntake(config.imu, config.preintegration.gravity)
        T_base_imu = config.imu.matrix()
        self._R_base_imu = T_base_imu[:3, :3]
        self._parameters = preintegration_parameters(config.preintegration, T_base_imu)
        self._most_gap = round(config.preintegration.max_gap * NANOSECONDS)
        self._most_age = round(config.imu_odometry.max_age * NANOSECONDS)
        self._period = NANOSECONDS / config.imu_odometry.max_rate
        self._samples: deque[ImuSample] = deque()
        self._start: _Start | None = None
        self._span = gtsam.PreintegratedCombinedMeasurements(self._parameters)
        self._reached = 0
        self._due = 0.0

    def take(self, measurement: ImuSample) -> NewestState | None:
        """Take the next sample, as its message has it but for the clock.

        Args:
            measurement: The sample.

        Returns:
            The state at its stamp, pose and velocity in ``odom``; None where there is none, or it
            is not due yet.
        """
        sample = self._intake.take(measurement)
        if sample is None or (self._samples and sample.stamp <= self._samples[-1].stamp):
            return None
        self._samples.append(sample)
        while sample.stamp - self._samples[0].stamp > self._most_age + self._most_gap:
            self._samples.popleft()
        if self._start is None or sample.stamp <= self._start.newest.stamp:
            return None
        self._advance(self._start, len(self._samples) - 1)
        if self.stopped is not None or sample.stamp < self._due:
            return None
        # A grid of stamps, so that a rate just below the IMU's own is not halved.
        self._due = max(self._due + self._period, sample.stamp - 0.5 * self._period)
        self.predicted += 1
        return self._told(self._start, sample)

    def rebase(self, newest: NewestState, odometry: OdometryPose) -> None:
        """Start from a window's newest state.

        Args:
            newest: The state in the map, where gravity points down.
            odometry: Where the car is in ``odom`` at the same stamp.
        """
        if newest.bias is None:
            return
        before, reached = self._pose(), self._reached
        moving = gtsam.NavState(newest.pose, newest.velocity)
        self._start = start = _Start(newest, odometry, newest.bias, moving)
        self._span = gtsam.PreintegratedCombinedMeasurements(self._parameters, newest.bias)
        self._reached = newest.stamp
        self.stopped = None
        for index, sample in enumerate(self._samples):
            if sample.stamp > newest.stamp:
                self._advance(start, index)
        after = self._pose()
        if before is not None and after is not None and reached == self._reached:
            self.correction = float(np.linalg.norm(before.between(after).translation()))

    def _advance(self, start: _Start, index: int) -> None:
        """Integrate up to a sample; between two samples the mean of both stands."""
        sample = self._samples[index]
        if self.stopped is not None:
            return
        if sample.stamp - start.newest.stamp > self._most_age:
            self.stopped = Stopped.TOO_OLD
            return
        before = self._samples[index - 1] if index else sample
        earlier = before.stamp if index else self._reached
        if sample.stamp - earlier > self._most_gap:
            self.stopped = Stopped.HOLE
            return
        seconds = (sample.stamp - self._reached) / NANOSECONDS
        force = 0.5 * (before.acceleration + sample.acceleration)
        rate = 0.5 * (before.gyro + sample.gyro)
        # GTSAM has the axes stand still meanwhile, which is 3 mm/s off after 0.5 s on a bend.
        force = gtsam.Rot3.Expmap(0.5 * seconds * rate).rotate(force)
        self._span.integrateMeasurement(force, rate, seconds)
        self._reached = sample.stamp

    def _pose(self) -> gtsam.Pose3 | None:
        """What is predicted now, T_odom_base; None where nothing is."""
        start = self._start
        if start is None or self.stopped is not None or self._reached == start.newest.stamp:
            return None
        reached = self._span.predict(start.state, start.bias).pose()
        return start.odometry.T_map_odom.between(reached)

    def _told(self, start: _Start, sample: ImuSample) -> NewestState:
        reached = self._span.predict(start.state, start.bias)
        T_odom_map = start.odometry.T_map_odom.inverse()
        pose_covariance, velocity_covariance = self._covariances(start, reached)
        noise = np.eye(3) * self._config.preintegration.gyroscope_noise**2 * 100.0
        known = start.newest.rate_covariance
        return NewestState(
            stamp=sample.stamp,
            pose=T_odom_map.compose(reached.pose()),
            covariance=pose_covariance,
            velocity=T_odom_map.rotation().rotate(reached.velocity()),
            velocity_covariance=velocity_covariance,
            rate=self._R_base_imu @ (sample.gyro - start.bias.gyroscope()),
            rate_covariance=noise if known is None else known,
            bias=start.bias,
        )

    def _covariances(
        self, start: _Start, reached: gtsam.NavState
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Of the pose (6, 6), GTSAM's order, and of the velocity (3, 3), both in base_link.

        By hand, in the axes of the car at the start: errors of the start, of gravity by the tilt
        of the car in the map, of the bias, and of the samples.
        """
        newest, graph = start.newest, self._config.graph
        seconds = self._span.deltaTij()
        R_base_map = newest.pose.rotation().matrix().T
        turned = (newest.pose.rotation().between(reached.attitude())).matrix().T
        way = R_base_map @ (reached.position() - newest.pose.translation())
        velocity = newest.velocity_covariance
        velocity = np.eye(3) * UNKNOWN_SPEED**2 if velocity is None else velocity
        down = R_base_map @ np.array([0.0, 0.0, -self._config.preintegration.gravity])
        level = np.zeros((3, 3)) if newest.covariance is None else newest.covariance[:3, :3]
        pull = gtsam.Rot3.Hat(down) @ level @ gtsam.Rot3.Hat(down).T
        pull += np.eye(3) * graph.prior_sigma_accelerometer_bias**2
        samples = self._span.preintMeasCov()
        moved = np.eye(6)
        moved[3:, :3] = -gtsam.Rot3.Hat(way)
        pose = moved @ start.odometry.covariance @ moved.T
        pose += samples[:6, :6]
        pose[:3, :3] += np.eye(3) * (graph.prior_sigma_gyroscope_bias * seconds) ** 2
        pose[3:, 3:] += velocity * seconds**2 + pull * (0.5 * seconds**2) ** 2
        ends = np.kron(np.eye(2), turned)
        speed = velocity + pull * seconds**2 + samples[6:9, 6:9]
        return ends @ pose @ ends.T, turned @ speed @ turned.T
