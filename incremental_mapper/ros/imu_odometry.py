"""``~/odometry_imu``: the pose in ``odom`` at the rate of the IMU, where the settings want it."""

import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry
from rclpy.node import Node

from incremental_mapper.config import Config
from incremental_mapper.datasets.sensor_settings import with_settings
from incremental_mapper.mapping.following import PoseUpdate
from incremental_mapper.mapping.imu_prediction import ImuPrediction
from incremental_mapper.measurements import ImuSample, Measurement
from incremental_mapper.results.messages.finite_gate import FiniteGate
from incremental_mapper.ros.publishers import QUIET, node_name, reliable
from incremental_mapper.ros.rclpy_types import MESSAGES

DEPTH = 100
"""Samples that wait for a slow reader."""


class ImuOdometry:
    """Publishes what is predicted with every sample; used in the executor's thread only."""

    def __init__(self, node: Node, config: Config) -> None:
        """Begin to publish; ``config`` are the settings of the first map."""
        self._config = config
        self._name = f'{node_name(node)}: odometry_imu'
        self._publisher = node.create_publisher(
            Odometry, '~/odometry_imu', reliable(DEPTH), event_callbacks=QUIET
        )
        self._counted, self._since = 0, time.monotonic()
        self._most = 0.0
        self._prediction = ImuPrediction(config)
        self._gate = FiniteGate(node.get_logger().error)

    def take(self, measurement: Measurement) -> None:
        """Take a measurement as its message has it; those of other sensors are left alone."""
        if not isinstance(measurement, ImuSample):
            return
        sample = with_settings(measurement, self._config)
        assert isinstance(sample, ImuSample)
        predicted = self._prediction.take(sample)
        if predicted is None:
            return
        pose = predicted.pose.matrix()
        if self._gate.passes('~/odometry_imu', pose=pose, velocity=predicted.velocity):
            frames = self._config.frames
            self._publisher.publish(MESSAGES.odometry(predicted, frames.odom, frames.base))

    def pose(self, update: PoseUpdate) -> None:
        """Start from a window's newest state."""
        self._prediction.rebase(update.newest, update.odometry)
        self._most = max(self._most, self._prediction.correction)

    def retime(self, config: Config) -> None:
        """Go on with stamps that other settings put right."""
        self._config = config

    def restart(self, config: Config) -> None:
        """Begin anew with the settings of the next map."""
        self._config = config
        self._prediction = ImuPrediction(config)
        self._counted, self._most = 0, 0.0

    def status(self) -> Any:
        """A line of /diagnostics: the rate since the last call, corrections, and why it stopped."""
        now, prediction = time.monotonic(), self._prediction
        rate = (prediction.predicted - self._counted) / max(now - self._since, 1e-3)
        self._counted, self._since = prediction.predicted, now
        stopped = prediction.stopped
        values = {
            'rate_hz': round(rate, 1),
            'correction_m': round(prediction.correction, 4),
            'largest_correction_m': round(self._most, 4),
        }
        if stopped is None and rate > 0.0:
            return MESSAGES.status(self._name, DiagnosticStatus.OK, 'predicting', values)
        silent = 'no usable IMU sample comes' if stopped is None else stopped
        return MESSAGES.status(self._name, DiagnosticStatus.WARN, str(silent), values)


def make_imu_odometry(node: Node, config: Config) -> ImuOdometry | None:
    """The publisher, None where the settings do not want it."""
    return ImuOdometry(node, config) if config.imu_odometry.publish else None
