"""A node under test and a client that talks to it: real DDS, one process, a domain of its own."""

import contextlib
import json
import os
import threading
import time
from collections import Counter, defaultdict, deque
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray
from nav_msgs.msg import Odometry, Path
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import Imu, NavSatFix, PointCloud2
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import MarkerArray

from incremental_mapper.datasets.bag_settings import SETTINGS_FILE
from incremental_mapper.datasets.open import open_source
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.results.graph_json import compare_graphs, graph_tree
from incremental_mapper.results.messages.result_messages import read_status
from incremental_mapper.results.offline_run import map_source
from incremental_mapper.results.opened_drive import effective_config
from incremental_mapper.ros.node import MapperNode
from incremental_mapper.ros.programs import free_domain
from incremental_mapper.settings import merge, read_yaml

os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'

INPUTS = {
    '/points_left': PointCloud2,
    '/points_right': PointCloud2,
    '/imu': Imu,
    '/fix': NavSatFix,
}
OUTPUTS = {
    'odometry': Odometry,
    'odom': Odometry,
    'datum': NavSatFix,
    'poses': PoseArray,
    'path': Path,
    'map': PointCloud2,
    'map_increment': PointCloud2,
    'graph': MarkerArray,
    'graph_stats': DiagnosticArray,
}
LATCHED = ('map', 'path', 'graph', 'graph_stats', 'datum')
QUICK = {
    'mom': {'max_points': 100},
    'map': {'publish_period': 0.1},
    'path': {'publish_period': 0.1},
    'graph': {'markers_period': 0.1},
    'diagnostics': {'period': 0.2},
    'queue': {'max_delay': 0.0},
}
"""Few judging points, views as soon as they change, and no scan left out on a slow machine."""
_used_domains = deque(maxlen=40)


@dataclass(frozen=True)
class Recorded:
    """One message: when it was logged (ns), its topic, and itself, perhaps serialized."""

    logged: int
    topic: str
    content: Any

    def message(self):
        return deserialize_message(self.content, INPUTS[self.topic])

    def changed(self, change):
        """With ``change`` of the message in place of it."""
        return replace(self, content=change(self.message()))


def next_domain():
    """A domain that nobody on this machine uses, and no test of late.

    There are a hundred, and more tests than that may run in one process.
    """
    domain = free_domain(_used_domains)
    _used_domains.append(domain)
    return domain


def read_inputs(bag):
    """The sensors' messages of a bag in the order in which they were logged."""
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        return [
            Recorded(logged, connection.topic, bytes(data))
            for connection, logged, data in reader.messages()
            if connection.topic in INPUTS
        ]


def stamp_of(message):
    return message.header.stamp.sec * NANOSECONDS + message.header.stamp.nanosec


def restamp(message, nanoseconds):
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(nanoseconds, NANOSECONDS)
    return message


def decode_cloud(message):
    """Points (N, 3) of a cloud that the node published, whether it has intensities or not."""
    names = [field.name for field in message.fields]
    assert names[:3] == ['x', 'y', 'z'] and names[3:] in ([], ['intensity'])
    assert message.point_step == 4 * len(names)
    assert len(message.data) == message.point_step * message.width
    return np.frombuffer(message.data, dtype='<f4').reshape(-1, len(names))[:, :3]


class Spinner:
    """An executor that spins in a thread."""

    def __init__(self, context, node):
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(node)
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _spin(self):
        with contextlib.suppress(ExternalShutdownException):
            self._executor.spin()

    def close(self):
        self._executor.shutdown()
        self._thread.join(5.0)
        assert not self._thread.is_alive()


