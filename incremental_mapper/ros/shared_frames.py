"""Whether other programs tell where the frames are that this node tells of: each has one parent."""

import time
from collections import Counter, deque
from typing import Any

from rclpy.node import Node

from incremental_mapper.checks.finding import Finding
from incremental_mapper.checks.live_inputs import shared_frame
from incremental_mapper.config import FrameSettings, TfMode
from incremental_mapper.datasets.static_transforms import (
    MOVING_TOPIC,
    STATIC_TOPIC,
    Edge,
    clean,
    stamped_transforms,
)
from incremental_mapper.measurements import NANOSECONDS

LISTENED = 5.0
"""Seconds for which /tf is listened to once somebody else publishes there: every message costs
time, and there may be hundreds a second."""
SENT = 200
"""Transforms of this node that are known again when they come back."""
PROOF = 3
"""Transforms of another program that are no stray ones."""


class SharedFrames:
    """Watches /tf and /tf_static for the frames of this node; used in the executor's thread."""

    def __init__(self, publish: TfMode, frames: FrameSettings) -> None:
        """Make ready.

        Args:
            publish: What this node broadcasts.
            frames: Names of the frames.
        """
        names = [clean(name) for name in (frames.map, frames.odom, frames.base)]
        told = {TfMode.BOTH: 2, TfMode.MAP_TO_ODOM: 1, TfMode.NONE: 0}[publish]
        self._parents = {child: names[number] for number, child in enumerate(names[1 : told + 1])}
        self._both = publish is TfMode.BOTH
        self._sent: deque[tuple[str, int]] = deque(maxlen=SENT)
        self._seen: Counter[tuple[str, Edge]] = Counter()
        self._others = 0
        self._until = 0.0
        self._subscription: Any = None

    def sent(self, child: str, stamp: int) -> None:
        """Know a transform of this node again.

        Args:
            child: The frame that it places.
            stamp: Its stamp, ns.
        """
        self._sent.append((clean(child), stamp))

    def static(self, message: Any) -> None:
        """Take a message of /tf_static."""
        for edge, _ in stamped_transforms(message):
            if edge[1] in self._parents:
                self._seen[STATIC_TOPIC, edge] += PROOF

    def moving(self, message: Any) -> None:
        """Take a message of /tf."""
        for stamped, (edge, _) in zip(message.transforms, stamped_transforms(message), strict=True):
            at = stamped.header.stamp
            stamp = at.sec * NANOSECONDS + at.nanosec
            key = edge[1], stamp
            if key in self._sent:
                self._sent.remove(key)  # what comes once more is of another mapper
            elif edge[1] in self._parents:
                self._seen[MOVING_TOPIC, edge] += 1

    def look(self, node: Node) -> None:
        """Listen for a while when others begin to publish on /tf, or other ones do.

        Args:
            node: Who listens, where tf2_msgs is installed.
        """
        others = node.count_publishers(MOVING_TOPIC) - 1
        if others != self._others and others > 0 and self._parents:
            self._until = time.monotonic() + LISTENED
            if self._subscription is None:
                from tf2_msgs.msg import TFMessage

                self._subscription = node.create_subscription(
                    TFMessage, MOVING_TOPIC, self.moving, 100
                )
        self._others = others
        if self._subscription is not None and time.monotonic() > self._until:
            node.destroy_subscription(self._subscription)
            self._subscription = None

    def findings(self) -> tuple[Finding, ...]:
        """What is wrong by now."""
        return tuple(
            shared_frame(topic, edge, self._parents[edge[1]], self._both)
            for (topic, edge), count in self._seen.items()
            if count >= PROOF
        )
