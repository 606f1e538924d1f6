"""A subscriber that collects serialised messages, and a DDS domain of its own for a test."""

import threading
import time

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from ros_helpers import next_domain


def own_domain(monkeypatch):
    """Separate what starts after this, child processes too, from all other ROS programs."""
    monkeypatch.setenv('ROS_DOMAIN_ID', str(next_domain()))
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')


class Listener:
    """Subscribes to ``topics`` (name to message class) and keeps what comes, by topic."""

    def __init__(self, topics, latched=False):
        self.got = {name: [] for name in topics}
        self._context = Context()
        rclpy.init(args=[], context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node('listener', context=self._context)
        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        quality = QoSProfile(depth=20_000, durability=durability)
        for name, message_class in topics.items():
            self._node.create_subscription(
                message_class, name, self.got[name].append, quality, raw=True
            )
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._spin)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *error):
        self._stop.set()
        self._thread.join()
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()

    def _spin(self):
        while not self._stop.is_set():
            self._executor.spin_once(timeout_sec=0.05)

    @property
    def counts(self):
        return {name: len(messages) for name, messages in self.got.items()}

    def wait_for(self, counts, seconds=20.0):
        """Wait until at least that many have come on every topic of ``counts``."""
        end = time.monotonic() + seconds
        while any(len(self.got[name]) < count for name, count in counts.items()):
            assert time.monotonic() < end, f'{self.counts} of {counts} messages'
            time.sleep(0.01)

    def wait_for_rest(self, seconds=20.0):
        """Wait until nothing has come for a second; returns the counts then."""
        end = time.monotonic() + seconds
        while True:
            before = self.counts
            time.sleep(1.0)
            if self.counts == before:
                return before
            assert time.monotonic() < end, f'still messages: {before}, {self.counts}'
