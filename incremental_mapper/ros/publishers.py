"""Publishers: every window at once, map, path and graph when they are due and someone listens."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray
from nav_msgs.msg import Odometry, Path
from numpy.typing import NDArray
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from incremental_mapper.checks.finding import Finding
from incremental_mapper.config import Config
from incremental_mapper.mapping.following import PoseUpdate
from incremental_mapper.mapping.live_map import GraphView, PathView
from incremental_mapper.results.messages.finite_gate import FiniteGate
from incremental_mapper.results.messages.graph_markers import graph_markers, no_markers
from incremental_mapper.results.messages.result_messages import in_odom
from incremental_mapper.ros.datum_publisher import DatumPublisher
from incremental_mapper.ros.inbox import Inbox, View
from incremental_mapper.ros.parameters import NodeParameters
from incremental_mapper.ros.rclpy_types import MESSAGES
from incremental_mapper.ros.transforms import make_transforms
from incremental_mapper.ros.updates import ViewUpdate, WindowUpdate
from incremental_mapper.ros.view_pace import ViewPace

QUIET = PublisherEventCallbacks(use_default_callbacks=False)
"""A reader that asks for more than is offered is told so on its side; every event that the
executor waits for costs time with every message."""
WINDOW_DEPTH = 100
"""Messages of one window each that wait for a slow reader."""


def reliable(depth: int, latched: bool = False) -> QoSProfile:
    """Make the quality of a topic that is delivered reliably.

    Args:
        depth: messages that wait for a slow reader.
        latched: a late joiner gets the last ``depth`` messages.
    """
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


@dataclass(slots=True)
class _Shown:
    """A view's publisher, and how far what it published is behind."""

    publisher: Any
    published: int = 0
    asked: bool = False
    pace: ViewPace = field(default_factory=ViewPace)

    def delivered(self) -> bool:
        """Whether all reliable readers have what was published."""
        acknowledged: bool = self.publisher.wait_for_all_acked(Duration(seconds=0))
        return acknowledged


def node_name(node: Node) -> str:
    """The node's name in diagnostics: with its namespace where it has one."""
    full: str = node.get_fully_qualified_name()
    return full if node.get_namespace() != '/' else str(node.get_name())


