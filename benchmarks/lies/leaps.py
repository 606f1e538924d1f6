"""Clocks that leap, begin again, or count from elsewhere, and messages that come otherwise."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from incremental_mapper.measurements import NANOSECONDS
from lies.clocks import CLOCK, HOUR
from lies.lie import Verdict, lie
from lies.recording import FIX, IMU, LIDARS, RIGHT, Recording, restamped, stamp_of

MENDED, WARNED, REFUSED, SOUND = Verdict.MENDED, Verdict.WARNED, Verdict.REFUSED, Verdict.SOUND
HOUR_NS = 3600 * NANOSECONDS
WEEK = 7 * 24 * HOUR_NS


def _unlogged(drive: Recording) -> Recording:
    """As converters leave it that have no record times: the stamps stand in for them."""
    return drive.with_items((stamp_of(m), topic, m) for _, topic, m in drive.items)


def _nowhere(drive: Recording) -> Recording:
    """As converters leave it that have no record times: all are 0."""
    return replace(drive, items=tuple((0, topic, m) for _, topic, m in drive.items))


@lie(MENDED, WARNED, about=CLOCK)
def since_the_hour(drive: Recording, folder: Path) -> Path:
    """LiDAR stamps count from the last full hour."""
    return drive.each(LIDARS, lambda m: restamped(m, stamp_of(m) % HOUR_NS)).write(folder / 'bag')


@lie(MENDED, WARNED, about=CLOCK)
def since_the_hour_of_one(drive: Recording, folder: Path) -> Path:
    """Stamps of the right LiDAR count from the last full hour."""
    return drive.each(RIGHT, lambda m: restamped(m, stamp_of(m) % HOUR_NS)).write(folder / 'bag')


@lie(MENDED, WARNED, REFUSED, about=CLOCK)
def since_the_hour_unlogged(drive: Recording, folder: Path) -> Path:
    """LiDAR stamps count from the last full hour, and no record times."""
    made = drive.each(LIDARS, lambda m: restamped(m, stamp_of(m) % HOUR_NS))
    return _nowhere(made).write(folder / 'bag')


@lie(MENDED, WARNED, REFUSED, about=CLOCK)
def week_seconds(drive: Recording, folder: Path) -> Path:
    """Fixes carry the GPS time of the week."""
    return drive.each(FIX, lambda m: restamped(m, (stamp_of(m) + 18 * NANOSECONDS) % WEEK)).write(
        folder / 'bag'
    )


@lie(MENDED, WARNED, REFUSED, about=CLOCK)
def rollover(drive: Recording, folder: Path) -> Path:
    """A receiver whose week counter has rolled over: 1024 weeks behind."""
    return drive.shifted(FIX, -1024 * 7 * 86400.0).write(folder / 'bag')


@lie(MENDED, WARNED, REFUSED, about=CLOCK)
def rollover_unlogged(drive: Recording, folder: Path) -> Path:
    """A receiver 1024 weeks behind, and no record times."""
    return _nowhere(drive.shifted(FIX, -1024 * 7 * 86400.0)).write(folder / 'bag')


@lie(MENDED, WARNED, REFUSED, about=CLOCK)
def boot_then_ntp(drive: Recording, folder: Path) -> Path:
    """All sensors leap by the same years after 1.5 s, and no record times."""
    until = drive.start + 3 * NANOSECONDS // 2
    items = [
        (0, topic, restamped(m, stamp_of(m) - drive.start + 10**12) if t < until else m)
        for t, topic, m in drive.items
    ]
    return replace(drive, items=tuple(items)).write(folder / 'bag')


@lie(MENDED, WARNED, REFUSED, about=CLOCK, drive='turns')
def boot_then_ntp_turns(drive: Recording, folder: Path) -> Path:
    """All sensors leap by the same days after a third, and stamps for record times."""
    until = drive.start + (drive.end - drive.start) // 3
    items = [
        (t, topic, restamped(m, stamp_of(m) - 40 * 24 * HOUR_NS) if t < until else m)
        for t, topic, m in drive.items
    ]
    return _unlogged(drive.with_items(items)).write(folder / 'bag')


@lie(MENDED, WARNED, REFUSED, about=CLOCK, drive='turns')
def all_leap_back(drive: Recording, folder: Path) -> Path:
    """All sensors leap back by an hour after a half, as at the end of summer time."""
    until = drive.start + (drive.end - drive.start) // 2
    items = [
        (t, topic, m if t < until else restamped(m, stamp_of(m) - HOUR_NS))
        for t, topic, m in drive.items
    ]
    return drive.with_items(items).write(folder / 'bag')


@lie(MENDED, WARNED, REFUSED, about=CLOCK, drive='turns')
def all_leap_back_unlogged(drive: Recording, folder: Path) -> Path:
    """All sensors leap back by an hour after a half, and no record times."""
    until = drive.start + (drive.end - drive.start) // 2
    items = [
        (0, topic, m if t < until else restamped(m, stamp_of(m) - HOUR_NS))
        for t, topic, m in drive.items
    ]
    return replace(drive, items=tuple(items)).write(folder / 'bag')


@lie(MENDED, WARNED, about=CLOCK)
def lidars_hours_unlogged(drive: Recording, folder: Path) -> Path:
    """LiDARs in local time, 8 h ahead, and stamps for record times."""
    return _unlogged(drive.shifted(LIDARS, 8 * HOUR)).write(folder / 'bag')


@lie(MENDED, WARNED, about=CLOCK, drive='turns')
def imu_float32(drive: Recording, folder: Path) -> Path:
    """IMU stamps were seconds in single precision: steps of 128 s."""
    return drive.each(
        IMU, lambda m: restamped(m, int(np.float32(stamp_of(m) / NANOSECONDS)) * NANOSECONDS)
    ).write(folder / 'bag')


@lie(MENDED, WARNED, SOUND, about=CLOCK, drive='turns')
def imu_bursts(drive: Recording, folder: Path) -> Path:
    """IMU samples come and are stamped in bursts of twenty, 0.2 s each."""
    count = iter(range(10**6))
    last = {'stamp': 0}

    def change(message: Any) -> Any:
        number = next(count)
        if number % 20 == 0:
            last['stamp'] = stamp_of(message) + 2 * 10**8
        return restamped(message, last['stamp'] + (number % 20) * 10**5)

    return drive.each(IMU, change).write(folder / 'bag')


@lie(SOUND, WARNED, MENDED, about=r'imu', drive='turns')
def imu_thirds(drive: Recording, folder: Path) -> Path:
    """Every third sample of the IMU is lost."""
    count = iter(range(10**6))
    return drive.each(IMU, lambda m: None if next(count) % 3 == 0 else m).write(folder / 'bag')


@lie(SOUND, WARNED, MENDED, about=r'left|right', drive='turns')
def scans_thirds(drive: Recording, folder: Path) -> Path:
    """Every third scan of both LiDARs is lost."""
    count = iter(range(10**6))
    return drive.each(LIDARS, lambda m: None if next(count) % 3 == 0 else m).write(folder / 'bag')


@lie(SOUND, WARNED, MENDED, about=r'dup|twice', drive='turns')
def recorded_by_two(drive: Recording, folder: Path) -> Path:
    """Two recorders at once, merged: all messages again 50 ms later."""
    again = [(t + 5 * 10**7, topic, m) for t, topic, m in drive.items]
    return drive.plus(again).write(folder / 'bag')


@lie(MENDED, WARNED, about=CLOCK, drive='turns')
def lidars_very_late(drive: Recording, folder: Path) -> Path:
    """Both LiDARs stamped 1.2 s late."""
    return drive.shifted(LIDARS, 1.2).write(folder / 'bag')
