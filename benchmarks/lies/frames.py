"""Frames and extrinsics that are not those of the car."""

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
