"""Rigs that somebody else built: known faults at other sizes and places, and several at once."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pymap3d
from scipy.spatial.transform import Rotation

from incremental_mapper.measurements import NANOSECONDS
from lies.clocks import CLOCK, HOUR
from lies.clouds import LAYOUT
from lies.fixes import GNSS
from lies.frames import EXTRINSICS, _antenna_moved
from lies.hardware import _turned
from lies.inertial import GRAVITY, _measuring
from lies.lie import Verdict, lie
from lies.mixtures import _sectors
from lies.recording import (
    FIX,
    IMU,
    LIDARS,
    RIGHT,
    TRUTH,
    TYPES,
    Item,
    Recording,
    cloud_of,
    numbers,
    points_of,
    restamped,
    stamp_of,
    table,
    times_of,
    vector,
)

MENDED, WARNED, REFUSED, SOUND = Verdict.MENDED, Verdict.WARNED, Verdict.REFUSED, Verdict.SOUND
TOLD = (MENDED, WARNED, REFUSED)
DOWN = np.array([1.0, -1.0, -1.0])
"""From forward, left, up to forward, right, down, and back."""
CLOUDS = LAYOUT + '|' + EXTRINSICS


def _measures(drive: Recording, force: Any, rate: Any) -> Recording:
    """An IMU that measures something else, and goes on to tell its orientation."""
    return drive.each(
        IMU,
        lambda m: replace(
            m,
            linear_acceleration=vector(force(numbers(m.linear_acceleration))),
            angular_velocity=vector(rate(numbers(m.angular_velocity))),
        ),
    )


# --- IMU


@lie(*TOLD, SOUND, about='imu', drive='turns')
def upside_down_told_g_deg(drive: Recording, folder: Path) -> Path:
    """IMU upside down, which /tf_static tells, in g and deg/s."""
    made = _measures(drive, lambda a: DOWN * a / GRAVITY, lambda w: DOWN * np.degrees(w)).framed()

    def turned(static: Any) -> Any:
        over = Rotation.from_euler('x', 180.0, degrees=True)
        links = []
        for link in static.transforms:
            if 'imu' in link.child_frame_id:
                q = link.transform.rotation
                x, y, z, w = (Rotation.from_quat([q.x, q.y, q.z, q.w]) * over).as_quat()
                link = replace(
                    link,
                    transform=replace(link.transform, rotation=replace(q, x=x, y=y, z=z, w=w)),
                )
            links.append(link)
        return replace(static, transforms=links)

    return made.each('/tf_static', turned).write(folder / 'bag')


@lie(*TOLD, about='imu', drive='turns')
def in_g_no_gravity(drive: Recording, folder: Path) -> Path:
    """Accelerations in g, and gravity taken out."""
    up = np.array([0.0, 0.0, GRAVITY])
    return _measuring(drive, lambda a: (a - up) / GRAVITY).write(folder / 'bag')


@lie(*TOLD, about='imu', drive='turns')
def deg_and_yawed(drive: Recording, folder: Path) -> Path:
    """Rates in deg/s, and the IMU turned by 90 degrees about its upward axis."""
    turn = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    made = _measuring(drive, lambda a: turn @ a, lambda w: np.degrees(turn @ w))
    return made.write(folder / 'bag')


@lie(*TOLD, SOUND, about='imu', drive='turns', factor=2.0)
def imu_5_hz(drive: Recording, folder: Path) -> Path:
    """IMU at 5 Hz."""
    count = iter(range(10**6))
    return drive.each(IMU, lambda m: m if next(count) % 20 == 0 else None).write(folder / 'bag')


@lie(*TOLD, about='imu', drive='turns')
def imu_of_another_car(drive: Recording, folder: Path) -> Path:
    """The IMU is that of another car: it feels what this one felt half a drive before."""
    values = drive.of(IMU)
    count = iter(range(len(values)))

    def other(message: Any) -> Any:
        felt = values[(next(count) + len(values) // 2) % len(values)]
        return replace(felt, header=message.header)

    return drive.each(IMU, other).write(folder / 'bag')


# --- clocks


def _fast(drive: Recording, topics: str | Iterable[str], share: float) -> Recording:
    first = drive.start
    return drive.each(
        topics, lambda m: restamped(m, stamp_of(m) + round((stamp_of(m) - first) * share))
    )


@lie(*TOLD, about=CLOCK, drive='turns')
def imu_runs_fast(drive: Recording, folder: Path) -> Path:
    """The IMU's clock runs one per cent fast."""
    return _fast(drive, IMU, 0.01).write(folder / 'bag')


@lie(*TOLD, about=CLOCK, drive='turns')
def right_runs_fast(drive: Recording, folder: Path) -> Path:
    """The right LiDAR's clock runs one per cent fast."""
    return _fast(drive, RIGHT, 0.01).write(folder / 'bag')


