"""Frames and extrinsics that are not those of the car."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from incremental_mapper.measurements import NANOSECONDS
from lies.lie import Verdict, lie
from lies.recording import (
    LEFT,
    LIDARS,
    RIGHT,
    TYPES,
    Recording,
    cloud_of,
    matrix_of,
    points_of,
    reframed,
    setting_of,
    stamp_of,
    table,
)

MENDED, WARNED, REFUSED, SOUND = Verdict.MENDED, Verdict.WARNED, Verdict.REFUSED, Verdict.SOUND
EXTRINSICS = r'T_base_sensor|extrinsic|transform|tf'


def _posed(drive: Recording, **poses: np.ndarray) -> Recording:
    """With other extrinsics of some LiDARs."""
    tree = {name: {'T_base_sensor': setting_of(pose)} for name, pose in poses.items()}
    return drive.with_settings({'lidars': tree})


def _pose(drive: Recording, name: str) -> np.ndarray:
    return matrix_of(drive.settings['lidars'][name]['T_base_sensor'])


def _antenna_moved(drive: Recording, ahead: float, left: float) -> Recording:
    """The settings have the antenna so many metres behind, and right of, where it is."""
    pose = matrix_of(drive.settings['gnss']['T_base_sensor'])
    pose[:2, 3] -= ahead, left
    return drive.with_settings({'gnss': {'T_base_sensor': setting_of(pose)}})


def _in_base(made: Recording, drive: Recording) -> Recording:
    """The clouds of ``made`` moved into base_link, by the poses that ``drive`` has."""
    for topic, name in ((LEFT, 'left'), (RIGHT, 'right')):
        pose = _pose(drive, name)

        def moved(cloud: object, pose: np.ndarray = pose) -> object:
            points = points_of(cloud) @ pose[:3, :3].T + pose[:3, 3]
            return reframed(cloud_of(cloud, table(points)), 'base_link')

        made = made.each(topic, moved)
    return made


@lie(MENDED, SOUND)
def tf_static(drive: Recording, folder: Path) -> Path:
    """Extrinsics in /tf_static, none in the settings."""
    return drive.framed().write(folder / 'bag')


@lie(MENDED, SOUND)
def tf_repeated(drive: Recording, folder: Path) -> Path:
    """Extrinsics in /tf, sent again and again."""
    framed = drive.framed()
    logged, _, static = next(item for item in framed.items if item[1] == '/tf_static')
    repeated = [(logged + round(i * 0.2 * NANOSECONDS), '/tf', static) for i in range(25)]
    others = [item for item in framed.items if item[1] != '/tf_static']
    return framed.with_items([*others, *repeated]).write(folder / 'bag')


@lie(MENDED, SOUND)
def tf_chain(drive: Recording, folder: Path) -> Path:
    """Extrinsics in /tf_static by way of a frame between."""
    framed = drive.framed()
    made = []
    for logged, topic, message in framed.items:
        if topic == '/tf_static':
            roof = np.eye(4)
            roof[:3, 3] = [0.1, 0.0, 1.5]
            chained = []
            for link in message.transforms:
                move = replace(
                    link.transform.translation,
                    x=link.transform.translation.x - 0.1,
                    z=link.transform.translation.z - 1.5,
                )
                chained.append(
                    replace(
                        link,
                        header=replace(link.header, frame_id='roof'),
                        transform=replace(link.transform, translation=move),
                    )
                )
            first = chained[0]
            still = replace(first.transform.rotation, x=0.0, y=0.0, z=0.0, w=1.0)
            up = replace(first.transform.translation, x=0.1, y=0.0, z=1.5)
            base = replace(
                first,
                header=replace(first.header, frame_id='base_link'),
                child_frame_id='roof',
                transform=replace(first.transform, translation=up, rotation=still),
            )
            message = TYPES['tf2_msgs/msg/TFMessage'](transforms=[*chained, base])
        made.append((logged, topic, message))
    return framed.with_items(made).write(folder / 'bag')


@lie(WARNED, about=EXTRINSICS)
def tf_half(drive: Recording, folder: Path) -> Path:
    """/tf_static tells the left LiDAR only."""
    framed = drive.framed()

    def half(message: object) -> object:
        return replace(message, transforms=message.transforms[:1])  # type: ignore[attr-defined]

    return framed.each('/tf_static', half).write(folder / 'bag')


@lie(WARNED, REFUSED, about=EXTRINSICS)
def no_extrinsics(drive: Recording, folder: Path) -> Path:
    """No extrinsics anywhere."""
    return drive.bare().write(folder / 'bag')


@lie(WARNED, REFUSED, about=EXTRINSICS)
def equal_extrinsics(drive: Recording, folder: Path) -> Path:
    """Both LiDARs have the extrinsics of the left one."""
    return _posed(drive, right=_pose(drive, 'left')).write(folder / 'bag')


@lie(
    MENDED,
    WARNED,
    REFUSED,
    about=EXTRINSICS + '|left|right',
)
def exchanged_extrinsics(drive: Recording, folder: Path) -> Path:
    """Extrinsics of left and right exchanged."""
    return _posed(drive, right=_pose(drive, 'left'), left=_pose(drive, 'right')).write(
        folder / 'bag'
    )


@lie(
    MENDED,
    WARNED,
    REFUSED,
    about=EXTRINSICS + '|left',
    drive='curve',
)
def yaw_of_one(drive: Recording, folder: Path) -> Path:
    """Yaw of the left LiDAR 90 degrees wrong."""
    pose = _pose(drive, 'left')
    pose[:3, :3] = Rotation.from_euler('z', 90, degrees=True).as_matrix() @ pose[:3, :3]
    return _posed(drive, left=pose).write(folder / 'bag')


@lie(
    MENDED,
    WARNED,
    REFUSED,
    about=EXTRINSICS + '|left|right',
    drive='curve',
)
def inverted_extrinsics(drive: Recording, folder: Path) -> Path:
    """Extrinsics the other way round: T_sensor_base."""
    return _posed(
        drive,
        left=np.linalg.inv(_pose(drive, 'left')),
        right=np.linalg.inv(_pose(drive, 'right')),
    ).write(folder / 'bag')


@lie(MENDED, WARNED, about='antenna_place', drive='turns')
def antenna_left(drive: Recording, folder: Path) -> Path:
    """The antenna 4 m left of where it is."""
    return _antenna_moved(drive, 0.0, 4.0).write(folder / 'bag')


@lie(MENDED, WARNED, about='antenna_place', drive='turns')
def antenna_ahead(drive: Recording, folder: Path) -> Path:
    """The antenna 3 m ahead of where it is, and 1.5 m right."""
    return _antenna_moved(drive, 3.0, -1.5).write(folder / 'bag')


@lie(WARNED, REFUSED, about=EXTRINSICS + '|left|right')
def millimetre_levers(drive: Recording, folder: Path) -> Path:
    """Lever arms in millimetres."""
    poses = {name: _pose(drive, name) for name in ('left', 'right')}
    for pose in poses.values():
        pose[:3, 3] *= 1000.0
    return _posed(drive, **poses).write(folder / 'bag')


@lie(
    MENDED,
    WARNED,
    REFUSED,
    about=EXTRINSICS + '|frame|left|right',
    drive='curve',
)
def moved_twice(drive: Recording, folder: Path) -> Path:
    """Clouds are in base_link already, and moved once more."""
    return _in_base(drive, drive).write(folder / 'bag')


@lie(SOUND, WARNED, about=EXTRINSICS)
def moved_already(drive: Recording, folder: Path) -> Path:
    """Clouds are in base_link already, without settings."""
    return _in_base(drive.framed(), drive).write(folder / 'bag')


@lie(
    MENDED,
    WARNED,
    REFUSED,
    about=r'frame',
)
def one_topic(drive: Recording, folder: Path) -> Path:
    """Two LiDARs in turn on one topic, told apart by frame_id."""
    made = drive.framed()
    for topic in LIDARS:
        made = made.renamed(topic, '/lidar/points')
    return made.write(folder / 'bag')


@lie(SOUND, MENDED)
def slashed_frames(drive: Recording, folder: Path) -> Path:
    """Frame_ids with a slash in front, as ROS 1 had them."""
    made = drive.framed()
    for topic in LIDARS:
        made = made.each(topic, lambda m: reframed(m, '/' + m.header.frame_id))
    return made.write(folder / 'bag')


@lie(MENDED, WARNED, REFUSED, about=r'map|frame|odom', drive='turns')
def map_clouds_alone(drive: Recording, folder: Path) -> Path:
    """All clouds there are have been moved into the frame map."""
    poses = drive.of('/ground_truth/odometry')
    stamps = np.array([stamp_of(pose) for pose in poses])
    made = _in_base(drive, drive)

    def moved(cloud: object) -> object:
        pose = poses[int(np.abs(stamps - stamp_of(cloud)).argmin())].pose.pose
        turn = Rotation.from_quat(
            [pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w]
        )
        at = np.array([pose.position.x, pose.position.y, pose.position.z])
        return reframed(
            cloud_of(cloud, table((turn.apply(points_of(cloud)) + at).astype(np.float32))), 'map'
        )

    return made.each(LIDARS, moved).bare().write(folder / 'bag')


@lie(MENDED, WARNED, REFUSED, about=EXTRINSICS + '|left|right', drive='turns')
def tf_inverted(drive: Recording, folder: Path) -> Path:
    """Transforms the other way round under the right names: base_link in the LiDARs' frames."""
    tree = {
        name: {'T_base_sensor': setting_of(np.linalg.inv(_pose(drive, name)))}
        for name in ('left', 'right')
    }
    return drive.with_settings({'lidars': tree}).framed().write(folder / 'bag')


