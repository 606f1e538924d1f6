"""Sensors whose clocks are not that of the others."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from incremental_mapper.measurements import NANOSECONDS
from lies.lie import Verdict, lie
from lies.recording import (
    FIX,
    IMU,
    LEFT,
    LIDARS,
    RIGHT,
    TRUTH,
    Recording,
    restamped,
    stamp_of,
)

HOUR = 3600.0
YEAR = 365.0 * 24.0 * HOUR
MENDED, WARNED, REFUSED, SOUND = Verdict.MENDED, Verdict.WARNED, Verdict.REFUSED, Verdict.SOUND
CLOCK = r'clock|time_offset|stamp'


@lie(MENDED, WARNED, about=CLOCK)
def lidars_gps_time(drive: Recording, folder: Path) -> Path:
    """Both LiDARs on GPS time, 18 s ahead."""
    return drive.shifted(LIDARS, 18.0).write(folder / 'bag')


@lie(MENDED, WARNED, about=CLOCK)
def one_lidar_hour(drive: Recording, folder: Path) -> Path:
    """One of two LiDARs an hour ahead."""
    return drive.shifted(LEFT, HOUR).write(folder / 'bag')


@lie(MENDED, WARNED, about=CLOCK, drive='curve')
def imu_year(drive: Recording, folder: Path) -> Path:
    """IMU a year behind."""
    return drive.shifted(IMU, -YEAR).write(folder / 'bag')


@lie(MENDED, WARNED, about=CLOCK, drive='curve')
def imu_boot_clock(drive: Recording, folder: Path) -> Path:
    """IMU counts from its power-up."""
    shift = 95 * NANOSECONDS - stamp_of(drive.of(IMU)[0])
    return drive.shifted(IMU, shift / NANOSECONDS).write(folder / 'bag')


@lie(MENDED, WARNED, about=CLOCK)
def fixes_local_time(drive: Recording, folder: Path) -> Path:
    """Fixes in local time, 9 h ahead."""
    return drive.shifted(FIX, 9 * HOUR).write(folder / 'bag')


@lie(MENDED, WARNED, about=CLOCK, drive='curve')
def imu_late(drive: Recording, folder: Path) -> Path:
    """IMU stamped 0.2 s late."""
    return drive.shifted(IMU, 0.2).write(folder / 'bag')


@lie(
    MENDED,
    WARNED,
    about=CLOCK,
    drive='curve',
)
def lidars_late(drive: Recording, folder: Path) -> Path:
    """Both LiDARs stamped 0.5 s late, as at the end of a slow driver."""
    return drive.shifted(LIDARS, 0.5).write(folder / 'bag')


@lie(SOUND)
def all_boot_clock(drive: Recording, folder: Path) -> Path:
    """Every sensor counts from one power-up."""
    shift = 60 - min(stamp_of(message) for _, _, message in drive.items) // NANOSECONDS
    return drive.shifted([*LIDARS, IMU, FIX, TRUTH], shift).write(folder / 'bag')


@lie(MENDED, WARNED, about=CLOCK)
def lidars_sync_midway(drive: Recording, folder: Path) -> Path:
    """LiDARs count from power-up for 2 s, then are synchronised."""
    until = drive.start + 2 * NANOSECONDS
    shift = 95 * NANOSECONDS - drive.start
    items = [
        (t, topic, restamped(m, stamp_of(m) + shift) if topic in LIDARS and t < until else m)
        for t, topic, m in drive.items
    ]
    return drive.with_items(items).write(folder / 'bag')


@lie(MENDED, WARNED, REFUSED, about=CLOCK)
def all_sync_midway(drive: Recording, folder: Path) -> Path:
    """A computer that learns the time in the middle: stamps from 1970, then of today."""
    until = (drive.start + drive.end) // 2
    items = [
        (t, topic, restamped(m, stamp_of(m) - drive.start + 10**9) if t < until else m)
        for t, topic, m in drive.items
    ]
    return drive.with_items(items).write(folder / 'bag')


@lie(SOUND)
def no_record_times(drive: Recording, folder: Path) -> Path:
    """No record times, as converters leave them: all are 0."""
    items = tuple((0, topic, message) for _, topic, message in drive.items)
    return replace(drive, items=items).write(folder / 'bag')


@lie(SOUND)
def record_times_pressed(drive: Recording, folder: Path) -> Path:
    """Recorded late: all messages logged within a tenth of the time."""
    start = drive.start
    items = tuple((start + (t - start) // 10, topic, m) for t, topic, m in drive.items)
    return replace(drive, items=items).write(folder / 'bag')


@lie(WARNED, about=r'imu|stamp', drive='curve')
def imu_no_stamps(drive: Recording, folder: Path) -> Path:
    """Stamps lost: all headers of the IMU are 0."""
    return drive.each(IMU, lambda message: restamped(message, 0)).write(folder / 'bag')


@lie(
    MENDED,
    WARNED,
    about=r'imu|stamp',
    drive='curve',
)
def imu_coarse_stamps(drive: Recording, folder: Path) -> Path:
    """IMU stamps in whole tenths of a second, ten samples each."""
    tenth = NANOSECONDS // 10
    return drive.each(IMU, lambda m: restamped(m, stamp_of(m) // tenth * tenth)).write(
        folder / 'bag'
    )


@lie(SOUND)
def out_of_order(drive: Recording, folder: Path) -> Path:
    """Messages recorded up to 0.3 s late, out of order."""
    rng = np.random.default_rng(3)
    late = [(t + int(rng.integers(0, 3 * 10**8)), topic, m) for t, topic, m in drive.items]
    return drive.with_items(late).write(folder / 'bag')


@lie(SOUND, MENDED, WARNED, about=r'stamp')
def single_stamps_ahead(drive: Recording, folder: Path) -> Path:
    """One scan and one sample stamped ten years ahead."""
    left = {'n': 0}

    def ahead(message: object) -> object:
        left['n'] += 1
        far = stamp_of(message) + round(10 * YEAR) * NANOSECONDS
        return restamped(message, far) if left['n'] == 20 else message

    made = drive.each(LEFT, ahead)
    left['n'] = 0
    return made.each(IMU, ahead).write(folder / 'bag')


@lie(MENDED, WARNED, about=CLOCK)
def tai_and_gps(drive: Recording, folder: Path) -> Path:
    """LiDARs on TAI and fixes on GPS time at once."""
    return drive.shifted(LIDARS, 37.0).shifted(FIX, 18.0).write(folder / 'bag')


@lie(MENDED, WARNED, SOUND, about=CLOCK)
def all_no_stamps(drive: Recording, folder: Path) -> Path:
    """Stamps lost: all headers of all sensors are 0."""
    return drive.each([*LIDARS, IMU, FIX], lambda m: restamped(m, 0)).write(folder / 'bag')


@lie(MENDED, WARNED, about=CLOCK)
def one_lidar_no_stamps(drive: Recording, folder: Path) -> Path:
    """Stamps of the right LiDAR are 0."""
    return drive.each(RIGHT, lambda m: restamped(m, 0)).write(folder / 'bag')


@lie(MENDED, WARNED, REFUSED, about=CLOCK)
def whole_seconds(drive: Recording, folder: Path) -> Path:
    """LiDAR stamps in whole seconds, ten scans each."""
    return drive.each(
        LIDARS, lambda m: restamped(m, stamp_of(m) // NANOSECONDS * NANOSECONDS)
    ).write(folder / 'bag')


@lie(MENDED, WARNED, REFUSED, about=CLOCK)
def nanosec_in_us(drive: Recording, folder: Path) -> Path:
    """The nanoseconds of LiDAR stamps are microseconds: seconds that hardly pass, and leap."""

    def change(message: object) -> object:
        seconds, rest = divmod(stamp_of(message), NANOSECONDS)
        return restamped(message, seconds * NANOSECONDS + rest // 1000)

    return drive.each(LIDARS, change).write(folder / 'bag')


@lie(MENDED, WARNED, about=CLOCK, drive='turns')
def imu_early_turns(drive: Recording, folder: Path) -> Path:
    """IMU stamped 0.15 s early, over bends."""
    return drive.shifted(IMU, -0.15).write(folder / 'bag')


@lie(MENDED, WARNED, about=CLOCK + '|left|right', drive='turns')
def one_lidar_late(drive: Recording, folder: Path) -> Path:
    """Right LiDAR stamped 0.2 s late."""
    return drive.shifted(RIGHT, 0.2).write(folder / 'bag')


@lie(MENDED, WARNED, about=CLOCK + '|gnss', drive='turns')
def fixes_late(drive: Recording, folder: Path) -> Path:
    """Fixes stamped 0.8 s late, over bends and changes of speed."""
    return drive.shifted(FIX, 0.8).write(folder / 'bag')


@lie(MENDED, WARNED, about=CLOCK, drive='turns')
def lidars_drift(drive: Recording, folder: Path) -> Path:
    """The LiDARs' clock runs two per cent fast."""
    first = drive.start
    return drive.each(
        LIDARS, lambda m: restamped(m, stamp_of(m) + (stamp_of(m) - first) // 50)
    ).write(folder / 'bag')


@lie(MENDED, WARNED, SOUND, about=CLOCK, drive='turns')
def imu_jitter(drive: Recording, folder: Path) -> Path:
    """IMU stamps scatter by 30 ms, out of order."""
    rng = np.random.default_rng(8)
    return drive.each(IMU, lambda m: restamped(m, stamp_of(m) + int(rng.normal(scale=3e7)))).write(
        folder / 'bag'
    )
