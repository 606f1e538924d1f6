"""Transforms: map to odom to base, wherever tf2_ros is installed."""

import sys
import types

import gtsam
import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (extra "ros")')

from incremental_mapper.config import FrameSettings
from incremental_mapper.ros.transforms import TfTransforms, make_transforms


class FakeBroadcaster:
    def __init__(self, node):
        self.sent = []

    def sendTransform(self, transforms):  # noqa: N802 (the name that tf2_ros has)
        self.sent += transforms


def test_transforms_chain_to_the_pose_in_the_map(monkeypatch):
    fake = types.SimpleNamespace(TransformBroadcaster=FakeBroadcaster)
    monkeypatch.setitem(sys.modules, 'tf2_ros', fake)
    transforms = make_transforms(None, FrameSettings())
    assert isinstance(transforms, TfTransforms)
    in_map = gtsam.Pose3(gtsam.Rot3.Yaw(1.0), np.array([1.0, 2.0, 3.0]))
    in_odom = gtsam.Pose3(gtsam.Rot3.Yaw(0.2), np.array([0.5, 0.0, 0.0]))
    transforms.send(5, in_map, in_odom)
    sent = transforms._broadcaster.sent
    assert [(t.header.frame_id, t.child_frame_id) for t in sent] == [
        ('map', 'odom'),
        ('odom', 'base_link'),
    ]

    def pose(message):
        shift, turn = message.transform.translation, message.transform.rotation
        rotation = gtsam.Rot3(turn.w, turn.x, turn.y, turn.z)
        return gtsam.Pose3(rotation, np.array([shift.x, shift.y, shift.z]))

    assert pose(sent[0]).compose(pose(sent[1])).equals(in_map, 1e-9)
