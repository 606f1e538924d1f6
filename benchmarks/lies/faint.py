"""Lies that leave most of a recording right: a knock, an axis, a delay, a unit that is near."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from incremental_mapper.measurements import NANOSECONDS
from lies.clouds import LAYOUT
from lies.lie import Verdict, lie
from lies.recording import (
    IMU,
    LIDARS,
    Recording,
    cloud_of,
    numbers,
    points_of,
    stamp_of,
    table,
    vector,
)

MENDED, WARNED, REFUSED, SOUND = Verdict.MENDED, Verdict.WARNED, Verdict.REFUSED, Verdict.SOUND
TOLD = (MENDED, WARNED, REFUSED)


def _rates(drive: Recording, change: Callable[[Any], Any]) -> Recording:
    return drive.each(
        IMU, lambda m: replace(m, angular_velocity=vector(change(numbers(m.angular_velocity))))
    )


def knocked(drive: Recording, force: list[float], begin: int, seconds: float) -> Recording:
    """With the IMU pushed by a force (3,), m/s^2, for a while from a stamp (ns) on."""
    inside = range(begin, begin + round(seconds * NANOSECONDS))

    def change(message: Any) -> Any:
        if stamp_of(message) not in inside:
            return message
        felt = numbers(message.linear_acceleration) + force
        return replace(message, linear_acceleration=vector(felt))

    return drive.each(IMU, change)


def _knocked(name: str, text: str, force: list[float], seconds: float) -> None:
    def make(drive: Recording, folder: Path) -> Path:
        middle = (drive.start + drive.end) // 2
        return knocked(drive, force, middle, seconds).write(folder / 'bag')

    make.__name__, make.__doc__ = name, f'{text}.'
    lie(SOUND, *TOLD, about='imu', drive='turns', factor=2.0)(make)


_knocked('knock_15_left', 'An IMU knocked to the left by 15 m/s^2, 0.2 s', [0.0, 15.0, 0.0], 0.2)
_knocked('knock_12_up', 'An IMU that is knocked up by 12 m/s^2 for 0.3 s', [0.0, 0.0, 12.0], 0.3)
_knocked('knock_20_short', 'An IMU knocked back by 20 m/s^2 for 0.1 s', [-20.0, 0.0, 0.0], 0.1)
_knocked('pushed_6', 'Acceleration 6 m/s^2 too large ahead for 0.5 s', [6.0, 0.0, 0.0], 0.5)


@lie(*TOLD, about=r'imu', drive='turns')
def gyro_xy_exchanged(drive: Recording, folder: Path) -> Path:
    """X and y of the gyroscope alone exchanged."""
    return _rates(drive, lambda w: w[[1, 0, 2]]).write(folder / 'bag')


@lie(*TOLD, SOUND, about=r'imu', drive='turns')
def rates_in_whole_degrees(drive: Recording, folder: Path) -> Path:
    """Rates in steps of 1 degree per second."""
    return _rates(drive, lambda w: np.radians(np.round(np.degrees(w)))).write(folder / 'bag')


@lie(*TOLD, about='range', drive='turns', factor=2.0)
def shell_of_two(drive: Recording, folder: Path) -> Path:
    """Beams without a return are written at 0.5 m and at 120 m."""
    rng = np.random.default_rng(3)

    def change(cloud: Any) -> Any:
        points = points_of(cloud)
        lost = rng.random(len(points)) < 0.3
        far = np.where(rng.random((len(points), 1)) < 0.5, 0.5, 120.0)
        around = rng.normal(size=(len(points), 3)) * [1.0, 1.0, 0.25]
        around *= far / np.linalg.norm(around, axis=1, keepdims=True)
        return cloud_of(cloud, table(np.where(lost[:, None], around, points).astype(np.float32)))

    return drive.each(LIDARS, change).write(folder / 'bag')


@lie(*TOLD, about='imu', drive='turns')
def imu_scaled_in_one_axis(drive: Recording, folder: Path) -> Path:
    """The yaw rate alone reads 15 per cent too much."""
    return _rates(drive, lambda w: w * [1.0, 1.0, 1.15]).write(folder / 'bag')


@lie(*TOLD, about=LAYOUT + '|distance|fix', drive='turns')
def decimetres(drive: Recording, folder: Path) -> Path:
    """X, y, z in decimetres."""
    return drive.each(LIDARS, lambda m: cloud_of(m, table(points_of(m) * 10.0))).write(
        folder / 'bag'
    )
