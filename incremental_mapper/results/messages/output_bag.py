"""The outputs of a run as a bag: the node's topics, so that it is looked at like a live one.

Messages are logged at their header stamps. Views that the node makes anew all the time (map and
path) come the more seldom the longer the drive is, so that the bag grows no faster than the map.
"""

import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer, WriterError

from incremental_mapper.config import Config, TfMode
from incremental_mapper.errors import OutputError
from incremental_mapper.graph.factors import pose_numbers
from incremental_mapper.map.ply import MapCloud
from incremental_mapper.mapping.following import Follower, PoseUpdate
from incremental_mapper.mapping.live_map import PathView
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.mapping.result import MapResult, WindowResult
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.results.messages.finite_gate import FiniteGate
from incremental_mapper.results.messages.graph_markers import graph_markers
from incremental_mapper.results.messages.message_types import BagTypes
from incremental_mapper.results.messages.result_messages import ResultMessages, in_odom
from incremental_mapper.trajectory import Trajectory

FOLDER = 'run_bag'
"""Name of the bag beside the other files of a run."""
NODE = 'incremental_mapper'
MARK = 'written_by'
"""Key in the bag's metadata that tells it from the recordings of others."""
PATH_SHARE = 0.02
"""A new path comes once the drive has grown by this share."""
MAP_GROWTH = 1.25
"""A new map comes once there are so many times as many points."""
TYPES = {
    'odometry': 'nav_msgs/msg/Odometry',
    'odom': 'nav_msgs/msg/Odometry',
    'poses': 'geometry_msgs/msg/PoseArray',
    'path': 'nav_msgs/msg/Path',
    'map': 'sensor_msgs/msg/PointCloud2',
    'map_increment': 'sensor_msgs/msg/PointCloud2',
    'graph': 'visualization_msgs/msg/MarkerArray',
    'graph_stats': 'diagnostic_msgs/msg/DiagnosticArray',
    'datum': 'sensor_msgs/msg/NavSatFix',
}
"""Topics in the node's namespace, with their types."""
LATCHED = {'path', 'map', 'graph', 'datum'}
"""Of these a late joiner gets the newest message."""
DEPTH = 100


