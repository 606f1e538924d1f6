"""The robot's own odom to base, as others broadcast it: kept for a while, asked for by stamp."""

from bisect import bisect_left
from collections import deque
from typing import Any

import gtsam
import numpy as np

from incremental_mapper.datasets.static_transforms import Edge, clean, stamped_transforms
from incremental_mapper.geometry import pose_matrix
from incremental_mapper.measurements import NANOSECONDS

KEPT = 30 * NANOSECONDS
"""Nanoseconds for which transforms are kept: windows close after a second even where a sensor is
silent, and a busy mapper lags some more."""
WIDEST = NANOSECONDS
"""Nanoseconds between two transforms over which nothing is interpolated."""


class _Moving:
    """One pair of frames over time, newest last."""

    def __init__(self) -> None:
        self._stamps: deque[int] = deque()
        self._poses: deque[gtsam.Pose3] = deque()

    def take(self, stamp: int, pose: gtsam.Pose3) -> None:
        if self._stamps and stamp <= self._stamps[-1]:
            if self._stamps[-1] - stamp < KEPT:
                return  # out of order, or said again
            self._stamps.clear()  # time began anew
            self._poses.clear()
        self._stamps.append(stamp)
        self._poses.append(pose)
        while self._stamps[-1] - self._stamps[0] > KEPT:
            self._stamps.popleft()
            self._poses.popleft()

    def at(self, stamp: int) -> gtsam.Pose3 | None:
        """Interpolated; None outside of what was heard and in a hole."""
        after = bisect_left(self._stamps, stamp)
        if after == len(self._stamps):
            return None
        if self._stamps[after] == stamp:
            return self._poses[after]
        if after == 0 or self._stamps[after] - self._stamps[after - 1] > WIDEST:
            return None
        first, second = self._stamps[after - 1], self._stamps[after]
        share = (stamp - first) / (second - first)
        return self._poses[after - 1].slerp(share, self._poses[after])


class RobotOdometry:
    """Follows ``/tf`` and ``/tf_static`` and answers for any chain of frames."""

    def __init__(self) -> None:
        self._moving: dict[Edge, _Moving] = {}
        self._static: dict[Edge, gtsam.Pose3] = {}

    def moving(self, message: Any) -> None:
        """Take a ``tf2_msgs/TFMessage`` of /tf; transforms that are none are left out."""
        for stamped, (edge, numbers) in zip(
            message.transforms, stamped_transforms(message), strict=True
        ):
            pose = _pose(numbers)
            if pose is not None:
                at = stamped.header.stamp
                stamp = at.sec * NANOSECONDS + at.nanosec
                self._moving.setdefault(edge, _Moving()).take(stamp, pose)

    def static(self, message: Any) -> None:
        """Take one of /tf_static."""
        for edge, numbers in stamped_transforms(message):
            pose = _pose(numbers)
            if pose is not None:
                self._static[edge] = pose

    def at(self, stamp: int, parent: str, child: str) -> gtsam.Pose3 | None:
        """T_parent_child at a stamp (ns), down the tree; None where it is not known."""
        parent, here = clean(parent), clean(child)
        pose = gtsam.Pose3()
        above = {edge[1]: edge[0] for edge in (*self._static, *self._moving)}
        for _ in range(len(above) + 1):
            if here == parent:
                return pose
            edge = above.get(here, ''), here
            moving = self._moving.get(edge)
            step = self._static.get(edge) if moving is None else moving.at(stamp)
            if step is None:
                return None
            pose, here = step.compose(pose), edge[0]
        return None


def _pose(numbers: np.ndarray) -> gtsam.Pose3 | None:
    try:
        return gtsam.Pose3(pose_matrix(numbers.tolist()))
    except ValueError:
        return None
