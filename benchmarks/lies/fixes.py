"""Fixes that are none, or are elsewhere."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lies.lie import Verdict, lie
from lies.recording import FIX, Recording

MENDED, WARNED, REFUSED, SOUND = Verdict.MENDED, Verdict.WARNED, Verdict.REFUSED, Verdict.SOUND
GNSS = r'gnss|fix|datum'
METRE = 1.0 / 111_111.0
"""Degrees of latitude."""


def _fixes(drive: Recording, change: Callable[[int, Any], Any]) -> Recording:
    """With every fix changed by its number."""
    count = iter(range(10**6))
    return drive.each(FIX, lambda message: change(next(count), message))


def _degrees(drive: Recording, change: Callable[[float], float]) -> Recording:
    """With the latitude and the longitude of every fix changed."""
    return _fixes(
        drive,
        lambda _, m: replace(m, latitude=change(m.latitude), longitude=change(m.longitude)),
    )


def _north(message: Any, metres: float) -> Any:
    return replace(message, latitude=message.latitude + metres * METRE)


@lie(SOUND, MENDED, WARNED, about=GNSS, drive='fixes')
def no_altitudes(drive: Recording, folder: Path) -> Path:
    """Altitude of every fix NaN."""
    return _fixes(drive, lambda _, m: replace(m, altitude=float('nan'))).write(folder / 'bag')


@lie(MENDED, WARNED, about=GNSS, drive='fixes')
def frozen_fixes(drive: Recording, folder: Path) -> Path:
    """Receiver frozen bit for bit from the eighth fix on."""
    eighth = drive.of(FIX)[7]
    return _fixes(drive, lambda i, m: m if i < 8 else replace(eighth, header=m.header)).write(
        folder / 'bag'
    )


@lie(MENDED, WARNED, about=GNSS, drive='fixes')
def never_moving_fixes(drive: Recording, folder: Path) -> Path:
    """Receiver frozen from the first fix on."""
    first = drive.of(FIX)[0]
    return _fixes(drive, lambda _, m: replace(first, header=m.header)).write(folder / 'bag')


@lie(MENDED, WARNED, SOUND, about=GNSS, drive='fixes')
def jump_of_five(drive: Recording, folder: Path) -> Path:
    """Five fixes in the middle 100 m off."""
    return _fixes(drive, lambda i, m: _north(m, 100.0) if 10 <= i < 15 else m).write(folder / 'bag')


@lie(
    MENDED,
    WARNED,
    about=GNSS,
    drive='fixes',
)
def datum_step(drive: Recording, folder: Path) -> Path:
    """All fixes from the middle on 5 m off, as by another base station."""
    return _fixes(drive, lambda i, m: _north(m, 5.0) if i >= 13 else m).write(folder / 'bag')


@lie(MENDED, WARNED, about=GNSS, drive='fixes')
def begins_elsewhere(drive: Recording, folder: Path) -> Path:
    """The first four fixes of another city."""
    return _fixes(drive, lambda i, m: _north(m, 150_000.0) if i < 4 else m).write(folder / 'bag')


@lie(WARNED, about=GNSS + '|no_fix', drive='fixes')
def status_no_fix(drive: Recording, folder: Path) -> Path:
    """Status -1 with plausible positions."""
    return _fixes(drive, lambda _, m: replace(m, status=replace(m.status, status=-1))).write(
        folder / 'bag'
    )


@lie(MENDED, WARNED, REFUSED, about=GNSS, drive='fixes')
def exchanged_degrees(drive: Recording, folder: Path) -> Path:
    """Latitude and longitude exchanged."""
    return _fixes(drive, lambda _, m: replace(m, latitude=m.longitude, longitude=m.latitude)).write(
        folder / 'bag'
    )


@lie(MENDED, WARNED, REFUSED, about=GNSS, drive='fixes')
def minutes_as_degrees(drive: Recording, folder: Path) -> Path:
    """Degrees and minutes read as degrees."""

    def minutes(angle: float) -> float:
        whole = np.floor(angle)
        return float(whole + (angle - whole) * 0.6)

    return _fixes(
        drive,
        lambda _, m: replace(m, latitude=minutes(m.latitude), longitude=minutes(m.longitude)),
    ).write(folder / 'bag')


@lie(MENDED, WARNED, about=GNSS, drive='fixes')
def sure_of_itself(drive: Recording, folder: Path) -> Path:
    """Variances of 10^-12 on fixes 3 m off."""
    rng = np.random.default_rng(4)
    sure = np.diag([1e-12] * 3).ravel()
    return _fixes(
        drive,
        lambda _, m: replace(_north(m, rng.normal(scale=3.0)), position_covariance=sure),
    ).write(folder / 'bag')


@lie(SOUND, MENDED, WARNED, about=GNSS, drive='fixes')
def zero_variances(drive: Recording, folder: Path) -> Path:
    """All variances 0 although the type says known."""
    return _fixes(drive, lambda _, m: replace(m, position_covariance=np.zeros(9))).write(
        folder / 'bag'
    )


@lie(
    MENDED,
    WARNED,
    about=GNSS,
    drive='fixes',
)
def geoid_step(drive: Recording, folder: Path) -> Path:
    """Altitudes above the sea for the first half, above the ellipsoid after it."""
    return _fixes(
        drive, lambda i, m: replace(m, altitude=m.altitude - 25.0) if i < 13 else m
    ).write(folder / 'bag')


@lie(SOUND, WARNED, about=GNSS + '|out_of_range', drive='fixes')
def zero_place(drive: Recording, folder: Path) -> Path:
    """Every other fix is 0, 0."""
    return _fixes(
        drive, lambda i, m: m if i % 2 else replace(m, latitude=0.0, longitude=0.0)
    ).write(folder / 'bag')


@lie(SOUND, MENDED, WARNED, about=GNSS, drive='fixes')
def frozen_without_fix(drive: Recording, folder: Path) -> Path:
    """Frozen in the middle, with status -1 meanwhile."""
    at = drive.of(FIX)[8]

    def change(number: int, message: Any) -> Any:
        if not 8 <= number < 16:
            return message
        return replace(at, header=message.header, status=replace(message.status, status=-1))

    return _fixes(drive, change).write(folder / 'bag')


@lie(MENDED, WARNED, about=GNSS, drive='fixes')
def ten_elsewhere(drive: Recording, folder: Path) -> Path:
    """The first ten fixes 20 m off."""
    return _fixes(drive, lambda i, m: _north(m, 20.0) if i < 10 else m).write(folder / 'bag')


@lie(SOUND, WARNED, about=GNSS + '|out_of_range|finite', drive='fixes')
def nan_places(drive: Recording, folder: Path) -> Path:
    """Every third latitude is NaN."""
    return _fixes(drive, lambda i, m: m if i % 3 else replace(m, latitude=float('nan'))).write(
        folder / 'bag'
    )


@lie(MENDED, WARNED, REFUSED, about=GNSS, drive='europe')
def exchanged_in_range(drive: Recording, folder: Path) -> Path:
    """Latitude and longitude exchanged where both are in range, as in Europe."""
    return _fixes(drive, lambda _, m: replace(m, latitude=m.longitude, longitude=m.latitude)).write(
        folder / 'bag'
    )


@lie(SOUND, drive='europe')
def europe_itself(drive: Recording, folder: Path) -> Path:
    """A drive in Europe."""
    return drive.write(folder / 'bag')


@lie(MENDED, WARNED, REFUSED, about=GNSS, drive='turns')
def west_as_east(drive: Recording, folder: Path) -> Path:
    """The sign of the longitude lost."""
    return _fixes(drive, lambda _, m: replace(m, longitude=-m.longitude)).write(folder / 'bag')


@lie(MENDED, WARNED, REFUSED, about=GNSS, drive='turns')
def in_radians(drive: Recording, folder: Path) -> Path:
    """Latitude and longitude in radians."""
    return _degrees(drive, lambda degrees: float(np.radians(degrees))).write(folder / 'bag')


@lie(WARNED, REFUSED, about=GNSS + '|range', drive='turns')
def in_e7(drive: Recording, folder: Path) -> Path:
    """Degrees times ten million, as receivers send them."""
    return _degrees(drive, lambda degrees: degrees * 1e7).write(folder / 'bag')


@lie(MENDED, WARNED, about=GNSS, drive='turns')
def stuck_longitude(drive: Recording, folder: Path) -> Path:
    """The longitude alone is stuck."""
    at = drive.of(FIX)[0].longitude
    return _fixes(drive, lambda _, m: replace(m, longitude=at)).write(folder / 'bag')


@lie(MENDED, WARNED, SOUND, about=GNSS, drive='fixes', factor=2.0)
def held_fixes(drive: Recording, folder: Path) -> Path:
    """A receiver of 1 Hz whose last fix is sent again at 5 Hz with new stamps."""
    fixes = drive.of(FIX)
    return _fixes(drive, lambda i, m: replace(fixes[i // 5 * 5], header=m.header)).write(
        folder / 'bag'
    )


@lie(MENDED, WARNED, SOUND, about=GNSS, drive='fixes', factor=2.0)
def single_precision(drive: Recording, folder: Path) -> Path:
    """Degrees rounded to single precision, in steps of half a metre."""
    return _degrees(drive, lambda degrees: float(np.float32(degrees))).write(folder / 'bag')


@lie(MENDED, WARNED, about=GNSS, drive='turns')
def four_decimals(drive: Recording, folder: Path) -> Path:
    """Degrees rounded to four decimals, in steps of 10 m."""
    return _degrees(drive, lambda degrees: round(degrees, 4)).write(folder / 'bag')


@lie(MENDED, WARNED, about=GNSS, drive='fixes')
def cold_start(drive: Recording, folder: Path) -> Path:
    """Fixes that converge from 30 m off in the first seconds, sure of themselves."""
    return _fixes(drive, lambda i, m: _north(m, 30.0 * np.exp(-i / 4.0))).write(folder / 'bag')


@lie(MENDED, WARNED, about=GNSS, drive='turns')
def drifting_fixes(drive: Recording, folder: Path) -> Path:
    """Fixes drift away by a metre from one to the next."""
    return _fixes(drive, lambda i, m: _north(m, 1.0 * i)).write(folder / 'bag')


@lie(MENDED, WARNED, about=GNSS, drive='turns')
def every_third_altitude(drive: Recording, folder: Path) -> Path:
    """Every third altitude 20 m too high."""
    return _fixes(drive, lambda i, m: replace(m, altitude=m.altitude + 20.0 * (i % 3 == 0))).write(
        folder / 'bag'
    )


@lie(SOUND, MENDED, WARNED, about=GNSS, drive='fixes', factor=6.0)
def covariance_unknown(drive: Recording, folder: Path) -> Path:
    """Covariances of unknown type, and noise of 3 m."""
    rng = np.random.default_rng(3)

    def change(_: int, message: Any) -> Any:
        north, east = rng.normal(scale=3.0 * METRE, size=2)
        return replace(
            message,
            latitude=message.latitude + north,
            longitude=message.longitude + east,
            position_covariance=np.zeros(9),
            position_covariance_type=0,
        )

    return _fixes(drive, change).write(folder / 'bag')


@lie(MENDED, WARNED, about=GNSS, drive='turns')
def minutes_behind_the_point(drive: Recording, folder: Path) -> Path:
    """Degrees, minutes and seconds written as DD.MMSS."""

    def written(degrees: float) -> float:
        minutes, seconds = divmod(abs(degrees) * 3600.0, 60.0)
        whole, minutes = divmod(minutes, 60.0)
        return float(np.sign(degrees) * (whole + minutes / 100.0 + seconds / 10000.0))

    return _degrees(drive, written).write(folder / 'bag')


@lie(MENDED, WARNED, about=GNSS, drive='fixes')
def base_station_between(drive: Recording, folder: Path) -> Path:
    """Every second fix is that of the base station."""
    station = drive.of(FIX)[0]

    def change(number: int, message: Any) -> Any:
        place = _north(station, 300.0)
        return message if number % 2 else replace(place, header=message.header)

    return _fixes(drive, change).write(folder / 'bag')
