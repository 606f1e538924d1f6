"""Sensors, mounts and drivers that are at fault themselves, and say nothing of it."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from incremental_mapper.measurements import NANOSECONDS
from lies.lie import Verdict, lie
from lies.recording import (
    FIX,
    IMU,
    LEFT,
    LIDARS,
    RIGHT,
    Item,
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


def _turned(cloud: Any, rotation: Rotation) -> Any:
    points = rotation.apply(points_of(cloud)).astype(np.float32)
    return cloud_of(cloud, table(points))


@lie(WARNED, MENDED, REFUSED, about=r'left|right|lidar|ground|extrinsics', drive='turns')
def lidars_upside_down(drive: Recording, folder: Path) -> Path:
    """Both LiDARs hang upside down, and the settings do not know."""
    over = Rotation.from_euler('x', 180.0, degrees=True)
    return drive.each(LIDARS, lambda m: _turned(m, over)).write(folder / 'bag')


@lie(WARNED, MENDED, about=r'left|right|lidar', drive='turns')
def mount_slips(drive: Recording, folder: Path) -> Path:
    """The left LiDAR's mount slips by 8 degrees of yaw in the middle."""
    middle = (drive.start + drive.end) // 2
    slip = Rotation.from_euler('z', 8.0, degrees=True)
    return drive.each(LEFT, lambda m: _turned(m, slip) if stamp_of(m) > middle else m).write(
        folder / 'bag'
    )


@lie(WARNED, MENDED, about=r'left|right|lidar', drive='turns')
def ranges_of_one(drive: Recording, folder: Path) -> Path:
    """Ranges of the right LiDAR 10 per cent too long."""
    return drive.each(RIGHT, lambda m: cloud_of(m, table(points_of(m) * 1.1))).write(folder / 'bag')


@lie(SOUND, MENDED, WARNED, about=r'left|right|sector|stamp')
def half_clouds(drive: Recording, folder: Path) -> Path:
    """Every sweep comes in two clouds of the same stamp, front and back."""
    items: list[Item] = []
    for logged, topic, message in drive.items:
        if topic not in LIDARS:
            items.append((logged, topic, message))
            continue
        points = points_of(message)
        front = points[:, 0] > 0.0
        items += [(logged, topic, cloud_of(message, table(points[p]))) for p in (front, ~front)]
    return drive.with_items(items).write(folder / 'bag')


@lie(WARNED, MENDED, about=r'imu', drive='turns')
def gyro_saturates(drive: Recording, folder: Path) -> Path:
    """The gyroscope clips at 5 degrees per second, over bends."""
    most = np.radians(5.0)

    def change(message: Any) -> Any:
        rates = np.clip(numbers(message.angular_velocity), -most, most)
        return replace(message, angular_velocity=vector(rates))

    return drive.each(IMU, change).write(folder / 'bag')


@lie(WARNED, MENDED, about=r'imu', drive='turns')
def stuck_acceleration(drive: Recording, folder: Path) -> Path:
    """Forward acceleration stuck at 3 m/s^2."""

    def change(message: Any) -> Any:
        _, y, z = numbers(message.linear_acceleration)
        return replace(message, linear_acceleration=vector((3.0, y, z)))

    return drive.each(IMU, change).write(folder / 'bag')


@lie(SOUND, MENDED, WARNED, about=r'imu', drive='curve')
def imu_doubled(drive: Recording, folder: Path) -> Path:
    """Two drivers publish the same IMU on one topic, 1 ms apart."""
    again: list[Item] = [
        (t + 10**6, topic, restamped(m, stamp_of(m) + 10**6))
        for t, topic, m in drive.items
        if topic == IMU
    ]
    return drive.plus(again).write(folder / 'bag')


@lie(WARNED, MENDED, about=r'gnss|fix|frame', drive='turns')
def two_receivers(drive: Recording, folder: Path) -> Path:
    """A second receiver, 6 m behind, on the topic of the first, told apart by frame_id."""
    again: list[Item] = []
    for t, topic, m in drive.items:
        if topic == FIX:
            moved = replace(m, latitude=m.latitude - 6.0 / 111_000.0)
            later = restamped(moved, stamp_of(m) + NANOSECONDS // 2)
            again.append((t + NANOSECONDS // 2, topic, reframed(later, 'rear_gnss')))
    return drive.plus(again).write(folder / 'bag')


@lie(SOUND, MENDED, WARNED, about=r'gnss|fix|altitude', drive='fixes')
def altitude_zero(drive: Recording, folder: Path) -> Path:
    """A receiver of two dimensions: every altitude is 0, sure to a centimetre."""
    return drive.each(FIX, lambda m: replace(m, altitude=0.0)).write(folder / 'bag')


@lie(SOUND, WARNED, about=r'gnss|fix', drive='fixes')
def of_no_use(drive: Recording, folder: Path) -> Path:
    """Fixes that say themselves that they are a kilometre off."""

    def change(message: Any) -> Any:
        return replace(
            message,
            position_covariance=np.diag([1e6, 1e6, 1e6]).ravel(),
            position_covariance_type=2,
        )

    return drive.each(FIX, change).write(folder / 'bag')


@lie(WARNED, MENDED, REFUSED, about=r'stamp|clock|time|loop')
def simulator_restarts(drive: Recording, folder: Path) -> Path:
    """Simulated time from 0 on, and a simulator that starts again in the middle: 0 again."""
    middle = (drive.start + drive.end) // 2

    def change(message: Any) -> Any:
        stamp = stamp_of(message)
        return restamped(message, stamp - (middle if stamp > middle else drive.start) + 10**9)

    topics = {topic for _, topic, _ in drive.items}
    return drive.each(topics, change).write(folder / 'bag')


@lie(WARNED, MENDED, about=r'left|right|lidar|repeat', drive='curve')
def buffered_driver(drive: Recording, folder: Path) -> Path:
    """A driver that stamps clouds on arrival, and delivers them in bursts of five."""
    held: dict[str, int] = {}
    count: dict[str, int] = {}

    def burst(topic: str, message: Any) -> Any:
        number = count[topic] = count.get(topic, -1) + 1
        if number % 5 == 0:
            held[topic] = stamp_of(message) + 4 * 10**8
        return restamped(message, held[topic] + number % 5 * 2 * 10**6)

    items = [(t, topic, burst(topic, m) if topic in LIDARS else m) for t, topic, m in drive.items]
    return drive.with_items(items).write(folder / 'bag')


@lie(SOUND)
def thinned_rain(drive: Recording, folder: Path) -> Path:
    """Rain: six of ten points are lost, and one in fifty is a drop near by."""
    rng = np.random.default_rng(5)

    def change(cloud: Any) -> Any:
        points = points_of(cloud)
        kept = points[rng.random(len(points)) > 0.6].copy()
        drops = rng.random(len(kept)) < 0.02
        ranges = np.linalg.norm(kept, axis=1, keepdims=True)
        kept[drops] = (kept / np.maximum(ranges, 1e-3) * rng.uniform(2, 8, (len(kept), 1)))[drops]
        return cloud_of(cloud, table(kept))

    return drive.each(LIDARS, change).write(folder / 'bag')
