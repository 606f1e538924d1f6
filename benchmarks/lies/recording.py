"""A short simulated drive as messages and settings, and ways to change and to write them."""

import shutil
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_typestore

from incremental_mapper.cli.convert import convert
from incremental_mapper.config import Tree
from incremental_mapper.datasets.bag_settings import SETTINGS_FILE
from incremental_mapper.datasets.simulated.folder import simulate
from incremental_mapper.datasets.simulated.options import (
    MotionKind,
    SceneKind,
    SimulationOptions,
)
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.settings import merge, read_yaml, write_ros_yaml

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES: dict[str, Any] = STORE.types
ROS1_STORE = get_typestore(Stores.ROS1_NOETIC)

LEFT, RIGHT, IMU, FIX, TRUTH = (
    '/points_left',
    '/points_right',
    '/imu',
    '/fix',
    '/ground_truth/odometry',
)
LIDARS = (LEFT, RIGHT)
TURN = 0.1
"""Seconds that a LiDAR's head needs for a turn."""

Item: TypeAlias = tuple[int, str, Any]
"""Record time in nanoseconds, topic, message."""
Change: TypeAlias = Callable[[Any], Any]


@dataclass(frozen=True)
class Recording:
    """Messages in the order in which they were recorded, and the settings that lie beside them.

    ``folder`` is the KAIST folder that they were converted from.
    """

    items: tuple[Item, ...]
    settings: Tree
    folder: Path

    @property
    def start(self) -> int:
        """Record time of the first message, nanoseconds."""
        return self.items[0][0]

    @property
    def end(self) -> int:
        """Record time of the last message, nanoseconds."""
        return self.items[-1][0]

    def of(self, topic: str) -> list[Any]:
        """The messages of a topic."""
        return [message for _, name, message in self.items if name == topic]

    def each(self, topics: str | Iterable[str], change: Change) -> 'Recording':
        """With ``change`` of every message of some topics in its place; None leaves it out."""
        wanted = {topics} if isinstance(topics, str) else {*topics}
        changed = (
            (logged, topic, change(message) if topic in wanted else message)
            for logged, topic, message in self.items
        )
        return self.with_items(item for item in changed if item[2] is not None)

    def shifted(self, topics: str | Iterable[str], seconds: float) -> 'Recording':
        """With the header stamps of some topics later; record times stay."""
        shift = round(seconds * NANOSECONDS)
        return self.each(topics, lambda message: restamped(message, stamp_of(message) + shift))

    def with_items(self, items: Iterable[Item]) -> 'Recording':
        """The same with other messages, put in order of their record times."""
        return replace(self, items=tuple(sorted(items, key=lambda item: item[0])))

    def plus(self, items: Iterable[Item]) -> 'Recording':
        """The same with further messages."""
        return self.with_items([*self.items, *items])

    def renamed(self, old: str, new: str) -> 'Recording':
        """The same with a topic under another name; the settings stay."""
        items = tuple((t, new if name == old else name, m) for t, name, m in self.items)
        return replace(self, items=items)

    def with_settings(self, tree: Tree) -> 'Recording':
        """The same with some settings laid over its own."""
        return replace(self, settings=merge(self.settings, tree))

    def bare(self) -> 'Recording':
        """The same without any settings beside it."""
        return replace(self, settings={})

    def framed(self) -> 'Recording':
        """Without settings, and with the extrinsics in ``/tf_static`` instead."""
        first = self.items[0][2].header
        poses = {**self.settings['lidars'], **self.settings}
        frames = {
            frame_of(self, topic): poses[name]['T_base_sensor']
            for name, topic in (('left', LEFT), ('right', RIGHT), ('imu', IMU), ('gnss', FIX))
        }
        static = TYPES['tf2_msgs/msg/TFMessage'](
            transforms=[transform(first.stamp, child, pose) for child, pose in frames.items()]
        )
        return self.bare().plus([(self.start - 1, '/tf_static', static)])

    def write(
        self,
        folder: Path,
        plugin: StoragePlugin = StoragePlugin.MCAP,
        mode: CompressionMode | None = None,
    ) -> Path:
        """Write a rosbag2 with its settings; returns ``folder``."""
        writer = Ros2Writer(folder, version=9, storage_plugin=plugin)
        if mode is not None:
            writer.set_compression(mode, CompressionFormat.ZSTD)
        connections: dict[str, Any] = {}
        with writer:
            for logged, topic, message in self.items:
                kind = message.__msgtype__
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
                data = STORE.serialize_cdr(message, kind)
                writer.write(connections[topic], logged, data)
        self.write_settings(folder)
        return folder

    def write_ros1(self, path: Path) -> Path:
        """Write a ROS 1 bag, without settings; returns ``path``."""
        path.parent.mkdir(parents=True, exist_ok=True)
        connections: dict[str, Any] = {}
        with Ros1Writer(path) as writer:
            for number, (logged, topic, message) in enumerate(self.items):
                kind = message.__msgtype__
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=ROS1_STORE)
                older = _with_seq(message, number)
                data = ROS1_STORE.serialize_ros1(older, kind)
                writer.write(connections[topic], logged, data)
        return path

    def write_settings(self, folder: Path) -> None:
        """Write the settings into a bag's folder, where there are any."""
        if self.settings:
            write_ros_yaml(folder / SETTINGS_FILE, self.settings)