class Outputs:
    """All publishers of results; used in the executor's thread only."""

    def __init__(self, node: Node, parameters: NodeParameters, inbox: Inbox) -> None:
        self._parameters = parameters
        self._frames = parameters.config.frames
        self._inbox = inbox
        self.transforms = make_transforms(node, parameters.config.tf, self._frames)
        self._datum = DatumPublisher(node, self._frames.map)
        self._node = node
        self._node_name = node_name(node)
        self._windows = 0  # counts changes of the map
        self._gate = FiniteGate(node.get_logger().error)

        def publish(kind: type, topic: str, qos: QoSProfile) -> Any:
            return node.create_publisher(kind, topic, qos, event_callbacks=QUIET)

        window, every_window = reliable(WINDOW_DEPTH), reliable(WINDOW_DEPTH, latched=True)
        self._odometry = publish(Odometry, '~/odometry', window)
        self._odom = publish(Odometry, '~/odom', window)
        self._poses = publish(PoseArray, '~/poses', window)
        self._increment = publish(PointCloud2, '~/map_increment', window)
        self._stats = publish(DiagnosticArray, '~/graph_stats', every_window)
        latched = reliable(1, latched=True)
        self._views = {
            View.MAP: _Shown(publish(PointCloud2, '~/map', latched)),
            View.PATH: _Shown(publish(Path, '~/path', latched)),
            View.GRAPH: _Shown(publish(MarkerArray, '~/graph', latched)),
        }

    def pose(self, update: PoseUpdate) -> None:
        """Publish what others steer by."""
        if not self._sound(update):
            return
        newest, frames = update.newest, self._frames
        self._odometry.publish(MESSAGES.odometry(newest, frames.map, frames.base))
        in_frame = in_odom(newest, update.odometry)
        self._odom.publish(MESSAGES.odometry(in_frame, frames.odom, frames.base))
        if self.transforms is not None:
            self.transforms.send(newest.stamp, newest.pose, update.odometry.pose)

    def window(self, update: WindowUpdate) -> None:
        """Publish what else belongs to one window."""
        result, newest = update.result, update.newest
        stamp = result.end if newest is None else newest.stamp
        frame = self._frames.map
        name = f'{self._node_name}: graph'
        self._stats.publish(MESSAGES.stats(stamp, result.row, update.stats, name))
        self._datum.take(update.stats, stamp)
        if newest is None:
            return
        self._windows += 1
        if self._gate.passes('~/poses', poses=[pose.matrix() for pose in result.poses]):
            self._poses.publish(MESSAGES.pose_array(stamp, result.poses, frame))
        wanted = self._increment.get_subscription_count() > 0
        if wanted and self._gate.passes('~/map_increment', points=update.points):
            self._increment.publish(MESSAGES.cloud(stamp, update.points, frame))

    def _sound(self, update: PoseUpdate) -> bool:
        """Whether the newest state may be published."""
        return self._gate.passes('~/odometry, ~/odom and TF', **update.numbers)

    def sensors(self, places: Mapping[str, NDArray[np.float64]]) -> None:
        """Tell where the sensors are, T_base_sensor (4, 4) by frame_id."""
        if self.transforms is not None:
            self.transforms.sensors(self._node.get_clock().now().nanoseconds, places)

    def shared_frames(self) -> tuple[Finding, ...]:
        """Frames of this node that others tell of, too; to be asked once in a while."""
        if self.transforms is None:
            return ()
        self.transforms.shared.look(self._node)
        return self.transforms.shared.findings()

    def view(self, update: ViewUpdate) -> None:
        """Publish a view that was asked for."""
        shown = self._views[update.view]
        shown.asked = False
        begin = time.monotonic()
        frame, content = self._frames.map, update.content
        if isinstance(content, PathView):
            numbers: dict[str, Any] = {'poses': content.poses}
        elif isinstance(content, GraphView):
            numbers = {'poses': content.poses, 'priors': content.priors, **content.edges}
        else:
            numbers = {'points': content}
        if not self._gate.passes(f'~/{update.view}', **numbers):
            return
        if isinstance(content, PathView):
            message = MESSAGES.path(update.stamp, content, frame)
        elif isinstance(content, GraphView):
            message = graph_markers(MESSAGES, content, frame)
        else:
            message = MESSAGES.cloud(update.stamp, content, frame)
        shown.publisher.publish(message)
        shown.pace.cost = update.seconds + time.monotonic() - begin

    def clear(self) -> None:
        """Take back what late joiners would get of a map that is no more."""
        self._windows += 1
        self._datum.restart()
        empty = np.zeros((0, 3), dtype=np.float32)
        frame = self._frames.map
        for view, message in (
            (View.MAP, MESSAGES.cloud(0, empty, frame)),
            (View.PATH, MESSAGES.path(0, PathView([], []), frame)),
            (View.GRAPH, no_markers(MESSAGES, frame)),
        ):
            self._views[view].publisher.publish(message)
            self._views[view].published = self._windows
            # Where the mapper failed over a view, no answer will come.
            self._views[view].asked = False

    def tick(self) -> None:
        """Ask for the views that have changed, are due, and that someone listens to.

        Nothing is made for nobody: who joins later is served by the next tick.
        """
        now = time.monotonic()
        for view, shown in self._views.items():
            stale = shown.published < self._windows and not shown.asked
            wanted = stale and shown.publisher.get_subscription_count() > 0
            if wanted and shown.pace.due(now, self._period(view), shown.delivered):
                shown.asked, shown.published, shown.pace.last = True, self._windows, now
                self._inbox.request(view)

    def _period(self, view: View) -> float:
        config: Config = self._parameters.config
        return {
            View.MAP: config.map.publish_period,
            View.PATH: config.path.publish_period,
            View.GRAPH: config.graph.markers_period,
        }[view]
