"""Measurements of one sensor that pull a map to one side, a little at a time."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from incremental_mapper.measurements import NANOSECONDS
from lies.faint import knocked
from lies.fixes import METRE
from lies.lie import Verdict, lie
from lies.recording import FIX, Recording, restamped, stamp_of

MENDED, WARNED, REFUSED, SOUND = Verdict.MENDED, Verdict.WARNED, Verdict.REFUSED, Verdict.SOUND
ANY = r'imu|gnss|left|right'


def _knocked(drive: Recording, force: list[float], seconds: float) -> Recording:
    return knocked(drive, force, drive.start + 10 * NANOSECONDS, seconds)


@lie(SOUND, MENDED, WARNED, about=ANY, drive='turns', factor=2.0)
def imu_knocked(drive: Recording, folder: Path) -> Path:
    """An IMU that feels 15 m/s^2 more ahead for 0.2 s."""
    return _knocked(drive, [15.0, 0.0, 0.0], 0.2).write(folder / 'bag')


@lie(SOUND, MENDED, WARNED, about=ANY, drive='turns', factor=2.0)
def imu_knocked_aside(drive: Recording, folder: Path) -> Path:
    """An IMU that feels 24 m/s^2 more to the left for 0.2 s."""
    return _knocked(drive, [0.0, 24.0, 0.0], 0.2).write(folder / 'bag')


@lie(SOUND, MENDED, WARNED, about=ANY, drive='turns', factor=2.0)
def imu_pushed(drive: Recording, folder: Path) -> Path:
    """An IMU that feels 3 m/s^2 more ahead for two seconds."""
    return _knocked(drive, [3.0, 0.0, 0.0], 2.0).write(folder / 'bag')


def _place(message: Any, north: float, east: float) -> Any:
    across = METRE / np.cos(np.radians(message.latitude))
    return replace(
        message,
        latitude=message.latitude + north * METRE,
        longitude=message.longitude + east * across,
    )


@lie(MENDED, WARNED, REFUSED, about=ANY, drive='turns')
def fixes_in_gons(drive: Recording, folder: Path) -> Path:
    """Latitude and longitude in gons, 400 of which are a circle."""
    return drive.each(
        FIX,
        lambda m: replace(m, latitude=m.latitude / 0.9, longitude=m.longitude / 0.9),
    ).write(folder / 'bag')


@lie(MENDED, WARNED, SOUND, about=ANY, drive='turns', factor=3.0)
def fixes_late_at_random(drive: Recording, folder: Path) -> Path:
    """Fixes stamped on arrival, 0.1 to 0.6 s late."""
    rng = np.random.default_rng(4)
    return drive.each(
        FIX, lambda m: restamped(m, stamp_of(m) + int(rng.uniform(0.1, 0.6) * NANOSECONDS))
    ).write(folder / 'bag')


@lie(MENDED, WARNED, SOUND, about=ANY, drive='turns', factor=3.0)
def fixes_pulled(drive: Recording, folder: Path) -> Path:
    """Fixes that are drawn aside by up to 4 m between houses, and say 5 cm."""
    begin = drive.start + 8 * NANOSECONDS

    def change(message: Any) -> Any:
        since = (stamp_of(message) - begin) / (10.0 * NANOSECONDS)
        if not 0.0 < since < 1.0:
            return message
        return _place(message, 0.0, 4.0 * np.sin(np.pi * since))

    return drive.each(FIX, change).write(folder / 'bag')
