"""Recordings that surprise: sensors of other kinds, places and moments than expected."""

from dataclasses import replace
from functools import partial
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
    Item,
    Recording,
    cloud_of,
    matrix_of,
    numbers,
    points_of,
    restamped,
    stamp_of,
    table,
    vector,
)

MENDED, WARNED, REFUSED, SOUND = Verdict.MENDED, Verdict.WARNED, Verdict.REFUSED, Verdict.SOUND
STORE.register(
    get_types_from_msg('std_msgs/Header header\nstring sentence', 'nmea_msgs/msg/Sentence')
)


def _kept(cloud: Any, keep: Any) -> Any:
    points = points_of(cloud)
    return cloud_of(cloud, table(points[keep(points)]))


@lie(WARNED, about=r'nmea|gnss|fix')
def fixes_as_sentences(drive: Recording, folder: Path) -> Path:
    """The receiver's NMEA sentences instead of fixes."""
    sentence = STORE.types['nmea_msgs/msg/Sentence']
    made = drive.framed()
    items: list[Item] = [
        (t, '/nmea_sentence', sentence(header=m.header, sentence='$GPGGA,,,,,,0,,,,,,,,*66'))
        if topic == FIX
        else (t, topic, m)
        for t, topic, m in made.items
    ]
    return made.with_items(items).write(folder / 'bag')


@lie(SOUND, MENDED, WARNED, about=r'gps|fix|gnss', drive='turns')
def second_receiver_first(drive: Recording, folder: Path) -> Path:
    """Two receivers on two topics: the one that comes first by name is 8 m off and never fixed."""
    made = drive.framed()
    other = [
        (
            t,
            '/a_gps/fix',
            replace(m, latitude=m.latitude + 8e-5, status=replace(m.status, status=-1)),
        )
        for t, topic, m in made.items
        if topic == FIX
    ]
    return made.plus(other).write(folder / 'bag')


