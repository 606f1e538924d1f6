"""The simulated VRS-GNSS receiver: fixes of its antenna, outages and spells of poor quality."""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import pymap3d
from numpy.typing import NDArray

from incremental_mapper.datasets.simulated.motion import Drive
from incremental_mapper.datasets.simulated.sensors import T_BASE_VRS

Array = NDArray[np.float64]

ORIGIN = (36.4, 129.0, 90.0)
"""Latitude, longitude (degrees) and ellipsoidal altitude (metres) of the world's origin. It is on
the middle meridian of UTM zone 52, where grid north is true north."""
ORIGIN_GRID = np.array([500000.0, 4028315.784853, 90.0])
"""UTM easting, northing and the altitude of the world's origin, in metres."""
GEOID = 27.0
"""Height of the geoid above the ellipsoid in metres."""
VERTICAL = 1.5
"""The altitude's standard deviation is so many times the horizontal one."""
UNDISTURBED = 20.0
"""Shorter drives, in seconds, have no spells."""
HEADING_SPEED = 1.0
"""Slower than this, in m/s, the receiver knows no heading."""
KNOTS = 1.0 / 0.514444


class FixState(IntEnum):
    """States as in the fourth field of NMEA's GGA sentence."""

    NONE = 0
    SINGLE = 1
    FIXED = 4
    FLOAT = 5


SIGMA = {FixState.SINGLE: 2.0, FixState.FIXED: 0.02, FixState.FLOAT: 0.3}
SATELLITES = {FixState.SINGLE: 7, FixState.FIXED: 16, FixState.FLOAT: 11}
DILUTION = {FixState.SINGLE: 2.4, FixState.FIXED: 0.8, FixState.FLOAT: 1.4}


@dataclass(frozen=True, slots=True, eq=False)
class Fix:
    """One row of the receiver.

    ``index`` counts the times that were asked for; ``position`` (3,) is the measured one of the
    antenna in the world, ENU metres; ``heading`` is in degrees clockwise from north; ``speed`` in
    m/s.
    """

    index: int
    state: FixState
    position: Array
    latitude: float
    longitude: float
    altitude: float
    heading: float
    speed: float

    @property
    def sigma(self) -> float:
        """Horizontal standard deviation in metres."""
        return SIGMA[self.state]

    @property
    def heading_valid(self) -> bool:
        """Whether the receiver moves fast enough and knows its position well enough."""
        return self.state is FixState.FIXED and self.speed > HEADING_SPEED


@dataclass(frozen=True, slots=True)
class Spell:
    """From ``start`` to ``end`` (seconds) the receiver is in ``state``."""

    start: float
    end: float
    state: FixState


def make_spells(duration: float, rng: np.random.Generator) -> list[Spell]:
    """Outages, single and float spells of a few seconds for a drive of ``duration`` seconds."""
    spells: list[Spell] = []
    if duration <= UNDISTURBED:
        return spells
    states = [FixState.NONE, FixState.FLOAT, FixState.SINGLE]
    start = rng.uniform(8.0, 12.0)
    while start + 3.0 < duration:
        if len(spells) % len(states) == 0:
            rng.shuffle(states)
        end = start + rng.uniform(3.0, 7.0)
        spells.append(Spell(start, end, states[len(spells) % len(states)]))
        start = end + rng.uniform(8.0, 20.0)
    return spells


def antenna_positions(drive: Drive, times: Array) -> Array:
    """True antenna positions (N, 3) in the world at ``times`` (N,)."""
    position, rotation = drive.poses(times)
    antenna: Array = position + rotation.apply(np.tile(T_BASE_VRS[:3, 3], (len(times), 1)))
    return antenna


def fixes(
    drive: Drive, times: Array, spells: list[Spell], rng: np.random.Generator
) -> Iterator[Fix]:
    """The fixes at ``times`` (N,), without those that fall into an outage."""
    speeds = drive.speed(times)
    headings = np.degrees(drive.poses(times)[1].as_euler('ZYX')[:, 0])
    drift = {spell: rng.normal(size=3) for spell in spells}
    for index, truth in enumerate(antenna_positions(drive, times)):
        spell = next((s for s in spells if s.start <= times[index] < s.end), None)
        state = FixState.FIXED if spell is None else spell.state
        if state is FixState.NONE:
            continue
        unit = rng.normal(size=3)
        if spell is not None:
            # Without fixed ambiguities most of the error is common to the whole spell.
            unit = 0.8 * drift[spell] + 0.6 * unit
        position = truth + SIGMA[state] * np.array([1.0, 1.0, VERTICAL]) * unit
        latitude, longitude, altitude = pymap3d.enu2geodetic(*position, *ORIGIN)
        yield Fix(
            index=index,
            state=state,
            position=position,
            latitude=float(latitude),
            longitude=float(longitude),
            altitude=float(altitude),
            heading=float((90.0 - headings[index] + rng.normal(scale=0.3)) % 360.0),
            speed=float(speeds[index]),
        )