class NodeSession:
    """A mapper node in a thread, and a client with publishers and readers of everything."""

    def __init__(self, tmp_path, tree, arguments=(), listen=True):
        self.context = Context()
        rclpy.init(
            context=self.context,
            domain_id=next_domain(),
            signal_handler_options=SignalHandlerOptions.NO,
        )
        path = tmp_path / f'parameters_{id(self)}.yaml'
        path.write_text(yaml.safe_dump({'/**': {'ros__parameters': tree}}))
        self._stop = threading.Event()
        try:
            self.mapper = MapperNode(
                context=self.context,
                cli_args=['--ros-args', '--params-file', str(path), *arguments],
            )
        except BaseException:
            rclpy.try_shutdown(context=self.context)
            raise
        self.failure = None
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()
        self.received = defaultdict(list)
        self.client = Node('client', context=self.context)
        self._publishers = {}
        self.sent = Counter()
        for name in OUTPUTS if listen else ():
            self.listen(f'/incremental_mapper/{name}', *self.of(name))
        self.listen('/diagnostics', DiagnosticArray, 'diagnostics', latched=False)
        self._services = {
            name: self.client.create_client(kind, f'/incremental_mapper/{name}')
            for name, kind in [
                ('flush', Trigger),
                ('reset', Trigger),
                ('save_map', Trigger),
                ('pause', SetBool),
            ]
        }
        self._client_spinner = Spinner(self.context, self.client)

    def _spin(self):
        try:
            self.mapper.spin(self._stop.is_set)
        except BaseException as error:
            self.failure = error

    def listen(self, topic, kind, name, latched=None):
        """Collect a topic's messages under ``received[name]``."""
        latched = name in LATCHED if latched is None else latched
        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        qos = QoSProfile(depth=200, reliability=ReliabilityPolicy.RELIABLE, durability=durability)
        self.client.create_subscription(kind, topic, self.received[name].append, qos)

    @staticmethod
    def of(name):
        """Type and name of one of the node's outputs, for ``listen``."""
        return OUTPUTS[name], name

    def publisher(self, topic, kind, reliable=True):
        """A publisher that the node has found."""
        if topic not in self._publishers:
            reliability = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
            qos = QoSProfile(depth=1000, reliability=reliability)
            self._publishers[topic] = self.client.create_publisher(kind, topic, qos)
        found = self._publishers[topic]
        self.wait(lambda: found.get_subscription_count() > 0, 'the node listens')
        return found

    def play(self, messages, rate=2.0, reliable=True):
        """Publish recorded or changed messages with the timing of their log."""
        messages = list(messages)
        for topic in sorted({item.topic for item in messages}):
            self.publisher(topic, INPUTS[topic], reliable)
        self.refine()
        begin = time.monotonic()
        for item in messages:
            due = begin + (item.logged - messages[0].logged) / NANOSECONDS / rate
            time.sleep(max(due - time.monotonic(), 0.0))
            self._publishers[item.topic].publish(item.content)
            self.sent[item.topic] += 1

    def refine(self, seconds=0.3):
        """Give discovery the other way round, or messages under way, the time they need."""
        time.sleep(seconds)

    def wait(self, condition, what, timeout=30.0):
        end = time.monotonic() + timeout
        while not condition():
            assert self.failure is None, self.failure
            assert time.monotonic() < end, f'timed out: {what}'
            time.sleep(0.01)

    def call(self, name, data=None):
        """Call a service of the node; returns success and message."""
        client = self._services[name]
        assert client.wait_for_service(5.0)
        request = Trigger.Request() if data is None else SetBool.Request(data=data)
        future = client.call_async(request)
        self.wait(future.done, f'answer of {name}', 60.0)
        answer = future.result()
        return answer.success, answer.message

    def arrived(self):
        """Messages that reached the node, by topic."""
        found = self.diagnostics().values()
        return {item['topic']: item['received'] for item in found if 'topic' in item}

    def finish(self, lossless=True):
        """Close all windows and wait for what they publish; returns the newest statistics."""
        if lossless:
            self.wait(lambda: self.sent.items() <= self.arrived().items(), 'all messages')
        success, message = self.call('flush')
        assert success, message
        self.refine()
        return self.stats()[-1] if self.received['graph_stats'] else {}

    def stats(self):
        return [read_status(message.status[0]) for message in self.received['graph_stats']]

    def diagnostics(self):
        """The newest diagnostics that came after this call: values by the last word of the name."""
        seen = len(self.received['diagnostics'])
        self.wait(lambda: len(self.received['diagnostics']) > seen, 'diagnostics')
        newest = self.received['diagnostics'][-1]
        return {item.name.split(': ')[-1]: read_status(item) for item in newest.status}

    def dropped(self, sensor):
        return self.diagnostics()[sensor]['dropped']

    def stop(self):
        """Ask the node to stop and wait until it has."""
        self._stop.set()
        self._thread.join(20.0)
        assert not self._thread.is_alive()
        assert self.failure is None, self.failure

    def close(self):
        try:
            self.stop()
        finally:
            self._client_spinner.close()
            self.client.destroy_node()
            rclpy.try_shutdown(context=self.context)


def map_offline(bag, tree):
    """What the core makes of the bag under a settings tree."""
    source = open_source(bag, tree)
    return map_source(source, effective_config(source, tree, 'test'))


def assert_same_graph(folder, run):
    """A folder that the node saved holds the graph of an offline run."""
    result = run.result
    graph = graph_tree(result.clusters, result.factors, result.values)
    # Tuples become lists as in the file.
    found = compare_graphs(FinishedRun(folder).graph, json.loads(json.dumps(graph)))
    assert found.differences == (), found


def bag_parameters(bag, *more: dict[str, Any]):
    """The settings that go with a bag, with ``QUICK`` and more laid over them."""
    tree = merge(read_yaml(bag / SETTINGS_FILE), QUICK)
    for extra in more:
        tree = merge(tree, extra)
    return tree
