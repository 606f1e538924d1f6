"""Recordings by another convention: units, names, frames and clocks that are right elsewhere."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pymap3d
from rosbags.rosbag2 import StoragePlugin

from incremental_mapper.measurements import NANOSECONDS
from lies.lie import Verdict, lie
from lies.recording import (
    FIX,
    IMU,
    LIDARS,
    Recording,
    cloud_of,
    in_sectors,
    numbers,
    points_of,
    reframed,
    restamped,
    stamp_of,
    table,
    times_of,
    vector,
)

MENDED, WARNED, REFUSED, SOUND = Verdict.MENDED, Verdict.WARNED, Verdict.REFUSED, Verdict.SOUND
HOUR = 3600 * NANOSECONDS


@lie(MENDED, WARNED, REFUSED, about=r'clock|time_offset|stamp|step')
def top_of_the_hour(drive: Recording, folder: Path) -> Path:
    """LiDAR stamps count from the last full hour, which strikes in the middle."""
    strikes = (drive.start + drive.end) // 2
    return drive.each(
        LIDARS, lambda m: restamped(m, (stamp_of(m) - strikes) % HOUR + NANOSECONDS // 1000)
    ).write(folder / 'bag')


@lie(MENDED, WARNED, REFUSED, about=r'clock|time_offset|stamp')
def seconds_of_the_day(drive: Recording, folder: Path) -> Path:
    """Fixes carry the time of the day, as NMEA sentences do."""
    day = 24 * HOUR
    return drive.each(FIX, lambda m: restamped(m, stamp_of(m) % day)).write(folder / 'bag')


@lie(WARNED, REFUSED, about=r'fix|gnss|latitude')
def utm_as_degrees(drive: Recording, folder: Path) -> Path:
    """Eastings and northings in metres where latitude and longitude should be."""
    first = drive.of(FIX)[0]

    def metres(fix: Any) -> Any:
        east, north, _ = pymap3d.geodetic2enu(
            fix.latitude, fix.longitude, 0.0, first.latitude, first.longitude, 0.0
        )
        return replace(fix, latitude=4_030_000.0 + float(north), longitude=320_000.0 + float(east))

    return drive.each(FIX, metres).write(folder / 'bag')


@lie(MENDED, WARNED, REFUSED, about=r'fix|gnss|latitude')
def local_metres_as_degrees(drive: Recording, folder: Path) -> Path:
    """Metres from the start where latitude and longitude should be: 0, 0 and up to 90."""
    first = drive.of(FIX)[0]

    def metres(fix: Any) -> Any:
        east, north, _ = pymap3d.geodetic2enu(
            fix.latitude, fix.longitude, 0.0, first.latitude, first.longitude, 0.0
        )
        return replace(fix, latitude=float(north), longitude=float(east))

    return drive.each(FIX, metres).write(folder / 'bag')


@lie(MENDED, WARNED, SOUND, about=r'fix|gnss', drive='fixes')
def ends_elsewhere(drive: Recording, folder: Path) -> Path:
    """The last four fixes of another city."""
    last = {stamp_of(m) for m in drive.of(FIX)[-4:]}
    return drive.each(
        FIX, lambda m: replace(m, latitude=m.latitude + 0.7) if stamp_of(m) in last else m
    ).write(folder / 'bag')


@lie(MENDED, SOUND, WARNED, about=r'metadata|storage|\.mcap')
def other_storage(drive: Recording, folder: Path) -> Path:
    """Metadata that name SQLite for an MCAP."""
    bag = drive.write(folder / 'bag')
    path = bag / 'metadata.yaml'
    path.write_text(
        path.read_text().replace('storage_identifier: mcap', 'storage_identifier: sqlite3')
    )
    return bag


@lie(MENDED, SOUND, WARNED, REFUSED, about=r'metadata|missing|\.db3|file')
def renamed_file(drive: Recording, folder: Path) -> Path:
    """A bag whose file was renamed after it was recorded."""
    bag = drive.write(folder / 'bag', StoragePlugin.SQLITE3)
    next(bag.glob('*.db3')).rename(bag / 'monday.db3')
    return bag


@lie(MENDED, SOUND, WARNED, about=r'base_link|frame|T_base_sensor|tf')
def other_root(drive: Recording, folder: Path) -> Path:
    """The transforms begin at base_footprint, and no base_link is there."""
    framed = drive.framed()

    def rooted(static: Any) -> Any:
        links = [
            replace(link, header=replace(link.header, frame_id='base_footprint'))
            for link in static.transforms
        ]
        return replace(static, transforms=links)

    return framed.each('/tf_static', rooted).write(folder / 'bag')


@lie(MENDED, WARNED, REFUSED, about=r'base_link|frame|T_base_sensor|tf|transform')
def told_twice(drive: Recording, folder: Path) -> Path:
    """Two programs tell /tf_static: one of them has the left LiDAR 90 degrees off."""
    framed = drive.framed()
    logged, topic, static = next(item for item in framed.items if item[1] == '/tf_static')
    wrong = []
    for link in static.transforms:
        turn = link.transform.rotation
        if 'left' in link.child_frame_id:
            x, y, z, w = _about_z(turn, 90.0)
            turn = replace(turn, x=x, y=y, z=z, w=w)
        wrong.append(replace(link, transform=replace(link.transform, rotation=turn)))
    later = logged + NANOSECONDS // 10
    return framed.plus([(later, topic, replace(static, transforms=wrong))]).write(folder / 'bag')


def _about_z(turn: Any, degrees: float) -> Any:
    from scipy.spatial.transform import Rotation

    before = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w])
    return (Rotation.from_euler('z', degrees, degrees=True) * before).as_quat()


@lie(SOUND, drive='timed')
def times_ms(drive: Recording, folder: Path) -> Path:
    """Point times in milliseconds before the stamp."""

    def timed(cloud: Any) -> Any:
        points = points_of(cloud)
        return cloud_of(cloud, table(points, time=('<f4', 1000.0 * times_of(points))))

    return drive.each(LIDARS, timed).write(folder / 'bag')


@lie(MENDED, about=r'field')
def capital_fields(drive: Recording, folder: Path) -> Path:
    """Fields named X, Y, Z."""

    def renamed(cloud: Any) -> Any:
        fields = [replace(field, name=field.name.upper()) for field in cloud.fields]
        return replace(cloud, fields=fields)

    return drive.each(LIDARS, renamed).write(folder / 'bag')


@lie(SOUND)
def wide_points(drive: Recording, folder: Path) -> Path:
    """Points of 48 bytes, with x at the 16th, as structures in memory are."""

    def padded(cloud: Any) -> Any:
        points = points_of(cloud)
        kind = np.dtype(
            {
                'names': ['x', 'y', 'z'],
                'formats': ['<f4'] * 3,
                'offsets': [16, 20, 24],
                'itemsize': 48,
            }
        )
        rows = np.zeros(len(points), dtype=kind)
        for number, name in enumerate('xyz'):
            rows[name] = points[:, number]
        return cloud_of(cloud, rows)

    return drive.each(LIDARS, padded).write(folder / 'bag')


@lie(MENDED, WARNED, REFUSED, about=r'sector|partial|sweep|turn')
def half_turns(drive: Recording, folder: Path) -> Path:
    """Both LiDARs send half a turn at a time, 20 Hz."""
    return in_sectors(drive, 2).write(folder / 'bag')


def _scaled(drive: Recording, rates: float = 1.0, forces: float = 1.0) -> Recording:
    return drive.each(
        IMU,
        lambda m: replace(
            m,
            angular_velocity=vector(rates * numbers(m.angular_velocity)),
            linear_acceleration=vector(forces * numbers(m.linear_acceleration)),
        ),
    )


@lie(MENDED, WARNED, about=r'unit|acceleration_scale|imu')
def in_gal(drive: Recording, folder: Path) -> Path:
    """Accelerations in cm/s^2."""
    return _scaled(drive, forces=100.0).write(folder / 'bag')


@lie(MENDED, WARNED, about=r'unit|rate_scale|imu', drive='turns')
def in_milliradians(drive: Recording, folder: Path) -> Path:
    """Rates in mrad/s."""
    return _scaled(drive, rates=1000.0).write(folder / 'bag')


@lie(MENDED, WARNED, about=r'unit|imu', drive='curve')
def minus_g(drive: Recording, folder: Path) -> Path:
    """Accelerations in g with the opposite sign."""
    return _scaled(drive, forces=-1.0 / 9.80665).write(folder / 'bag')


@lie(MENDED, WARNED, SOUND, about=r'frame|left|right')
def frames_counted(drive: Recording, folder: Path) -> Path:
    """Every cloud has a frame_id of its own, with its number in it."""
    count = iter(range(10**6))
    return drive.each(LIDARS, lambda m: reframed(m, f'lidar_{next(count)}')).write(folder / 'bag')


@lie(SOUND, MENDED, WARNED, about=r'time|record|clock|stamp')
def record_times_hours_off(drive: Recording, folder: Path) -> Path:
    """A recorder whose clock is 9 h behind those of all sensors."""
    items = [(t - 9 * HOUR, topic, message) for t, topic, message in drive.items]
    return drive.with_items(items).write(folder / 'bag')


@lie(SOUND, MENDED, WARNED, about=r'variance|covariance|sigma|fix|gnss')
def deviations_as_variances(drive: Recording, folder: Path) -> Path:
    """Covariances of fixes with 10^-4 of their values, as in degrees or kilometres."""
    return drive.each(
        FIX, lambda m: replace(m, position_covariance=1e-4 * np.array(m.position_covariance))
    ).write(folder / 'bag')


@lie(WARNED, MENDED, REFUSED, about=r'metadata|split|missing|gap|hole|absent')
def middle_part_missing(drive: Recording, folder: Path) -> Path:
    """Recorded in three goes: the driver of the right LiDAR was not started for the second."""
    third = (drive.end - drive.start) // 3
    kept = [
        item
        for item in drive.items
        if not (item[1] == LIDARS[1] and drive.start + third <= item[0] < drive.start + 2 * third)
    ]
    return drive.with_items(kept).write(folder / 'bag')