@lie(MENDED, WARNED, REFUSED, about=EXTRINSICS + '|left|right|quaternion', drive='turns')
def quaternion_w_first(drive: Recording, folder: Path) -> Path:
    """Quaternions of the LiDARs written with w first."""
    tree = {}
    for name in ('left', 'right'):
        pose = _pose(drive, name)
        x, y, z, w = (float(v) for v in Rotation.from_matrix(pose[:3, :3]).as_quat())
        tree[name] = {'T_base_sensor': [*(float(v) for v in pose[:3, 3]), w, x, y, z]}
    return drive.with_settings({'lidars': tree}).write(folder / 'bag')


@lie(MENDED, WARNED, REFUSED, about=EXTRINSICS + '|left|right', drive='turns')
def no_tilt(drive: Recording, folder: Path) -> Path:
    """Lever arms of the LiDARs given, and no rotation."""
    poses = {name: _pose(drive, name) for name in ('left', 'right')}
    for pose in poses.values():
        pose[:3, :3] = np.eye(3)
    return _posed(drive, **poses).write(folder / 'bag')


@lie(MENDED, WARNED, REFUSED, about=r'left|right|topic', drive='turns')
def exchanged_midway(drive: Recording, folder: Path) -> Path:
    """Left and right exchange their topics in the middle."""
    until = (drive.start + drive.end) // 2
    other = {LEFT: RIGHT, RIGHT: LEFT}
    items = [(t, other.get(topic, topic) if t > until else topic, m) for t, topic, m in drive.items]
    return drive.with_items(items).write(folder / 'bag')