class OutputBag:
    """Takes the windows of one run; see ``RunWatcher``."""

    def __init__(self, folder: Path, config: Config) -> None:
        """Begin the bag.

        Args:
            folder: Where it is written; it does not exist.
            config: The settings of the run.

        Raises:
            OutputError: The bag cannot be made.
        """
        self.trouble = ''
        self._place = folder
        self._config, self._frames = config, config.frames
        self._types = BagTypes()
        self._messages = ResultMessages(self._types)
        self._writer = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
        self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self._writer.set_custom_data(MARK, NODE)
        self._follower: Follower | None = None
        self._gate = FiniteGate(self._tell)
        self._datum: list[float] | None = None
        self._first: int | None = None
        self._last_path = self._last_graph = self._newest = 0
        self._points = self._map_points = 0
        try:
            self._writer.open()
            self._topics = {
                name: self._add(f'/{NODE}/{name}', kind) for name, kind in TYPES.items()
            }
            self._tf = self._add('/tf', 'tf2_msgs/msg/TFMessage')
        except (OSError, WriterError) as error:
            raise OutputError(f'{folder}: cannot be written ({error})') from error

    def window(self, mapper: Mapper, result: WindowResult) -> None:
        """Write the messages of a window; see ``RunWatcher``."""
        if self._follower is None:
            self._follower = Follower(mapper)
        follower = self._follower
        update = follower.pose(result)
        scans = follower.new_scans()
        if self.trouble:
            return
        stats = mapper.stats()
        try:
            stamp = result.end if update is None else update.newest.stamp
            status = self._messages.stats(stamp, result.row, stats, f'{NODE}: graph')
            self._write('graph_stats', stamp, status)
            self._write_datum(stats, stamp)
            if update is None:
                return
            self._write_pose(update)
            self._write_poses(result, stamp)
            points = follower.live.placed(scans)
            self._points += len(points)
            self._write_cloud('map_increment', stamp, points)
            self._write_views(follower, stamp)
        except OSError as error:
            self._fail(error)

    def finish(self, result: MapResult, cloud: MapCloud) -> None:
        """Write the whole trajectory and the map as they are saved; see ``RunWatcher``."""
        if self.trouble:
            return
        stamp = max(self._newest, int(result.trajectory.stamps[-1]))
        frame = self._frames.map
        try:
            path = whole_path(result.trajectory)
            self._write('path', stamp, self._messages.path(stamp, path, frame))
            self._write_cloud('map', stamp, cloud.points)
        except OSError as error:
            self._fail(error)

    def close(self, place: Path) -> None:
        """End the bag.

        Args:
            place: Where it is moved to, unless there was trouble.
        """
        try:
            self._writer.close()
            if not self.trouble:
                self._place.rename(place)
        except OSError as error:
            self._fail(error)

    def _write_pose(self, update: PoseUpdate) -> None:
        newest, odometry, frames = update.newest, update.odometry, self._frames
        if not self._gate.passes('/odometry', **update.numbers):
            return
        messages, stamp = self._messages, newest.stamp
        self._write('odometry', stamp, messages.odometry(newest, frames.map, frames.base))
        in_frame = in_odom(newest, odometry)
        self._write('odom', stamp, messages.odometry(in_frame, frames.odom, frames.base))
        if self._config.tf.publish is TfMode.NONE:
            return
        transforms = [
            messages.transform(stamp, frames.map, frames.odom, odometry.T_map_odom),
            messages.transform(stamp, frames.odom, frames.base, odometry.pose),
        ]
        message = self._types.make('tf2_msgs/msg/TFMessage', transforms=transforms)
        self._log(self._tf, stamp, message)

    def _write_poses(self, result: WindowResult, stamp: int) -> None:
        numbers = [pose_numbers(pose) for pose in result.poses]
        if self._gate.passes('/poses', poses=numbers):
            message = self._messages.pose_array(stamp, result.poses, self._frames.map)
            self._write('poses', stamp, message)

    def _write_datum(self, stats: Mapping[str, Any], stamp: int) -> None:
        datum: list[float] | None = stats['datum'] if stats['georeferenced'] else None
        if datum is not None and datum != self._datum:
            self._datum = datum
            self._write('datum', stamp, self._messages.datum(datum, stamp, self._frames.map))

    def _write_views(self, follower: Follower, stamp: int) -> None:
        config, frame = self._config, self._frames.map
        if self._first is None:
            self._first = stamp
        driven = stamp - self._first
        path_period = max(config.path.publish_period * NANOSECONDS, PATH_SHARE * driven)
        if stamp - self._last_path >= path_period:
            self._last_path = stamp
            path = follower.live.path()
            if self._gate.passes('/path', poses=path.poses):
                self._write('path', stamp, self._messages.path(stamp, path, frame))
        if stamp - self._last_graph >= config.graph.markers_period * NANOSECONDS:
            self._last_graph = stamp
            view = follower.live.graph(config.graph.markers_span)
            numbers = {'poses': view.poses, 'priors': view.priors, **view.edges}
            if self._gate.passes('/graph', **numbers):
                self._write('graph', stamp, graph_markers(self._messages, view, frame))
        if self._points >= MAP_GROWTH * self._map_points:
            self._map_points = self._points
            self._write_cloud('map', stamp, follower.live.points())

    def _write_cloud(self, topic: str, stamp: int, points: Any) -> None:
        if self._gate.passes(f'/{topic}', points=points):
            self._write(topic, stamp, self._messages.cloud(stamp, points, self._frames.map))

    def _write(self, topic: str, stamp: int, message: Any) -> None:
        self._log(self._topics[topic], stamp, message)

    def _log(self, connection: Any, stamp: int, message: Any) -> None:
        self._newest = max(self._newest, stamp)
        data = self._types.store.serialize_cdr(message, connection.msgtype)
        self._writer.write(connection, stamp, data)

    def _add(self, topic: str, kind: str) -> Any:
        latched = topic.rpartition('/')[2] in LATCHED
        return self._writer.add_connection(
            topic, kind, typestore=self._types.store, offered_qos_profiles=[_quality(latched)]
        )

    def _fail(self, error: OSError) -> None:
        self._tell(f'cannot be written ({error.strerror or error})')

    def _tell(self, text: str) -> None:
        self.trouble = self.trouble or f'no {FOLDER}: {text}'


def whole_path(trajectory: Trajectory) -> PathView:
    """A trajectory T_map_base with all its poses."""
    numbers = [
        [*position, *turn]
        for position, turn in zip(
            trajectory.positions.tolist(), trajectory.quaternions.tolist(), strict=True
        )
    ]
    return PathView(trajectory.stamps.tolist(), numbers)


@contextmanager
def output_bag(folder: Path, config: Config) -> Iterator[OutputBag]:
    """Write the outputs of a run as ``run_bag``; where the block raises, nothing is left.

    Args:
        folder: The folder of the run.
        config: Its settings.

    Yields:
        What is to be told of the run. Where it has met trouble, no bag is left either.

    Raises:
        OutputError: The bag cannot be made.
    """
    beside = folder / f'.{FOLDER}.partial'
    if (folder / FOLDER).exists():
        raise OutputError(f'{folder / FOLDER}: is no bag of this program; move it away')
    shutil.rmtree(beside, ignore_errors=True)
    try:
        # The file inside is called as its folder is.
        bag = OutputBag(beside / FOLDER, config)
        yield bag
        bag.close(folder / FOLDER)
    finally:
        shutil.rmtree(beside, ignore_errors=True)


def remove_bag(folder: Path) -> None:
    """Remove the bag of an earlier run; one that is not of this program stays.

    Args:
        folder: The folder of the run.

    Raises:
        OSError: It cannot be removed.
    """
    metadata = folder / FOLDER / 'metadata.yaml'
    if metadata.is_file() and MARK in metadata.read_text(encoding='utf-8', errors='replace'):
        shutil.rmtree(folder / FOLDER)


def _quality(latched: bool) -> Qos:
    durability = QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE
    unlimited = QosTime(2**31 - 1, 2**32 - 1)
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=1 if latched else DEPTH,
        reliability=QosReliability.RELIABLE,
        durability=durability,
        deadline=unlimited,
        lifespan=unlimited,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=unlimited,
        avoid_ros_namespace_conventions=False,
    )