def _with_seq(message: Any, number: int) -> Any:
    """A message with the header of ROS 1."""
    header = ROS1_STORE.types['std_msgs/msg/Header'](
        seq=number, stamp=message.header.stamp, frame_id=message.header.frame_id
    )
    return replace(message, header=header)


def stamp_of(message: Any) -> int:
    """Header stamp, nanoseconds."""
    return int(message.header.stamp.sec) * NANOSECONDS + int(message.header.stamp.nanosec)


def restamped(message: Any, nanoseconds: int) -> Any:
    """A message with another header stamp."""
    seconds, rest = divmod(int(nanoseconds), NANOSECONDS)
    stamp = replace(message.header.stamp, sec=seconds, nanosec=rest)
    return replace(message, header=replace(message.header, stamp=stamp))


def reframed(message: Any, frame: str) -> Any:
    """A message with another frame_id."""
    return replace(message, header=replace(message.header, frame_id=frame))


def frame_of(recording: Recording, topic: str) -> str:
    """The frame_id of a topic's first message."""
    return str(recording.of(topic)[0].header.frame_id)


def vector(xyz: Iterable[float]) -> Any:
    """A ``geometry_msgs/Vector3``."""
    x, y, z = (float(value) for value in xyz)
    return TYPES['geometry_msgs/msg/Vector3'](x=x, y=y, z=z)


def numbers(value: Any) -> NDArray[np.float64]:
    """The three numbers of a ``geometry_msgs/Vector3``."""
    return np.array([value.x, value.y, value.z])


def matrix_of(pose: Iterable[float]) -> NDArray[np.float64]:
    """A row-major 3x4 setting as a matrix (4, 4)."""
    matrix = np.eye(4)
    matrix[:3] = np.reshape(list(pose), (3, 4))
    return matrix


def setting_of(matrix: NDArray[np.float64]) -> list[float]:
    """A matrix (4, 4) as a row-major 3x4 setting."""
    return [float(value) for value in matrix[:3].ravel()]


def transform(stamp: Any, child: str, pose: Iterable[float], parent: str = 'base_link') -> Any:
    """A ``geometry_msgs/TransformStamped`` of a row-major 3x4 pose."""
    from scipy.spatial.transform import Rotation

    matrix = matrix_of(pose)
    x, y, z, w = Rotation.from_matrix(matrix[:3, :3]).as_quat()
    return TYPES['geometry_msgs/msg/TransformStamped'](
        header=TYPES['std_msgs/msg/Header'](stamp=stamp, frame_id=parent),
        child_frame_id=child,
        transform=TYPES['geometry_msgs/msg/Transform'](
            translation=vector(matrix[:3, 3]),
            rotation=TYPES['geometry_msgs/msg/Quaternion'](x=x, y=y, z=z, w=w),
        ),
    )


