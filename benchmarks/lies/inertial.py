"""IMUs that do not measure what a message says: units, gravity, axes, dead ones."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.measurements import NANOSECONDS
from lies.lie import Verdict, lie
from lies.recording import (
    IMU,
    TRUTH,
    Recording,
    matrix_of,
    numbers,
    setting_of,
    stamp_of,
    vector,
)

Array = NDArray[np.float64]
MENDED, WARNED, REFUSED, SOUND = Verdict.MENDED, Verdict.WARNED, Verdict.REFUSED, Verdict.SOUND
GRAVITY = 9.80665


def _measuring(
    drive: Recording,
    acceleration: Callable[[Array], Array] = lambda a: a,
    rate: Callable[[Array], Array] = lambda w: w,
) -> Recording:
    """A drive whose IMU measures something else, and tells no orientation."""

    def change(message: Any) -> Any:
        return replace(
            message,
            linear_acceleration=vector(acceleration(numbers(message.linear_acceleration))),
            angular_velocity=vector(rate(numbers(message.angular_velocity))),
            orientation_covariance=np.array([-1.0, *[0.0] * 8]),
        )

    return drive.each(IMU, change)


@lie(MENDED, about=r'imu', drive='curve')
def degrees(drive: Recording, folder: Path) -> Path:
    """Rates in degrees per second."""
    return _measuring(drive, rate=np.degrees).write(folder / 'bag')


@lie(MENDED, WARNED, about=r'imu')
def degrees_straight(drive: Recording, folder: Path) -> Path:
    """Rates in degrees per second on a straight road."""
    return _measuring(drive, rate=np.degrees).write(folder / 'bag')


@lie(MENDED, about=r'imu', drive='start')
def in_g_start(drive: Recording, folder: Path) -> Path:
    """Accelerations in g while driving off."""
    return _measuring(drive, lambda a: a / GRAVITY).write(folder / 'bag')


@lie(MENDED, about=r'imu', drive='curve')
def in_milli_g(drive: Recording, folder: Path) -> Path:
    """Accelerations in thousandths of g."""
    return _measuring(drive, lambda a: a * 1000.0 / GRAVITY).write(folder / 'bag')


@lie(MENDED, about=r'imu', drive='curve')
def in_g_and_degrees(drive: Recording, folder: Path) -> Path:
    """Accelerations in g and rates in degrees per second."""
    return _measuring(drive, lambda a: a / GRAVITY, np.degrees).write(folder / 'bag')


@lie(MENDED, WARNED, about=r'imu', drive='curve')
def no_gravity(drive: Recording, folder: Path) -> Path:
    """Gravity already taken out."""
    return _measuring(drive, lambda a: a - [0.0, 0.0, GRAVITY]).write(folder / 'bag')


@lie(
    MENDED,
    WARNED,
    about=r'imu',
    drive='curve',
)
def negative_gravity(drive: Recording, folder: Path) -> Path:
    """Accelerometer with the opposite sign, -9.8 upwards at rest."""
    return _measuring(drive, lambda a: -a).write(folder / 'bag')


def _turned(drive: Recording, rotation: list[list[float]]) -> Recording:
    """An IMU mounted otherwise than its extrinsics say."""
    turn = np.array(rotation, dtype=float)
    return _measuring(drive, lambda a: turn @ a, lambda w: turn @ w)


@lie(MENDED, WARNED, about=r'imu', drive='curve')
def axes_down(drive: Recording, folder: Path) -> Path:
    """IMU with axes forward, right, down."""
    return _turned(drive, [[1, 0, 0], [0, -1, 0], [0, 0, -1]]).write(folder / 'bag')


@lie(MENDED, WARNED, about=r'imu', drive='curve')
def axes_yawed(drive: Recording, folder: Path) -> Path:
    """IMU turned by 90 degrees about its upward axis."""
    return _turned(drive, [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]).write(folder / 'bag')


@lie(MENDED, WARNED, about=r'imu', drive='curve')
def axes_sideways(drive: Recording, folder: Path) -> Path:
    """IMU on its side, gravity on y."""
    return _turned(drive, [[1, 0, 0], [0, 0, 1], [0, -1, 0]]).write(folder / 'bag')


@lie(SOUND, MENDED, WARNED, about=r'imu', drive='curve')
def yaw_rate_mirrored(drive: Recording, folder: Path) -> Path:
    """Only the sign of the yaw rate is wrong, on a road that hardly turns.

    A sign shows over bends alone (``yaw_rate_mirrored_turns``); here it must do no harm.
    """
    return _measuring(drive, rate=lambda w: w * [1.0, 1.0, -1.0]).write(folder / 'bag')


@lie(MENDED, WARNED, about=r'imu', drive='curve')
def dead_gyro(drive: Recording, folder: Path) -> Path:
    """Gyroscope says nothing but zeros."""
    return _measuring(drive, rate=lambda w: 0.0 * w).write(folder / 'bag')


@lie(MENDED, WARNED, about=r'imu', drive='curve')
def dead_imu(drive: Recording, folder: Path) -> Path:
    """The whole IMU says nothing but zeros."""
    return _measuring(drive, lambda a: 0.0 * a, lambda w: 0.0 * w).write(folder / 'bag')


@lie(MENDED, WARNED, about=r'imu', drive='curve')
def frozen_imu(drive: Recording, folder: Path) -> Path:
    """IMU frozen from the second second on."""
    until = stamp_of(drive.of(IMU)[0]) + 2 * NANOSECONDS
    last = [m for m in drive.of(IMU) if stamp_of(m) < until][-1]

    def change(message: Any) -> Any:
        return message if stamp_of(message) < until else replace(last, header=message.header)

    return drive.each(IMU, change).write(folder / 'bag')


@lie(
    MENDED,
    WARNED,
    about=r'imu',
    drive='curve',
)
def two_imus(drive: Recording, folder: Path) -> Path:
    """Two IMUs: one that says zeros twice as often, and the real one."""
    framed = drive.framed().renamed(IMU, '/xsens/data')
    zero = vector([0.0, 0.0, 0.0])
    dead = [
        (t + half, '/camera/imu', replace(m, linear_acceleration=zero, angular_velocity=zero))
        for t, topic, m in framed.items
        if topic == '/xsens/data'
        for half in (0, 5_000_000)
    ]
    return framed.plus(dead).write(folder / 'bag')


@lie(
    MENDED,
    WARNED,
    SOUND,
    about=r'imu',
    drive='curve',
)
def spikes(drive: Recording, folder: Path) -> Path:
    """Every fiftieth acceleration and rate is 10^6."""
    count = {'n': 0}

    def change(message: Any) -> Any:
        count['n'] += 1
        wild = vector([1e6, -1e6, 1e6])
        if count['n'] % 50:
            return message
        return replace(message, linear_acceleration=wild, angular_velocity=wild)

    return drive.each(IMU, change).write(folder / 'bag')


@lie(SOUND, WARNED, about=r'imu', drive='curve', factor=3.0)
def imu_hole(drive: Recording, folder: Path) -> Path:
    """IMU without 2 s in the bend."""
    begin = stamp_of(drive.of(IMU)[0]) + round(1.5 * NANOSECONDS)
    inside = range(begin, begin + 2 * NANOSECONDS)
    return drive.each(IMU, lambda m: None if stamp_of(m) in inside else m).write(folder / 'bag')


@lie(SOUND, WARNED, about=r'imu', drive='curve', factor=3.0)
def imu_10_hz(drive: Recording, folder: Path) -> Path:
    """IMU at 10 Hz."""
    count = {'n': 0}

    def change(message: Any) -> Any:
        count['n'] += 1
        return None if count['n'] % 10 else message

    return drive.each(IMU, change).write(folder / 'bag')


@lie(SOUND, drive='curve')
def upside_down_known(drive: Recording, folder: Path) -> Path:
    """IMU upside down, which the settings know."""
    turned = _turned(drive, [[1, 0, 0], [0, -1, 0], [0, 0, -1]])
    pose = matrix_of(drive.settings['imu']['T_base_sensor'])
    pose[:3, :3] = pose[:3, :3] @ np.diag([1.0, -1.0, -1.0])
    return turned.with_settings({'imu': {'T_base_sensor': setting_of(pose)}}).write(folder / 'bag')


@lie(WARNED, about=r'imu|gnss')
def lidars_alone(drive: Recording, folder: Path) -> Path:
    """No IMU and no fixes at all, which the settings name."""
    kept = [item for item in drive.items if item[1].startswith('/points') or item[1] == TRUTH]
    return drive.with_items(kept).write(folder / 'bag')


@lie(MENDED, WARNED, about=r'imu', drive='turns')
def no_gravity_tilted(drive: Recording, folder: Path) -> Path:
    """Gravity taken out, and the IMU rolled by 25 degrees on its mount."""
    made = _measuring(drive, lambda a: a - [0.0, 0.0, GRAVITY])
    cosine, sine = np.cos(np.radians(25.0)), np.sin(np.radians(25.0))
    return _turned(made, [[1, 0, 0], [0, cosine, sine], [0, -sine, cosine]]).write(folder / 'bag')


@lie(MENDED, WARNED, about=r'imu', drive='turns')
def rates_halved(drive: Recording, folder: Path) -> Path:
    """Rates half as large as they are, as of a wrong full scale."""
    return _measuring(drive, rate=lambda w: 0.5 * w).write(folder / 'bag')


@lie(MENDED, WARNED, about=r'imu', drive='turns')
def accelerations_doubled(drive: Recording, folder: Path) -> Path:
    """Accelerations twice as large, as of a wrong full scale."""
    return _measuring(drive, lambda a: 2.0 * a).write(folder / 'bag')


@lie(MENDED, WARNED, SOUND, about=r'imu', drive='turns', factor=2.0)
def gyro_biased(drive: Recording, folder: Path) -> Path:
    """A bias of 3 deg/s on the yaw rate."""
    return _measuring(drive, rate=lambda w: w + np.radians([0.0, 0.0, 3.0])).write(folder / 'bag')


@lie(MENDED, WARNED, about=r'imu', drive='turns')
def gyro_axes_apart(drive: Recording, folder: Path) -> Path:
    """Axes of the gyroscope alone exchanged: its yaw rate stands on y."""
    swap = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])
    return _measuring(drive, rate=lambda w: swap @ w).write(folder / 'bag')


@lie(MENDED, WARNED, about=r'imu', drive='turns')
def left_handed(drive: Recording, folder: Path) -> Path:
    """Left-handed IMU: y to the right in both, and the yaw rate clockwise."""
    return _measuring(drive, lambda a: a * [1, -1, 1], lambda w: w * [-1, 1, -1]).write(
        folder / 'bag'
    )


@lie(MENDED, WARNED, about=r'imu', drive='turns')
def yaw_rate_mirrored_turns(drive: Recording, folder: Path) -> Path:
    """Only the sign of the yaw rate is wrong, over bends."""
    return _measuring(drive, rate=lambda w: w * [1.0, 1.0, -1.0]).write(folder / 'bag')


@lie(MENDED, WARNED, about=r'imu', drive='turns')
def axes_yawed_turns(drive: Recording, folder: Path) -> Path:
    """IMU turned by 90 degrees about its upward axis, over bends."""
    return _turned(drive, [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]).write(folder / 'bag')


@lie(MENDED, WARNED, about=r'imu', drive='turns')
def gyro_dies(drive: Recording, folder: Path) -> Path:
    """The gyroscope says zeros after a third of the drive, the accelerometer lives."""
    until = drive.start + (drive.end - drive.start) // 3
    zero = vector([0.0, 0.0, 0.0])
    return drive.each(
        IMU, lambda m: m if stamp_of(m) < until else replace(m, angular_velocity=zero)
    ).write(folder / 'bag')


@lie(MENDED, WARNED, SOUND, about=r'imu', drive='turns')
def one_upside_down(drive: Recording, folder: Path) -> Path:
    """Two IMUs: one upside down without a transform, and the real one with one."""
    framed = drive.framed().renamed(IMU, '/xsens/data')
    down = np.array([[1.0, 0, 0], [0, -1.0, 0], [0, 0, -1.0]])
    other = [
        (
            t,
            '/camera/imu',
            replace(
                m,
                header=replace(m.header, frame_id='camera_imu'),
                linear_acceleration=vector(down @ numbers(m.linear_acceleration)),
                angular_velocity=vector(down @ numbers(m.angular_velocity)),
            ),
        )
        for t, topic, m in framed.items
        if topic == '/xsens/data'
    ]
    return framed.plus(other).write(folder / 'bag')


@lie(MENDED, WARNED, about=r'imu', drive='turns')
def swapped_vectors(drive: Recording, folder: Path) -> Path:
    """Rates where the accelerations should be, and accelerations where the rates should be."""
    return drive.each(
        IMU,
        lambda m: replace(
            m, linear_acceleration=m.angular_velocity, angular_velocity=m.linear_acceleration
        ),
    ).write(folder / 'bag')
