"""IMUs with two faults at once, or of conventions that a driver did not convert."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lies.inertial import GRAVITY, Array, _measuring, _turned
from lies.lie import Verdict, lie
from lies.recording import (
    IMU,
    Recording,
    matrix_of,
    numbers,
    restamped,
    setting_of,
    stamp_of,
    vector,
)

MENDED, WARNED, SOUND = Verdict.MENDED, Verdict.WARNED, Verdict.SOUND
UP = np.array([0.0, 0.0, GRAVITY])
Change = Callable[[Array], Array]


def _same(value: Array) -> Array:
    return value


def _down(value: Array) -> Array:
    """From forward, left, up to forward, right, down."""
    return value * [1.0, -1.0, -1.0]


def _both(name: str, text: str, acceleration: Change, rate: Change, *more: Verdict) -> None:
    """Enter one on a road that hardly turns, and one over bends."""
    for drive, where in (('curve', ''), ('turns', ', over bends')):

        def make(recording: Recording, folder: Path) -> Path:
            return _measuring(recording, acceleration, rate).write(folder / 'bag')

        make.__name__ = name + ('_turns' if where else '')
        make.__doc__ = f'{text}{where}.'
        lie(MENDED, WARNED, *more, about=r'imu', drive=drive)(make)


_both('mg_and_deg', 'In mg and deg/s', lambda a: a * 1e3 / GRAVITY, np.degrees)
_both('deg_no_gravity', 'In deg/s, and gravity taken out', lambda a: a - UP, np.degrees)
_both('deg_downwards', 'In deg/s, axes forward, right, down', _down, lambda w: np.degrees(_down(w)))
_both(
    'ned_gravity', 'Axes forward, right, down, and gravity counted down', lambda a: -_down(a), _down
)
_both('exchanged_axes', 'X and y exchanged', lambda a: a[[1, 0, 2]], lambda w: w[[1, 0, 2]])
_both('exchanged_gyro', 'X and y of the gyroscope exchanged', _same, lambda w: w[[1, 0, 2]])
_both('rates_negative', 'All rates have the wrong sign', _same, lambda w: -w)
_both('turns_a_minute', 'Rates in turns a minute', _same, lambda w: w * 30.0 / np.pi)
_both('centidegrees', 'Rates in hundredths of deg/s', _same, lambda w: 100.0 * np.degrees(w))
_both(
    'raw_counts',
    'Raw counts: 16384 a g, 131 a degree per second',
    lambda a: np.round(a * 16384.0 / GRAVITY),
    lambda w: np.round(131.0 * np.degrees(w)),
)
_both('imu_in_feet', 'Accelerations in feet/s^2', lambda a: a / 0.3048, _same)
_both(
    'coarse_imu',
    'Rates in steps of 1 deg/s, accelerations in steps of 0.1 g',
    lambda a: np.round(a / GRAVITY, 1) * GRAVITY,
    lambda w: np.radians(np.round(np.degrees(w))),
    SOUND,
)
_both('gravity_doubled', 'Gravity taken out with the wrong sign', lambda a: a + UP, _same)
_both('rates_nan', 'Rates that are not numbers', _same, lambda w: w * np.nan)
_both('backwards_imu', 'Mounted backwards', lambda a: a * [-1, -1, 1], lambda w: w * [-1, -1, 1])
_both(
    'nose_up',
    'Mounted on end, x up',
    lambda a: a[[2, 1, 0]] * [1, 1, -1],
    lambda w: w[[2, 1, 0]] * [1, 1, -1],
)


@lie(MENDED, WARNED, about=r'imu', drive='turns')
def deg_and_late(drive: Recording, folder: Path) -> Path:
    """Rates in deg/s, 0.2 s late."""
    return _measuring(drive.shifted(IMU, 0.2), rate=np.degrees).write(folder / 'bag')


@lie(MENDED, WARNED, about=r'imu', drive='turns')
def imu_inverted(drive: Recording, folder: Path) -> Path:
    """IMU on its side, and its extrinsics the other way round."""
    side = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    pose = matrix_of(drive.settings['imu']['T_base_sensor'])
    pose[:3, :3] = pose[:3, :3] @ np.array(side)
    made = _turned(drive, [[float(value) for value in row] for row in side])
    return made.with_settings({'imu': {'T_base_sensor': setting_of(pose)}}).write(folder / 'bag')


@lie(SOUND, MENDED, WARNED, about=r'imu', drive='turns')
def imu_1000_hz(drive: Recording, folder: Path) -> Path:
    """IMU at 1000 Hz whose samples come in bursts of ten."""
    rng = np.random.default_rng(4)
    made = list(drive.items)
    for logged, topic, message in drive.items:
        for number in range(1, 10) if topic == IMU else ():
            force = numbers(message.linear_acceleration) + rng.normal(scale=0.05, size=3)
            rate = numbers(message.angular_velocity) + rng.normal(scale=0.002, size=3)
            sample = replace(
                message, linear_acceleration=vector(force), angular_velocity=vector(rate)
            )
            stamp = stamp_of(message) + number * 1_000_000
            made.append((logged + number, topic, restamped(sample, stamp)))
    return drive.with_items(made).write(folder / 'bag')


@lie(MENDED, WARNED, about=r'imu', drive='turns')
def slow_filter(drive: Recording, folder: Path) -> Path:
    """Rates and accelerations through a filter that delays them by 0.15 s."""
    state: list[Array] = []

    def change(message: Any) -> Any:
        now = np.stack([numbers(message.linear_acceleration), numbers(message.angular_velocity)])
        state[:] = [state[0] + 0.065 * (now - state[0]) if state else now]
        force, rate = state[0]
        return replace(message, linear_acceleration=vector(force), angular_velocity=vector(rate))

    return drive.each(IMU, change).write(folder / 'bag')