@lie(MENDED, WARNED, REFUSED, about=EXTRINSICS, drive='turns')
def no_extrinsics_turns(drive: Recording, folder: Path) -> Path:
    """No extrinsics anywhere, over bends."""
    return drive.bare().write(folder / 'bag')


@lie(MENDED, WARNED, REFUSED, about=EXTRINSICS + '|frame', drive='turns')
def one_topic_unplaced(drive: Recording, folder: Path) -> Path:
    """Two LiDARs in turn on one topic, told apart by frame_id, no extrinsics anywhere."""
    made = drive.bare()
    for topic in LIDARS:
        made = made.renamed(topic, '/lidar/points')
    return made.write(folder / 'bag')


def _reposed(name: str, text: str, change: Callable[[np.ndarray], np.ndarray]) -> None:
    """Enter a harm to the extrinsics of both LiDARs, over bends."""

    def make(drive: Recording, folder: Path) -> Path:
        poses = {side: change(_pose(drive, side)) for side in ('left', 'right')}
        return _posed(drive, **poses).write(folder / 'bag')

    make.__name__, make.__doc__ = name, f'{text}.'
    lie(MENDED, WARNED, REFUSED, about=EXTRINSICS, drive='turns')(make)


def _rotated(pose: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    made = pose.copy()
    made[:3, :3] = rotation
    return made


def _about(axis: str, degrees: float) -> Callable[[np.ndarray], np.ndarray]:
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    return lambda pose: turn @ pose


def _angles(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
    def changed(pose: np.ndarray) -> np.ndarray:
        angles = Rotation.from_matrix(pose[:3, :3]).as_euler('zyx')
        return _rotated(pose, Rotation.from_euler('zyx', change(angles)).as_matrix())

    return changed


_reposed('yawed_180', 'Extrinsics of both LiDARs yawed by 180 degrees', _about('z', 180.0))
_reposed('pitched_5', 'Extrinsics of both LiDARs pitched by 5 degrees', _about('y', 5.0))
_reposed('rolled_15', 'Extrinsics of both LiDARs rolled by 15 degrees', _about('x', 15.0))
_reposed('transposed', 'Rotations of both transposed', lambda p: _rotated(p, p[:3, :3].T))
_reposed('degrees_as_radians', 'Angles in degrees taken for radians', _angles(np.degrees))
_reposed('euler_order', 'Roll, pitch, yaw read as yaw, pitch, roll', _angles(lambda a: a[::-1]))
