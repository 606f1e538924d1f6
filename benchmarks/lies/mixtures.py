"""Two faults at once, and faults that are a little otherwise than those of the reports."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin

from incremental_mapper.measurements import NANOSECONDS
from lies.clocks import CLOCK
from lies.clouds import LAYOUT
from lies.frames import EXTRINSICS
from lies.lie import Verdict, lie
from lies.recording import (
    FIX,
    IMU,
    LEFT,
    LIDARS,
    RIGHT,
    Recording,
    cloud_of,
    numbers,
    points_of,
    reframed,
    restamped,
    stamp_of,
    table,
    vector,
)

MENDED, WARNED, REFUSED, SOUND = Verdict.MENDED, Verdict.WARNED, Verdict.REFUSED, Verdict.SOUND
TOLD = (MENDED, WARNED, REFUSED)


@lie(*TOLD, about='imu', drive='turns')
def in_g_and_late(drive: Recording, folder: Path) -> Path:
    """Accelerations in g, stamped 0.3 s late."""
    made = drive.each(
        IMU,
        lambda m: replace(m, linear_acceleration=vector(numbers(m.linear_acceleration) / 9.80665)),
    )
    return made.shifted(IMU, 0.3).write(folder / 'bag')


@lie(*TOLD, about='imu', drive='turns')
def in_g_for_a_while(drive: Recording, folder: Path) -> Path:
    """Accelerations in g from the middle on: the driver was set otherwise."""
    middle = (drive.start + drive.end) // 2

    def change(message: Any) -> Any:
        felt = numbers(message.linear_acceleration)
        felt = felt / 9.80665 if stamp_of(message) > middle else felt
        return replace(message, linear_acceleration=vector(felt))

    return drive.each(IMU, change).write(folder / 'bag')


@lie(*TOLD, about=CLOCK, drive='turns')
def each_its_own_clock(drive: Recording, folder: Path) -> Path:
    """Left LiDAR on TAI, right one since power-up, IMU an hour ahead."""
    made = drive.shifted(LEFT, 37.0).shifted(IMU, 3600.0)
    return made.each(RIGHT, lambda m: restamped(m, stamp_of(m) - drive.start + 10**12)).write(
        folder / 'bag'
    )


@lie(*TOLD, about=CLOCK, drive='turns')
def lidars_day_behind(drive: Recording, folder: Path) -> Path:
    """LiDARs a day and 37 s behind."""
    return drive.shifted(LIDARS, -86437.0).write(folder / 'bag')


@lie(SOUND, *TOLD, about=LAYOUT)
def row_steps_by_chance(drive: Recording, folder: Path) -> Path:
    """Organised clouds of 16 rows, with another nonsense for row_step in each."""
    rng = np.random.default_rng(2)

    def change(cloud: Any) -> Any:
        points = points_of(cloud)
        points = points[: len(points) // 16 * 16]
        step = int(rng.choice([0, 1, 12, len(points), 2**31, 12 * len(points)]))
        return cloud_of(cloud, table(points), height=16, width=len(points) // 16, row_step=step)

    return drive.each(LIDARS, change).write(folder / 'bag')


@lie(SOUND, *TOLD, about='gnss|fix|altitude', drive='fixes')
def altitudes_infinite_and_unsure(drive: Recording, folder: Path) -> Path:
    """Every third altitude is infinite, every third vertical variance negative."""
    count = iter(range(10**6))

    def change(message: Any) -> Any:
        number = next(count)
        if number % 3 == 0:
            return replace(message, altitude=float('inf'))
        covariance = np.array(message.position_covariance)
        covariance[8] = -1.0 if number % 3 == 1 else np.inf
        return replace(message, position_covariance=covariance)

    return drive.each(FIX, change).write(folder / 'bag')


@lie(SOUND, *TOLD, about='gnss|fix|altitude', drive='fixes')
def only_the_first_without_altitude(drive: Recording, folder: Path) -> Path:
    """The first two fixes have no altitude, and then it is 50 m."""
    count = iter(range(10**6))
    return drive.each(
        FIX, lambda m: replace(m, altitude=float('nan')) if next(count) < 2 else m
    ).write(folder / 'bag')


@lie(MENDED, SOUND, WARNED, REFUSED, about='storage|metadata')
def storage_in_capitals(drive: Recording, folder: Path) -> Path:
    """Metadata that call the storage MCAP."""
    bag = drive.write(folder / 'bag')
    path = bag / 'metadata.yaml'
    path.write_text(
        path.read_text().replace('storage_identifier: mcap', 'storage_identifier: MCAP')
    )
    return bag


@lie(MENDED, SOUND, WARNED, REFUSED, about='storage|metadata')
def storage_left_out(drive: Recording, folder: Path) -> Path:
    """Metadata without a line for the storage, of an SQLite bag."""
    bag = drive.write(folder / 'bag', StoragePlugin.SQLITE3)
    path = bag / 'metadata.yaml'
    lines = [one for one in path.read_text().splitlines() if 'storage_identifier' not in one]
    path.write_text('\n'.join(lines) + '\n')
    return bag


@lie(*TOLD, about='left|right|frame|topic')
def one_topic_one_frame(drive: Recording, folder: Path) -> Path:
    """Two LiDARs on one topic under one frame_id, at the same stamps."""
    frame = str(drive.of(LEFT)[0].header.frame_id)
    items = [
        (t, LEFT if topic in LIDARS else topic, reframed(m, frame) if topic in LIDARS else m)
        for t, topic, m in drive.items
    ]
    return drive.with_items(items).write(folder / 'bag')


def _statics(drive: Recording, change: Any) -> Recording:
    framed = drive.framed()
    return framed.each(
        '/tf_static', lambda m: replace(m, transforms=[change(one) for one in m.transforms])
    )


@lie(MENDED, SOUND, WARNED, about=EXTRINSICS)
def tf_in_the_middle(drive: Recording, folder: Path) -> Path:
    """/tf_static comes in the middle of the drive."""
    framed = drive.framed()
    middle = (drive.start + drive.end) // 2
    items = [(middle if topic == '/tf_static' else t, topic, m) for t, topic, m in framed.items]
    return framed.with_items(items).write(folder / 'bag')


@lie(*TOLD, about=EXTRINSICS)
def tf_without_rotation(drive: Recording, folder: Path) -> Path:
    """/tf_static whose quaternions are all zero."""

    def change(one: Any) -> Any:
        still = replace(one.transform.rotation, x=0.0, y=0.0, z=0.0, w=0.0)
        return replace(one, transform=replace(one.transform, rotation=still))

    return _statics(drive, change).write(folder / 'bag')


@lie(MENDED, SOUND, WARNED, about=EXTRINSICS)
def tf_unnormalised(drive: Recording, folder: Path) -> Path:
    """/tf_static whose quaternions have a length of 2."""

    def change(one: Any) -> Any:
        turn = one.transform.rotation
        longer = replace(turn, x=2.0 * turn.x, y=2.0 * turn.y, z=2.0 * turn.z, w=2.0 * turn.w)
        return replace(one, transform=replace(one.transform, rotation=longer))

    return _statics(drive, change).write(folder / 'bag')


def _sectors(cloud: Any, count: int, same: bool) -> list[Any]:
    points = points_of(cloud)
    parts = np.array_split(points, count)
    stamp = stamp_of(cloud)
    return [
        restamped(
            cloud_of(cloud, table(part)),
            stamp if same else stamp - (count - 1 - number) * 10**8 // count,
        )
        for number, part in enumerate(parts)
    ]


@lie(SOUND, *TOLD, about='left|right|sector|partial', drive='curve')
def tenths_of_one_stamp(drive: Recording, folder: Path) -> Path:
    """LiDARs that send a tenth of a turn at a time, all ten with the stamp of the turn."""
    items = [
        (t + number, topic, part)
        for t, topic, m in drive.items
        for number, part in enumerate(_sectors(m, 10, True) if topic in LIDARS else [m])
    ]
    return drive.with_items(items).write(folder / 'bag')


@lie(SOUND, *TOLD, about='left|right|sector|partial', drive='curve', factor=2.0)
def twentieths_some_lost(drive: Recording, folder: Path) -> Path:
    """LiDARs that send a twentieth of a turn at a time, of which one in eight is lost."""
    rng = np.random.default_rng(6)
    items = [
        (stamp_of(part) if topic in LIDARS else t, topic, part)
        for t, topic, m in drive.items
        for part in (_sectors(m, 20, False) if topic in LIDARS else [m])
        if topic not in LIDARS or rng.random() > 0.125
    ]
    return drive.with_items(items).write(folder / 'bag')


@lie(MENDED, WARNED, about='gnss|fix|datum', drive='turns')
def three_first_elsewhere(drive: Recording, folder: Path) -> Path:
    """The first three fixes of a place 30 m away."""
    count = iter(range(10**6))

    def change(message: Any) -> Any:
        away = 30.0 / 111_000.0 if next(count) < 3 else 0.0
        return replace(message, latitude=message.latitude + away)

    return drive.each(FIX, change).write(folder / 'bag')


@lie(MENDED, WARNED, about='gnss|fix|datum', drive='turns')
def first_of_another_height(drive: Recording, folder: Path) -> Path:
    """The first fix 400 m too high, at the right place."""
    count = iter(range(10**6))
    return drive.each(
        FIX, lambda m: replace(m, altitude=m.altitude + 400.0) if next(count) < 1 else m
    ).write(folder / 'bag')


@lie(SOUND, *TOLD, about='left|right', drive='curve', factor=2.0)
def slivers_of_both(drive: Recording, folder: Path) -> Path:
    """Every fifth cloud of either LiDAR has seven points, with windows of half a second."""
    count = iter(range(10**6))
    made = drive.each(
        LIDARS, lambda m: m if next(count) % 5 else cloud_of(m, table(points_of(m)[:7]))
    )
    return made.with_settings({'window': {'duration': 0.5}}).write(folder / 'bag')


@lie(SOUND, *TOLD, about='left|right', drive='curve', factor=2.0)
def slivers_in_a_row(drive: Recording, folder: Path) -> Path:
    """A second of slivers: a thirtieth of each cloud, with windows of half a second."""
    begin = (drive.start + drive.end) // 2

    def change(cloud: Any) -> Any:
        if not 0 <= stamp_of(cloud) - begin < NANOSECONDS:
            return cloud
        points = points_of(cloud)
        return cloud_of(cloud, table(points[: len(points) // 30]))

    made = drive.each(LIDARS, change)
    return made.with_settings({'window': {'duration': 0.5}}).write(folder / 'bag')
