"""Waiting for those who are to hear a bag: what is played before they listen is lost."""

import time
from collections.abc import Callable, Mapping
from typing import Any

from rclpy.node import Node

from incremental_mapper.ros.programs import NODE_NAME

MEASUREMENTS = ('sensor_msgs/msg/PointCloud2', 'sensor_msgs/msg/Imu', 'sensor_msgs/msg/NavSatFix')
"""Types of what is mapped."""

_LOOK = 0.05
"""Seconds between two looks."""
_FOUND = 0.5
"""Seconds that discovery has for the other way round."""
_SETTLED = 1.0
"""Seconds without a new subscription after which no more are expected."""
_COMPILED = 600.0
"""Seconds that a mapper may take to start: on its first start it compiles, for minutes where the
machine is busy."""
_UNSAID = 3.0
"""Seconds after which whoever waits is told so."""


class Subscribers:
    """Those who have subscribed to the topics of a player.

    Where it plays measurements, only these are looked at: whoever shows pictures or transforms
    is no reason to begin.
    """

    def __init__(self, node: Node, publishers: Mapping[str, Any], types: Mapping[str, str]) -> None:
        """``publishers`` and ``types`` are by topic."""
        self._node = node
        measured = [name for name in publishers if types[name] in MEASUREMENTS]
        self._awaited = {name: publishers[name] for name in measured or publishers}

    def missing(self) -> list[str]:
        """Topics to which nobody has subscribed."""
        return [name for name, it in self._awaited.items() if it.get_subscription_count() == 0]

    def wait(
        self,
        seconds: float,
        pause: Callable[[float], bool],
        tell: Callable[[str], object],
    ) -> bool:
        """Wait until every topic has a subscription, or no more come to those that have.

        Args:
            seconds: The longest wait; it begins when a mapper that is starting listens.
            pause: Waits for so many seconds; true where the user wants to begin at once.
            tell: Is told what is waited for, if it takes long.

        Returns:
            False where there is no subscription.
        """
        begin = changed = time.monotonic()
        end = begin + seconds
        before, told = 0, False
        while (now := time.monotonic()) < end:
            counts = [publisher.get_subscription_count() for publisher in self._awaited.values()]
            if sum(counts) != before:
                before, changed = sum(counts), now
            # A subscription that was found here has not always found the publisher yet.
            enough = _FOUND if all(counts) else _SETTLED
            starting = self._mapper_starts()
            if before and now - changed >= enough and not starting:
                return True
            if starting and now - begin < _COMPILED:
                end = now + seconds
            if not told and now - begin >= _UNSAID:
                told = True
                names = ', '.join(self.missing()) or 'its other topics'
                who = 'the mapper, which is starting, to subscribe' if starting else 'subscriptions'
                tell(f'waits {seconds:g} s for {who} to {names}; --no-wait begins at once')
            if pause(_LOOK):
                break
        return before > 0

    def _mapper_starts(self) -> bool:
        """Whether there is a mapper that does not listen yet: it has its name seconds before."""
        for name, namespace in self._node.get_node_names_and_namespaces():
            if name != NODE_NAME:
                continue
            try:
                found = self._node.get_subscriber_names_and_types_by_node(name, namespace)
            # It has ended since; rclpy raises what depends on its version.
            except Exception:
                continue
            if not any(MEASUREMENTS[0] in types for _, types in found):
                return True
        return False
