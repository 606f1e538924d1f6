"""A client of a running node: its topics as they come, its services, its diagnostics."""

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

try:
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray
    from nav_msgs.msg import Odometry
    from rclpy.context import Context
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
    from rclpy.node import Node
    from rclpy.qos import QoSProfile
    from rclpy.signals import SignalHandlerOptions
    from std_srvs.srv import Trigger
except ImportError as error:
    from incremental_mapper.ros.programs import without_ros

    raise without_ros(error, __name__) from error

from incremental_mapper.errors import InputError
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.results.messages.result_messages import read_status
from incremental_mapper.ros.publishers import reliable

DEPTH = 10_000
"""Messages that may wait: a client that counts must not lose any."""
LOOK = 0.02
"""Seconds between two looks at what is waited for."""


@dataclass(frozen=True, slots=True, eq=False)
class Heard:
    """A message, when it was published and when it came here, in ns of the system's clock."""

    message: Any
    sent: int
    received: int


class NodeClient:
    """Listens to one node and calls it; made by ``open_client``.

    ``odometry`` are its ``Odometry`` messages so far, ``stats`` the values of its
    ``graph_stats``, one a window, ``diagnostics`` those of /diagnostics by the name of the part,
    newest last.
    """

    def __init__(self, context: Context, name: str) -> None:
        self.odometry: list[Heard] = []
        self.stats: list[dict[str, Any]] = []
        self.diagnostics: list[dict[str, dict[str, Any]]] = []
        self._name = name
        self._node = Node(f'{name}_client', context=context, enable_rosout=False)
        self._clients: dict[str, Any] = {}
        self._executor = SingleThreadedExecutor(context=context)
        self.listen(f'/{name}/odometry', Odometry, self.odometry.append, reliable(DEPTH))
        self.listen(
            f'/{name}/graph_stats', DiagnosticArray, self._on_stats, reliable(DEPTH, latched=True)
        )
        self.listen('/diagnostics', DiagnosticArray, self._on_diagnostics, reliable(DEPTH))
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin, name='client', daemon=True)
        self._thread.start()

    def listen(
        self,
        topic: str,
        kind: type,
        take: Callable[[Heard], None],
        quality: QoSProfile,
        raw: bool = False,
    ) -> None:
        """Subscribe to a topic.

        Args:
            topic: its full name.
            kind: class of its messages.
            take: called with every message, in the client's thread.
            quality: must fit what the publisher offers.
            raw: leave messages serialised.
        """

        def on_message(message: Any, info: Any) -> None:
            take(Heard(message, info['source_timestamp'], info['received_timestamp']))

        self._node.create_subscription(kind, topic, on_message, quality, raw=raw)

    def call(self, service: str, timeout: float = 60.0) -> tuple[bool, str]:
        """Call one of the node's ``Trigger`` services.

        Args:
            service: its name below the node's.
            timeout: seconds that the node has to answer.

        Returns:
            Success and message.

        Raises:
            InputError: the node does not answer in time.
        """
        if service not in self._clients:
            place = f'/{self._name}/{service}'
            self._clients[service] = self._node.create_client(Trigger, place)
        client = self._clients[service]
        self.wait(client.service_is_ready, f'the service {service}', timeout)
        future = client.call_async(Trigger.Request())
        self.wait(future.done, f'the answer of {service}', timeout)
        answer = future.result()
        return answer.success, answer.message

    def fresh_diagnostics(self, timeout: float = 30.0) -> dict[str, dict[str, Any]]:
        """Wait for the next diagnostics.

        Args:
            timeout: seconds that they may take.

        Returns:
            Values by the name of the node's part.

        Raises:
            InputError: none come in time.
        """
        seen = len(self.diagnostics)
        self.wait(lambda: len(self.diagnostics) > seen, 'diagnostics of the node', timeout)
        return self.diagnostics[-1]

    def wait(
        self,
        condition: Callable[[], bool],
        what: str,
        timeout: float,
        alive: Callable[[], bool] = lambda: True,
    ) -> None:
        """Wait for something.

        Args:
            condition: true once it has come.
            what: what it is, for the message.
            timeout: seconds that it may take.
            alive: false where it will never come.

        Raises:
            InputError: it does not come in time, or never will.
        """
        end = time.monotonic() + timeout
        while not condition():
            if not alive():
                raise InputError(f'waited for {what}, but the program has ended')
            if time.monotonic() > end:
                raise InputError(f'{what} did not come within {timeout:g} s')
            time.sleep(LOOK)

    def close(self) -> None:
        """Listen no more."""
        self._executor.shutdown()
        self._thread.join()
        self._node.destroy_node()

    def _spin(self) -> None:
        with suppress(ExternalShutdownException):
            self._executor.spin()

    def _on_stats(self, heard: Heard) -> None:
        stamp = heard.message.header.stamp
        own = {'stamp_ns': stamp.sec * NANOSECONDS + stamp.nanosec}
        self.stats.append(own | read_status(heard.message.status[0]))

    def _on_diagnostics(self, heard: Heard) -> None:
        parts: dict[str, dict[str, Any]] = {}
        for status in heard.message.status:
            name, _, part = status.name.partition(': ')
            if name.lstrip('/') == self._name:
                parts[part] = read_status(status)
        if parts:
            self.diagnostics.append(parts)


@contextmanager
def open_client(
    domain: int, name: str = 'incremental_mapper', local: bool = True
) -> Iterator[NodeClient]:
    """Listen to a node while the block runs.

    Args:
        domain: a ROS domain.
        name: the node's name.
        local: look at this machine only, whatever the environment says.

    Yields:
        The client, whose context and thread are its own.
    """
    if local:
        # The middleware reads this when the context is made.
        os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    context = Context()
    rclpy.init(
        args=[],
        context=context,
        domain_id=domain,
        signal_handler_options=SignalHandlerOptions.NO,
    )
    client = NodeClient(context, name)
    try:
        yield client
    finally:
        client.close()
        context.try_shutdown()