@lie(*TOLD, about=CLOCK, drive='turns')
def fixes_run_fast(drive: Recording, folder: Path) -> Path:
    """The receiver's clock runs four per cent fast."""
    return _fast(drive, FIX, 0.04).write(folder / 'bag')


@lie(*TOLD, about=CLOCK + '|gnss', drive='turns')
def fixes_three_late(drive: Recording, folder: Path) -> Path:
    """Fixes stamped 3 s late."""
    return drive.shifted(FIX, 3.0).write(folder / 'bag')


@lie(*TOLD, about=CLOCK + '|gnss', drive='turns')
def late_and_aside(drive: Recording, folder: Path) -> Path:
    """Fixes 0.5 s late, and the antenna 2 m left of where it is."""
    return _antenna_moved(drive, 0.0, 2.0).shifted(FIX, 0.5).write(folder / 'bag')


@lie(*TOLD, about=CLOCK, drive='turns')
def a_fault_each(drive: Recording, folder: Path) -> Path:
    """LiDARs 37 s ahead, IMU in g, fixes an hour behind, extrinsics in /tf_static alone."""
    made = _measures(drive, lambda a: a / GRAVITY, lambda w: w)
    return made.shifted(LIDARS, 37.0).shifted(FIX, -HOUR).framed().write(folder / 'bag')


@lie(SOUND, MENDED, WARNED, about=CLOCK, drive='turns')
def each_its_own_clock_fixes_too(drive: Recording, folder: Path) -> Path:
    """Left LiDAR on TAI, right one since power-up, IMU an hour ahead, fixes on GPS time."""
    made = drive.shifted(LIDARS[0], 37.0).shifted(IMU, HOUR).shifted(FIX, 18.0)
    return made.each(RIGHT, lambda m: restamped(m, stamp_of(m) - drive.start + 10**12)).write(
        folder / 'bag'
    )


# --- fixes


@lie(*TOLD, SOUND, about=GNSS + '|altitude', drive='turns')
def altitude_in_feet(drive: Recording, folder: Path) -> Path:
    """Altitudes in feet."""
    return drive.each(FIX, lambda m: replace(m, altitude=m.altitude / 0.3048)).write(folder / 'bag')


@lie(*TOLD, about=GNSS + '|datum', drive='turns')
def nan_heights_first_elsewhere(drive: Recording, folder: Path) -> Path:
    """No altitude at all, and the first two fixes of another city."""
    count = iter(range(10**6))

    def change(message: Any) -> Any:
        away = 0.7 if next(count) < 2 else 0.0
        return replace(message, altitude=np.nan, latitude=message.latitude + away)

    return drive.each(FIX, change).write(folder / 'bag')


@lie(WARNED, REFUSED, about=GNSS + '|odometry', drive='turns')
def fixes_as_odometry(drive: Recording, folder: Path) -> Path:
    """The receiver's positions as nav_msgs/Odometry in metres instead of fixes."""
    first = drive.of(FIX)[0]
    like = drive.of(TRUTH)[0]

    def metres(fix: Any) -> Any:
        east, north, up = pymap3d.geodetic2enu(
            fix.latitude, fix.longitude, fix.altitude, first.latitude, first.longitude, 0.0
        )
        place = TYPES['geometry_msgs/msg/Point'](x=float(east), y=float(north), z=float(up))
        pose = replace(like.pose.pose, position=place)
        return replace(like, header=fix.header, pose=replace(like.pose, pose=pose))

    items = [
        (t, '/gps/odometry', metres(m)) if topic == FIX else (t, topic, m)
        for t, topic, m in drive.items
    ]
    return drive.with_items(items).write(folder / 'bag')


# --- clouds and mounts


@lie(*TOLD, about=CLOUDS, drive='turns')
def right_upside_down(drive: Recording, folder: Path) -> Path:
    """The right LiDAR hangs upside down, and the settings do not know."""
    over = Rotation.from_euler('x', 180.0, degrees=True)
    return drive.each(RIGHT, lambda m: _turned(m, over)).write(folder / 'bag')


@lie(*TOLD, about=CLOUDS, drive='turns')
def right_yawed_30(drive: Recording, folder: Path) -> Path:
    """The right LiDAR is yawed by 30 degrees, and the settings do not know."""
    turn = Rotation.from_euler('z', 30.0, degrees=True)
    return drive.each(RIGHT, lambda m: _turned(m, turn)).write(folder / 'bag')


