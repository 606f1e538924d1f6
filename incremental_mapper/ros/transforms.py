"""TF after REP-105, map to odom to base, where tf2_ros is installed."""

from typing import Any, Protocol

import gtsam
from geometry_msgs.msg import TransformStamped
from rclpy.node import Node

from incremental_mapper.config import FrameSettings
from incremental_mapper.graph.factors import pose_numbers
from incremental_mapper.ros.result_messages import header


class Transforms(Protocol):
    """Tells where the car is."""

    def send(self, stamp: int, T_map_base: gtsam.Pose3, T_odom_base: gtsam.Pose3) -> None:
        """Broadcast the frames at a stamp (ns)."""


class NoTransforms:
    """Tells nobody."""

    def send(self, stamp: int, T_map_base: gtsam.Pose3, T_odom_base: gtsam.Pose3) -> None:
        """Do nothing."""


class TfTransforms:
    """Broadcasts map to odom, which corrects, and odom to base, which does not jump."""

    def __init__(self, broadcaster: Any, frames: FrameSettings) -> None:
        self._broadcaster = broadcaster
        self._frames = frames

    def send(self, stamp: int, T_map_base: gtsam.Pose3, T_odom_base: gtsam.Pose3) -> None:
        """Broadcast both transforms."""
        frames = self._frames
        T_map_odom = T_map_base.compose(T_odom_base.inverse())
        self._broadcaster.sendTransform(
            [
                _transform(stamp, frames.map, frames.odom, T_map_odom),
                _transform(stamp, frames.odom, frames.base, T_odom_base),
            ]
        )


def make_transforms(node: Node, frames: FrameSettings) -> Transforms:
    """A broadcaster, or none where it is not wanted or tf2_ros is missing, which is said."""
    if not frames.publish_tf:
        return NoTransforms()
    try:
        from tf2_ros import TransformBroadcaster
    except ImportError:
        node.get_logger().info('tf2_ros is not installed: no TF, everything else works')
        return NoTransforms()
    return TfTransforms(TransformBroadcaster(node), frames)


def _transform(stamp: int, parent: str, child: str, pose: gtsam.Pose3) -> TransformStamped:
    message = TransformStamped(header=header(stamp, parent), child_frame_id=child)
    x, y, z, *turn = pose_numbers(pose)
    shift, rotation = message.transform.translation, message.transform.rotation
    shift.x, shift.y, shift.z = x, y, z
    rotation.x, rotation.y, rotation.z, rotation.w = turn
    return message
