"""Sensors that fail, are missing, or are called otherwise."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.typesys import get_types_from_msg

from incremental_mapper.measurements import NANOSECONDS
from lies.lie import Verdict, lie
from lies.recording import (
    FIX,
    IMU,
    LEFT,
    LIDARS,
    RIGHT,
    STORE,
    TYPES,
    Recording,
    cloud_of,
    points_of,
    stamp_of,
    table,
)

MENDED, WARNED, REFUSED, SOUND = Verdict.MENDED, Verdict.WARNED, Verdict.REFUSED, Verdict.SOUND


@lie(WARNED, about=r'right', drive='curve')
def lidar_dies(drive: Recording, folder: Path) -> Path:
    """The right LiDAR dies after 2 s."""
    until = drive.start + 2 * NANOSECONDS
    return drive.each(RIGHT, lambda m: m if stamp_of(m) < until else None).write(folder / 'bag')


@lie(WARNED, about=r'imu', drive='curve')
def imu_dies(drive: Recording, folder: Path) -> Path:
    """The IMU dies after 2 s."""
    until = drive.start + 2 * NANOSECONDS
    return drive.each(IMU, lambda m: m if stamp_of(m) < until else None).write(folder / 'bag')


@lie(
    SOUND,
    WARNED,
    about=r'left|right|bridge|gap',
    factor=4.0,
)
def lidar_hole(drive: Recording, folder: Path) -> Path:
    """Both LiDARs without 1.5 s in the middle."""
    begin = drive.start + round(1.5 * NANOSECONDS)
    inside = range(begin, begin + round(1.5 * NANOSECONDS))
    return drive.each(LIDARS, lambda m: None if stamp_of(m) in inside else m).write(folder / 'bag')


@lie(SOUND, WARNED, about=r'left|right|gap', factor=4.0)
def keyframes(drive: Recording, folder: Path) -> Path:
    """Keyframes: a scan every 2 s."""
    last = dict.fromkeys(LIDARS, 0)
    items = []
    for logged, topic, message in drive.items:
        if topic in LIDARS:
            if stamp_of(message) - last[topic] < 1.95 * NANOSECONDS:
                continue
            last[topic] = stamp_of(message)
        items.append((logged, topic, message))
    return drive.with_items(items).write(folder / 'bag')


@lie(SOUND, WARNED, about=r'right', factor=3.0)
def slow_lidar(drive: Recording, folder: Path) -> Path:
    """A LiDAR at 1 Hz."""
    count = iter(range(10**6))
    return drive.each(RIGHT, lambda m: None if next(count) % 10 else m).write(folder / 'bag')


@lie(WARNED, REFUSED, about=r'right')
def blind_lidar(drive: Recording, folder: Path) -> Path:
    """All clouds of the right LiDAR are empty."""
    return drive.each(RIGHT, lambda m: cloud_of(m, table(points_of(m)[:0]))).write(folder / 'bag')


@lie(WARNED, about=r'left')
def wrong_topic(drive: Recording, folder: Path) -> Path:
    """The settings name a topic of one LiDAR that the bag lacks."""
    tree = {'lidars': {'left': {'topic': '/velodyne_left/points'}}}
    return drive.with_settings(tree).write(folder / 'bag')


@lie(WARNED, MENDED, about=r'imu')
def wrong_imu_topic(drive: Recording, folder: Path) -> Path:
    """The settings name a topic of the IMU that the bag lacks."""
    return drive.with_settings({'imu': {'topic': '/imu/data_raw'}}).write(folder / 'bag')


@lie(
    WARNED,
    MENDED,
    REFUSED,
    about=r'left|right|T_base_sensor|extrinsic',
)
def exchanged_topics(drive: Recording, folder: Path) -> Path:
    """Topics of left and right exchanged in the settings."""
    tree = {'lidars': {'left': {'topic': RIGHT}, 'right': {'topic': LEFT}}}
    return drive.with_settings(tree).write(folder / 'bag')


@lie(REFUSED, about=r'Packet|Scan|driver|velodyne')
def packets(drive: Recording, folder: Path) -> Path:
    """LiDAR packets of a vendor instead of clouds."""
    definitions = {
        **get_types_from_msg(
            'builtin_interfaces/Time stamp\nuint8[1206] data', 'velodyne_msgs/msg/VelodynePacket'
        ),
        **get_types_from_msg(
            'std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets',
            'velodyne_msgs/msg/VelodyneScan',
        ),
    }
    if 'velodyne_msgs/msg/VelodyneScan' not in STORE.types:
        STORE.register(definitions)

    def change(cloud: Any) -> Any:
        packet = TYPES['velodyne_msgs/msg/VelodynePacket'](
            stamp=cloud.header.stamp, data=np.zeros(1206, dtype=np.uint8)
        )
        return TYPES['velodyne_msgs/msg/VelodyneScan'](header=cloud.header, packets=[packet])

    return drive.bare().each(LIDARS, change).write(folder / 'bag')


@lie(
    MENDED,
    WARNED,
    SOUND,
    about=r'[Ll]ivox|CustomMsg',
)
def half_livox(drive: Recording, folder: Path) -> Path:
    """One LiDAR as Livox's own message, one as clouds."""
    point = 'livox_ros_driver2/msg/CustomPoint'
    whole = 'livox_ros_driver2/msg/CustomMsg'
    if whole not in STORE.types:
        STORE.register(
            {
                **get_types_from_msg(
                    'uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\n'
                    'uint8 reflectivity\nuint8 tag\nuint8 line',
                    point,
                ),
                **get_types_from_msg(
                    'std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\n'
                    'uint8[3] rsvd\nlivox_ros_driver2/CustomPoint[] points',
                    whole,
                ),
            }
        )

    def change(cloud: Any) -> Any:
        points = [
            TYPES[point](
                offset_time=i * 1000,
                x=float(x),
                y=float(y),
                z=float(z),
                reflectivity=10,
                tag=0,
                line=i % 4,
            )
            for i, (x, y, z) in enumerate(points_of(cloud))
        ]
        return TYPES[whole](
            header=cloud.header,
            timebase=stamp_of(cloud),
            point_num=len(points),
            lidar_id=1,
            rsvd=np.zeros(3, dtype=np.uint8),
            points=points,
        )

    return drive.framed().each(RIGHT, change).write(folder / 'bag')


@lie(SOUND, WARNED, about=r'gnss|fix', drive='fixes')
def fixes_end(drive: Recording, folder: Path) -> Path:
    """Fixes of the first two seconds only."""
    until = drive.start + 2 * NANOSECONDS
    return drive.each(FIX, lambda m: m if stamp_of(m) < until else None).write(folder / 'bag')


@lie(WARNED, about=r'imu', drive='curve')
def no_acceleration(drive: Recording, folder: Path) -> Path:
    """The IMU says that it has no acceleration."""
    absent = np.array([-1.0, *[0.0] * 8])
    return drive.each(IMU, lambda m: replace(m, linear_acceleration_covariance=absent)).write(
        folder / 'bag'
    )


@lie(SOUND, WARNED, MENDED, about=r'frame')
def no_frames(drive: Recording, folder: Path) -> Path:
    """The clouds have empty frame_ids."""
    return drive.each(LIDARS, lambda m: replace(m, header=replace(m.header, frame_id=''))).write(
        folder / 'bag'
    )