_CODES = {'i1': 1, 'u1': 2, 'i2': 3, 'u2': 4, 'i4': 5, 'u4': 6, 'f4': 7, 'f8': 8}


def points_of(cloud: Any) -> NDArray[np.float32]:
    """x, y, z (N, 3) of an unharmed cloud."""
    data = np.frombuffer(bytes(cloud.data), dtype='<f4')
    return data.reshape(-1, int(cloud.point_step) // 4)[:, :3]


def table(points: NDArray[Any], code: str = '<f4', **columns: tuple[str, Any]) -> NDArray[np.void]:
    """Points (N, 3) and further columns, each a type and its values, as a structured array."""
    kinds = [(name, code) for name in 'xyz'] + [(name, kind) for name, (kind, _) in columns.items()]
    made = np.zeros(len(points), dtype=kinds)
    for number, name in enumerate('xyz'):
        made[name] = points[:, number]
    for name, (_, values) in columns.items():
        made[name] = values
    return made


def cloud_of(cloud: Any, rows: NDArray[np.void], **changes: Any) -> Any:
    """A cloud whose data are a structured array; ``changes`` are what it says wrongly of them."""
    assert rows.dtype.names is not None and rows.dtype.fields is not None
    fields = [
        TYPES['sensor_msgs/msg/PointField'](
            name=name,
            offset=int(rows.dtype.fields[name][1]),
            datatype=_CODES[rows.dtype[name].str[1:]],
            count=1,
        )
        for name in rows.dtype.names
    ]
    step = rows.dtype.itemsize
    said = {
        'height': 1,
        'width': len(rows),
        'fields': fields,
        'is_bigendian': False,
        'point_step': step,
        'row_step': len(rows) * step,
        'data': np.frombuffer(rows.tobytes(), dtype=np.uint8),
        'is_dense': True,
    }
    return replace(cloud, **{**said, **changes})


def times_of(points: NDArray[np.float32]) -> NDArray[np.float64]:
    """When each point of a sweep was measured, seconds (N,) before its end, none above zero.

    The head turns clockwise, and the stamp of a simulated sweep is that of its last point.
    """
    azimuth = np.arctan2(points[:, 1], points[:, 0]).astype(np.float64)
    # The last column may stand a hair behind the last point, which is not a turn ago.
    ahead = np.mod(azimuth - azimuth[-1] + 1e-3, 2.0 * np.pi) - 1e-3
    times: NDArray[np.float64] = -np.maximum(ahead, 0.0) / (2.0 * np.pi) * TURN
    return times


@dataclass(frozen=True)
class DriveKind:
    """How a drive is simulated, whether its points have times, how long it is, and where.

    ``place`` are degrees of latitude and longitude of its first fix.
    """

    scene: SceneKind
    motion: MotionKind
    timed: bool = False
    fixes: int = 1
    seconds: float = 5.0
    place: tuple[float, float] | None = None


DRIVES = {
    'street': DriveKind(SceneKind.STREET, MotionKind.CONST),
    'curve': DriveKind(SceneKind.CURVE, MotionKind.CONST),
    'start': DriveKind(SceneKind.STREET, MotionKind.ACCEL),
    'timed': DriveKind(SceneKind.CURVE, MotionKind.CONST, timed=True),
    'fixes': DriveKind(SceneKind.STREET, MotionKind.CONST, fixes=5),
    'turns': DriveKind(SceneKind.CURVE, MotionKind.MIXED, seconds=25.0),
    'europe': DriveKind(SceneKind.CURVE, MotionKind.MIXED, seconds=25.0, place=(48.1, 11.6)),
}
"""The unharmed drives: what each lie is told of."""


def make_drive(kind: DriveKind, folder: Path, every: int = 8, seed: int = 11) -> Recording:
    """Simulate a drive and read it; of its points one in ``every`` is kept.

    Args:
        kind: Which one.
        folder: Where its KAIST folder and the bag made of it are, or are to be.
        every: How much its clouds are thinned, at random, for the points of a column come in turn.
        seed: Of the simulation and the thinning.
    """
    kaist, bag = folder / 'kaist', folder / 'bag'
    if not bag.is_dir():
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        simulate(kaist, SimulationOptions(kind.scene, kind.motion, kind.seconds, seed=seed))
        rng = np.random.default_rng(seed)
        for path in sorted((kaist / 'sensor_data').glob('VLP_*/*.bin')):
            points = np.fromfile(path, dtype='<f4').reshape(-1, 4)
            points[rng.random(len(points)) < 1.0 / every].tofile(path)
        convert(kaist, bag)
    made = Recording(tuple(read_items(bag)), read_yaml(bag / SETTINGS_FILE), kaist)
    made = made.each(LIDARS, _timed if kind.timed else _plain)
    if kind.place is not None:
        made = _placed(made, *kind.place)
    return made if kind.fixes == 1 else _with_fixes(made, kind.fixes)


def read_items(bag: Path) -> Iterator[Item]:
    """Everything in a bag."""
    with AnyReader([bag], default_typestore=STORE) as reader:
        for connection, logged, data in reader.messages():
            yield logged, connection.topic, reader.deserialize(data, connection.msgtype)


def _plain(cloud: Any) -> Any:
    return cloud_of(cloud, table(points_of(cloud)))


def _timed(cloud: Any) -> Any:
    points = points_of(cloud)
    return cloud_of(cloud, table(points, time=('<f4', times_of(points))))


def _placed(recording: Recording, latitude: float, longitude: float) -> Recording:
    """With the fixes moved to another place on the earth, the same metres north and east."""
    first = recording.of(FIX)[0]
    wider = np.cos(np.radians(first.latitude)) / np.cos(np.radians(latitude))

    def moved(fix: Any) -> Any:
        return replace(
            fix,
            latitude=latitude + fix.latitude - first.latitude,
            longitude=float(longitude + wider * (fix.longitude - first.longitude)),
        )

    return recording.each(FIX, moved)


def _with_fixes(recording: Recording, rate: int) -> Recording:
    """With ``rate`` times as many fixes, between those that there are; for straight drives."""
    rng = np.random.default_rng(5)
    fixes = [(t, m) for t, topic, m in recording.items if topic == FIX]
    made: list[Item] = []
    for (logged, before), (later, after) in pairwise(fixes):
        for step in range(1, rate):
            share = step / rate
            north, east = rng.normal(scale=2e-7, size=2)
            between = replace(
                before,
                latitude=before.latitude + share * (after.latitude - before.latitude) + north,
                longitude=before.longitude + share * (after.longitude - before.longitude) + east,
                altitude=before.altitude + share * (after.altitude - before.altitude),
            )
            moment = stamp_of(before) + round(share * (stamp_of(after) - stamp_of(before)))
            at = logged + round(share * (later - logged))
            made.append((at, FIX, restamped(between, moment)))
    return recording.plus(made)


def in_sectors(drive: Recording, count: int) -> Recording:
    """The same with each sweep of 0.1 s in so many clouds, one after the other.

    The last has the stamp of the sweep, and each is recorded at its stamp.
    """
    apart = round(TURN * NANOSECONDS / count)
    items: list[Item] = []
    for logged, topic, message in drive.items:
        if topic not in LIDARS:
            items.append((logged, topic, message))
            continue
        for number, part in enumerate(np.array_split(points_of(message), count)):
            at = stamp_of(message) - (count - 1 - number) * apart
            items.append((at, topic, restamped(cloud_of(message, table(part)), at)))
    return drive.with_items(items)
