"""Whether another node publishes what this one does: who listens gets two maps in turn."""

import time

from rclpy.node import Node

from incremental_mapper.checks.finding import Finding
from incremental_mapper.checks.live_inputs import second_mapper

LASTS = 30.0
"""Seconds after which it is there to stay: a node that crashed is known for 20 s more."""


class Namesakes:
    """Looks at who publishes on one of this node's topics; used in the executor's thread."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._topic = node.resolve_topic_name('~/odometry')
        self._alone = time.monotonic()

    def findings(self) -> tuple[Finding, ...]:
        """What is wrong by now."""
        if self._node.count_publishers(self._topic) <= 1:
            self._alone = time.monotonic()
        if time.monotonic() - self._alone <= LASTS:
            return ()
        return (second_mapper(self._topic),)
