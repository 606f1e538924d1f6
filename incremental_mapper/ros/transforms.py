"""TF after REP-105: map to odom to base, or map to odom alone, where tf2_msgs is installed."""

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import gtsam
import numpy as np
from geometry_msgs.msg import TransformStamped
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from incremental_mapper.config import FrameSettings, TfMode, TfSettings
from incremental_mapper.datasets.static_transforms import MOVING_TOPIC, STATIC_TOPIC, clean
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.ros.rclpy_types import MESSAGES
from incremental_mapper.ros.robot_odometry import RobotOdometry
from incremental_mapper.ros.shared_frames import SharedFrames

Send: TypeAlias = Callable[[list[TransformStamped]], object]
"""Publishes transforms as one message."""


class Transforms:
    """Tells where the car is, and where sensors are of which nobody else does.

    ``robot`` is to be told the transforms of others where only map to odom is broadcast, ``shared``
    those of /tf_static. All of it runs in the executor's thread.
    """

    def __init__(
        self, settings: TfSettings, frames: FrameSettings, send: Send, send_static: Send
    ) -> None:
        """Make ready.

        Args:
            settings: What is broadcast.
            frames: Names of the frames.
            send: Takes what moves.
            send_static: Takes what does not.
        """
        self.robot = RobotOdometry()
        self.shared = SharedFrames(settings.publish, frames)
        self.unanswered = 0
        self._settings = settings
        self._frames = frames
        self._send = send
        self._send_static = send_static
        self._waiting: tuple[int, gtsam.Pose3] | None = None
        self._static: dict[str, TransformStamped] = {}

    @property
    def listens(self) -> bool:
        """Whether the robot's own odometry is needed."""
        return self._settings.publish is TfMode.MAP_TO_ODOM

    def send(self, stamp: int, T_map_base: gtsam.Pose3, T_odom_base: gtsam.Pose3) -> None:
        """Broadcast where the car is at a stamp (ns), as far as the settings want it."""
        if self._settings.publish is TfMode.NONE:
            return
        if self.listens:
            self.unanswered += self._waiting is not None
            self._waiting = stamp, T_map_base
            self.look()
            return
        frames = self._frames
        base = transform_message(stamp, frames.odom, frames.base, T_odom_base)
        self.shared.sent(frames.base, stamp)
        self._send([self._map_to_odom(stamp, T_map_base, T_odom_base), base])

    def look(self) -> None:
        """Broadcast map to odom as soon as the robot has told odom to base of the same stamp."""
        if self._waiting is None:
            return
        stamp, T_map_base = self._waiting
        T_odom_base = self.robot.at(stamp, self._frames.odom, self._frames.base)
        if T_odom_base is not None:
            self._send([self._map_to_odom(stamp, T_map_base, T_odom_base)])
            self._waiting = None

    def sensors(self, stamp: int, places: Mapping[str, NDArray[np.float64]]) -> None:
        """Publish T_base_sensor (4, 4) by frame_id, those of earlier calls among them."""
        fresh = {name: place for name, place in places.items() if name not in self._static}
        if not fresh or not self._settings.sensors:
            return
        for name, place in fresh.items():
            pose = gtsam.Pose3(place)
            self._static[name] = transform_message(stamp, self._frames.base, name, pose)
        # Of a latched topic late joiners get one message of each publisher.
        self._send_static(list(self._static.values()))

    def _map_to_odom(
        self, stamp: int, T_map_base: gtsam.Pose3, T_odom_base: gtsam.Pose3
    ) -> TransformStamped:
        T_map_odom = T_map_base.compose(T_odom_base.inverse())
        ahead = round(self._settings.ahead * NANOSECONDS)
        self.shared.sent(self._frames.odom, stamp + ahead)
        return transform_message(stamp + ahead, self._frames.map, self._frames.odom, T_map_odom)


def make_transforms(node: Node, settings: TfSettings, frames: FrameSettings) -> Transforms | None:
    """What broadcasts, or None where nothing is wanted or tf2_msgs is missing, which is said."""
    if settings.publish is TfMode.NONE and not settings.sensors:
        return None
    try:
        from tf2_msgs.msg import TFMessage
    except ImportError:
        text = 'tf2_msgs is not installed: no TF, everything else works'
        if settings.publish is TfMode.MAP_TO_ODOM:
            node.get_logger().warning(f'{text}; tf.publish: map_to_odom has no effect')
        else:
            node.get_logger().info(text)
        return None
    quality = {'history': HistoryPolicy.KEEP_LAST, 'reliability': ReliabilityPolicy.RELIABLE}
    passing = QoSProfile(depth=100, durability=DurabilityPolicy.VOLATILE, **quality)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL, **quality)
    kept = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL, **quality)
    moving = node.create_publisher(TFMessage, MOVING_TOPIC, passing)
    static = node.create_publisher(TFMessage, STATIC_TOPIC, latched)
    transforms = Transforms(
        settings,
        frames,
        lambda items: moving.publish(TFMessage(transforms=items)),
        lambda items: static.publish(TFMessage(transforms=items)),
    )
    if transforms.listens:

        def take(message: Any) -> None:
            transforms.robot.moving(message)
            transforms.look()

        node.create_subscription(TFMessage, MOVING_TOPIC, take, passing)
        node.create_subscription(TFMessage, STATIC_TOPIC, transforms.robot.static, kept)
    return transforms


def transform_message(stamp: int, parent: str, child: str, pose: gtsam.Pose3) -> TransformStamped:
    """T_parent_child as a message; names have no slash in front."""
    message: TransformStamped = MESSAGES.transform(stamp, clean(parent), clean(child), pose)
    return message