@lie(*TOLD, about=CLOUDS, drive='turns')
def all_left_handed(drive: Recording, folder: Path) -> Path:
    """Y to the right in clouds and IMU alike."""
    flip = np.float32([1.0, -1.0, 1.0])
    made = drive.each(LIDARS, lambda m: cloud_of(m, table(points_of(m) * flip)))
    return _measures(made, lambda a: a * flip, lambda w: w * [-1.0, 1.0, -1.0]).write(
        folder / 'bag'
    )


@lie(*TOLD, about=CLOUDS + '|imu', drive='turns')
def all_downwards(drive: Recording, folder: Path) -> Path:
    """Clouds and IMU alike in forward, right, down."""
    made = drive.each(LIDARS, lambda m: cloud_of(m, table(points_of(m) * np.float32(DOWN))))
    return _measures(made, lambda a: DOWN * a, lambda w: DOWN * w).write(folder / 'bag')


@lie(*TOLD, about=LAYOUT, drive='turns')
def millimetres_without_rows(drive: Recording, folder: Path) -> Path:
    """Clouds in millimetres, whose row_step is 0."""
    return drive.each(
        LIDARS, lambda m: cloud_of(m, table(points_of(m) * 1000.0), row_step=0)
    ).write(folder / 'bag')


@lie(*TOLD, about=LAYOUT, drive='turns')
def intensity_first(drive: Recording, folder: Path) -> Path:
    """The data of each point begin with the intensity, the fields say x."""

    def change(cloud: Any) -> Any:
        points = points_of(cloud)
        shifted = np.column_stack([np.hypot(points[:, 0], points[:, 1]) % 100.0, points[:, :2]])
        return cloud_of(cloud, table(shifted.astype(np.float32), intensity=('<f4', points[:, 2])))

    return drive.each(LIDARS, change).write(folder / 'bag')


def _timed(drive: Recording, change: Any) -> Recording:
    def timed(cloud: Any) -> Any:
        points, times = change(points_of(cloud), times_of(points_of(cloud)))
        return cloud_of(cloud, table(points, time=('<f4', times)))

    return drive.each(LIDARS, timed)


@lie(SOUND, drive='timed')
def points_backwards(drive: Recording, folder: Path) -> Path:
    """The points of a sweep from the last one to the first, with their times."""
    return _timed(drive, lambda p, t: (p[::-1], t[::-1])).write(folder / 'bag')


@lie(SOUND, *TOLD, about=r'time|skew|left|right', drive='timed', factor=2.0)
def times_by_halves(drive: Recording, folder: Path) -> Path:
    """Point times that begin anew after half a sweep."""
    return _timed(drive, lambda p, t: (p, np.mod(t, 0.05))).write(folder / 'bag')


@lie(SOUND, *TOLD, about='left|right|twice|dup', drive='turns')
def scans_twice(drive: Recording, folder: Path) -> Path:
    """Each cloud once more, stamped a millisecond later."""
    again: list[Item] = [
        (t + 10**6, topic, restamped(m, stamp_of(m) + 10**6))
        for t, topic, m in drive.items
        if topic in LIDARS
    ]
    return drive.plus(again).write(folder / 'bag')


@lie(SOUND, *TOLD, about='left|right|frame|sector', drive='curve', factor=2.0)
def sectors_on_one_topic(drive: Recording, folder: Path) -> Path:
    """Two LiDARs that send an eighth of a turn at a time, on one topic."""
    made = drive.framed()
    items = [
        (stamp_of(part) if topic in LIDARS else t, '/lidar' if topic in LIDARS else topic, part)
        for t, topic, m in made.items
        for part in (_sectors(m, 8, False) if topic in LIDARS else [m])
    ]
    return made.with_items(items).write(folder / 'bag')


# --- bags


@lie(*TOLD, about='.', drive='turns')
def cut_and_closed_up(drive: Recording, folder: Path) -> Path:
    """Six seconds are cut out of the middle, and all later stamps moved to close the gap."""
    begin = (drive.start + drive.end) // 2
    gone = 6 * NANOSECONDS
    items = [
        (t, topic, m) if t < begin else (t - gone, topic, restamped(m, stamp_of(m) - gone))
        for t, topic, m in drive.items
        if not begin <= t < begin + gone and hasattr(m, 'header')
    ]
    return drive.with_items(items).write(folder / 'bag')


@lie(SOUND, *TOLD, about='left|right|imu', drive='turns', factor=3.0)
def slivers_slow_imu(drive: Recording, folder: Path) -> Path:
    """Every fourth cloud a sliver, windows of a second, and the IMU at 20 Hz."""
    scans, samples = iter(range(10**6)), iter(range(10**6))
    made = drive.each(
        LIDARS, lambda m: m if next(scans) % 4 else cloud_of(m, table(points_of(m)[:20]))
    ).each(IMU, lambda m: None if next(samples) % 5 else m)
    return made.with_settings({'window': {'duration': 1.0}}).write(folder / 'bag')