@lie(SOUND, MENDED, WARNED, about=r'gps|fix|gnss', drive='turns')
def worse_receiver_beside(drive: Recording, folder: Path) -> Path:
    """Two receivers on two topics: a cheap one at 5 Hz that wanders by metres, and the good one."""
    made = drive.framed()
    fixes = made.of(FIX)
    stamps = np.array([stamp_of(m) for m in fixes])
    random = np.random.default_rng(5)
    walk = np.cumsum(random.normal(0.0, 1.0, (5 * len(fixes), 2)), axis=0) * 1e-5
    other = []
    for number in range(5 * len(fixes)):
        t = int(stamps[0] + number * NANOSECONDS // 5)
        near = fixes[int(np.abs(stamps - t).argmin())]
        lat = float(np.interp(t, stamps, [m.latitude for m in fixes])) + walk[number, 0]
        lon = float(np.interp(t, stamps, [m.longitude for m in fixes])) + walk[number, 1]
        cov = np.diag([9.0, 9.0, 36.0]).ravel()
        cheap = replace(near, latitude=lat, longitude=lon, position_covariance=cov)
        other.append((t, '/a_cheap/fix', restamped(cheap, t)))
    return made.plus(other).write(folder / 'bag')


@lie(MENDED, WARNED, about=r'left|right|lidar', drive='turns')
def lidars_step_a_little(drive: Recording, folder: Path) -> Path:
    """The LiDARs' clock is set 0.3 s forward in the middle."""
    middle = (drive.start + drive.end) // 2
    return drive.each(
        LIDARS,
        lambda m: restamped(m, stamp_of(m) + 3 * NANOSECONDS // 10) if stamp_of(m) > middle else m,
    ).write(folder / 'bag')


@lie(MENDED, WARNED, about=r'imu', drive='turns')
def imu_counter_wraps(drive: Recording, folder: Path) -> Path:
    """The IMU's counter of microseconds, 32 bits wide, wraps in the middle."""
    middle = (drive.start + drive.end) // 2
    wrap = 2**32 * 1000
    return drive.each(
        IMU, lambda m: restamped(m, stamp_of(m) - wrap) if stamp_of(m) > middle else m
    ).write(folder / 'bag')


@lie(MENDED, WARNED, about=r'imu', drive='turns')
def imu_second_lost(drive: Recording, folder: Path) -> Path:
    """The IMU's clock jumps by a whole second in the middle, as over a leap second."""
    middle = (drive.start + drive.end) // 2
    return drive.each(
        IMU, lambda m: restamped(m, stamp_of(m) - NANOSECONDS) if stamp_of(m) > middle else m
    ).write(folder / 'bag')


@lie(SOUND, MENDED, WARNED, about=r'left|right|own|self', drive='turns', factor=2.0)
def own_roof(drive: Recording, folder: Path) -> Path:
    """Half of the points of each cloud are of the car's own roof, 2 m away."""
    random = np.random.default_rng(3)
    side = random.uniform([-2.5, -1.0, -0.6], [2.5, 1.0, -0.5], (4000, 3)).astype(np.float32)
    side = side[np.linalg.norm(side[:, :2], axis=1) > 1.6]

    def seen(cloud: Any) -> Any:
        points = points_of(cloud)
        roof = side[random.choice(len(side), len(points))]
        roof = roof + random.normal(0.0, 0.01, roof.shape).astype(np.float32)
        return cloud_of(cloud, table(np.concatenate([points, roof]).astype(np.float32)))

    return drive.each(LIDARS, seen).write(folder / 'bag')


@lie(WARNED, MENDED, about=r'left|right|lidar|jitter', drive='turns')
def clouds_on_arrival(drive: Recording, folder: Path) -> Path:
    """Clouds stamped on arrival: 20 ms of jitter, 30 ms late."""
    random = np.random.default_rng(4)

    def arrived(cloud: Any) -> Any:
        return restamped(cloud, stamp_of(cloud) + int(1e9 * (0.01 + random.exponential(0.02))))

    return drive.each(LIDARS, arrived).write(folder / 'bag')


@lie(SOUND, WARNED, about=r'left|right', drive='turns', factor=3.0, share=0.1)
def looking_ahead(drive: Recording, folder: Path) -> Path:
    """LiDARs that see 90 degrees ahead only."""
    return drive.each(
        LIDARS, lambda m: _kept(m, lambda p: np.abs(np.arctan2(p[:, 1], p[:, 0])) < np.pi / 4)
    ).write(folder / 'bag')


@lie(WARNED, REFUSED, SOUND, about=r'left|right', drive='turns', factor=3.0)
def one_beam(drive: Recording, folder: Path) -> Path:
    """Clouds of a single beam each, as of planar scanners."""

    def beam(points: Any) -> Any:
        slope = points[:, 2] / np.linalg.norm(points[:, :2], axis=1)
        return np.abs(slope - np.tan(np.radians(1.0))) < 0.005

    return drive.each(LIDARS, lambda m: _kept(m, beam)).write(folder / 'bag')


@lie(WARNED, REFUSED, about=r'left|right|overlap|imu', drive='street')
def never_together(drive: Recording, folder: Path) -> Path:
    """IMU and fixes of the first half, clouds of the second."""
    middle = (drive.start + drive.end) // 2
    items = [i for i in drive.items if (i[1] in LIDARS) == (i[0] > middle)]
    return drive.with_items(items).write(folder / 'bag')


@lie(SOUND, MENDED, WARNED, about=r'imu', drive='turns', factor=2.0)
def imu_starts_late(drive: Recording, folder: Path) -> Path:
    """The IMU starts 8 s after the LiDARs."""
    until = drive.start + 8 * NANOSECONDS
    return drive.each(IMU, lambda m: m if stamp_of(m) > until else None).write(folder / 'bag')


@lie(SOUND, drive='turns')
def nan_intensities(drive: Recording, folder: Path) -> Path:
    """Intensities that are NaN, infinite, or absurd."""

    def changed(cloud: Any) -> Any:
        points = points_of(cloud)
        values = np.resize(np.array([np.nan, np.inf, -np.inf, 1e38, 5.0], '<f4'), len(points))
        return cloud_of(cloud, table(points, intensity=('<f4', values)))

    return drive.each(LIDARS, changed).write(folder / 'bag')


@lie(MENDED, WARNED, REFUSED, about=r'scan|PointCloud2', drive='street')
def planar_scans(drive: Recording, folder: Path) -> Path:
    """LaserScan messages instead of clouds."""
    kind = TYPES['sensor_msgs/msg/LaserScan']
    ranges = np.full(360, 5.0, dtype=np.float32)
    items = [
        (
            t,
            topic,
            kind(m.header, -3.14, 3.14, 0.0175, 0.0, 0.1, 0.1, 30.0, ranges, ranges),
        )
        if topic in (LEFT, RIGHT)
        else (t, topic, m)
        for t, topic, m in drive.items
    ]
    return drive.with_items(items).write(folder / 'bag')


@lie(SOUND, MENDED, WARNED, about=r'left|right', drive='turns', factor=2.0)
def half_the_rate(drive: Recording, folder: Path) -> Path:
    """The LiDARs change from 10 Hz to 5 Hz in the middle."""
    middle = (drive.start + drive.end) // 2
    count = iter(range(10**6))
    return drive.each(
        LIDARS, lambda m: None if stamp_of(m) > middle and next(count) % 4 > 1 else m
    ).write(folder / 'bag')


@lie(SOUND, MENDED, WARNED, about=r'gnss|fix', drive='turns', factor=10.0)
def float_solution(drive: Recording, folder: Path) -> Path:
    """A receiver that loses its fixed solution: half of the fixes 1 m off, and said to be so."""
    middle = (drive.start + drive.end) // 2

    def floating(fix: Any) -> Any:
        if stamp_of(fix) < middle:
            return fix
        cov = np.diag([1.0, 1.0, 4.0]).ravel()
        return replace(
            fix,
            latitude=fix.latitude + 8e-6,
            longitude=fix.longitude - 6e-6,
            position_covariance=cov,
        )

    return drive.each(FIX, floating).write(folder / 'bag')


@lie(SOUND, MENDED, WARNED, about=r'gnss|fix', drive='turns', factor=3.0)
def long_outage(drive: Recording, folder: Path) -> Path:
    """No fixes from a third of the drive to its end but the last one."""
    first = drive.start + (drive.end - drive.start) // 3
    last = stamp_of(drive.of(FIX)[-1])
    return drive.each(
        FIX, lambda m: m if stamp_of(m) < first or stamp_of(m) == last else None
    ).write(folder / 'bag')


@lie(WARNED, MENDED, REFUSED, about=r'imu', drive='turns')
def imu_upside_down_midway(drive: Recording, folder: Path) -> Path:
    """The IMU is remounted upside down in the middle."""
    middle = (drive.start + drive.end) // 2

    def turned(sample: Any) -> Any:
        if stamp_of(sample) < middle:
            return sample
        rates, force = numbers(sample.angular_velocity), numbers(sample.linear_acceleration)
        over = np.array([1.0, -1.0, -1.0])
        return replace(
            sample, angular_velocity=vector(over * rates), linear_acceleration=vector(over * force)
        )

    return drive.each(IMU, turned).write(folder / 'bag')


@lie(SOUND, MENDED, WARNED, about=r'imu', drive='turns', factor=2.0)
def noisy_imu(drive: Recording, folder: Path) -> Path:
    """A cheap IMU on an engine: accelerations scatter by 3 m/s^2, rates by 3 deg/s."""
    random = np.random.default_rng(6)

    def shaken(sample: Any) -> Any:
        return replace(
            sample,
            angular_velocity=vector(
                numbers(sample.angular_velocity) + random.normal(0.0, np.radians(3.0), 3)
            ),
            linear_acceleration=vector(
                numbers(sample.linear_acceleration) + random.normal(0.0, 3.0, 3)
            ),
        )

    return drive.each(IMU, shaken).write(folder / 'bag')


@lie(SOUND, MENDED, WARNED, about=r'imu', drive='turns', factor=2.0)
def imu_slow_clock(drive: Recording, folder: Path) -> Path:
    """Samples of the IMU carry the time at which a buffer of ten was read."""
    stamps = [stamp_of(m) for m in drive.of(IMU)]
    count = iter(range(10**7))
    return drive.each(
        IMU, lambda m: restamped(m, stamps[min(10 * (next(count) // 10) + 9, len(stamps) - 1)])
    ).write(folder / 'bag')


@lie(SOUND, MENDED, WARNED, about=r'left|right|moves', drive='turns')
def passing_crowd(drive: Recording, folder: Path) -> Path:
    """A lorry drives along at the right side: a third of the points move with the car."""
    random = np.random.default_rng(7)
    wall = np.stack(
        [
            random.uniform(-6.0, 6.0, 6000),
            np.full(6000, -3.0),
            random.uniform(-1.5, 2.0, 6000),
        ],
        axis=1,
    )
    frames = {LEFT: 'left', RIGHT: 'right'}
    places = {
        topic: np.linalg.inv(matrix_of(drive.settings['lidars'][name]['T_base_sensor']))
        for topic, name in frames.items()
    }

    def beside(cloud: Any, T_sensor_base: Any) -> Any:
        points = points_of(cloud)
        seen = wall[random.choice(len(wall), len(points) // 2)]
        seen = seen @ T_sensor_base[:3, :3].T + T_sensor_base[:3, 3]
        return cloud_of(cloud, table(np.concatenate([points, seen]).astype(np.float32)))

    made = drive
    for topic, place in places.items():
        made = made.each(topic, partial(beside, T_sensor_base=place))
    return made.write(folder / 'bag')
