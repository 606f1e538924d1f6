"""What an IMU's accelerations say of their unit, and of gravity in them."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.config import Imu
from incremental_mapper.measurements import NANOSECONDS

PART = NANOSECONDS // 5
"""Nanoseconds over which samples are averaged, so that vibration plays no part."""
LOUD = 8.0
"""Samples that are so many times as large as the median are no evidence: a part with one of 500
m/s^2 among it says nothing of gravity. A car on a kerb has up to 5."""
FIRST = 0.5
"""Seconds of samples after which the first decisions are made."""
SOON = 2.0
"""Seconds after which what needs more than the unit's size is decided: a car accelerates as one
wishes for half a second, and does not fall for two."""
LATE = 5.0
"""Seconds after which small deviations count."""
SANE = (0.7, 1.3)
"""Median of the parts' norms as a share of gravity that needs no explanation. Of all drives here it
is 0.987 to 1.026; an Ouster that brakes with 4 m/s^2 has 1.08."""
SMALL = 0.1
"""Deviation of that share that no drive explains over ``LATE`` seconds: it takes 4.5 m/s^2."""
STEADY = 0.15
"""Spread of the parts' norms (10 to 90 % of them, over their median), below which gravity makes
them. Of all drives here it is 0.001 to 0.073; without gravity 0.18 to 4."""
UPRIGHT = 30.0
"""Degrees by which gravity may be off the z axis of base_link: no road is as steep (the steepest
has 19), and no drive here of over 0.3 s has more than 5."""
NO_GRAVITY = 0.35
"""Median of the norms as a share of gravity, below which gravity was removed. Of the drives here
without it, it is 0.01 to 0.09; no car accelerates with 0.35 g for long."""
LEVELLED = 0.1
"""m/s^2/sqrt(Hz); density that accelerations have at least without gravity: of an attitude that is
2 degrees off they have 0.3 m/s^2 too much. Over bends ATE is 0.033 m with 0.1 and 0.034 m with 0.3
(0.172 m with 0.02)."""
UNITS = {9.80665: 'g', 0.00980665: 'milli-g', 0.01: 'cm/s^2'}
"""What makes m/s^2 of other units."""


@dataclass(frozen=True, slots=True, eq=False)
class Gravity:
    """The specific force of some seconds.

    Attributes:
        seconds: How long it was looked at.
        size: Median of the norms of its parts, m/s^2.
        spread: How far the norms scatter, as a share of ``size``.
        direction: Mean direction (3,) in the IMU's frame, of length 1.
        coherence: 1 where all parts have that direction, 0 where they have none in common.
        lasting: What is left of it where the gyroscope's turns are undone, over ``LATE`` seconds at
            a time, m/s^2: what sways back and forth is not in it. NaN where it was not looked for.
    """

    seconds: float
    size: float
    spread: float
    direction: NDArray[np.float64]
    coherence: float
    lasting: float = np.nan


def measure_gravity(
    stamps: NDArray[np.int64],
    acceleration: NDArray[np.float64],
    gyro: NDArray[np.float64] | None = None,
) -> Gravity | None:
    """Summarise some seconds of accelerations; None where there are hardly any.

    Args:
        stamps: Of the samples (N,), ns, in time order.
        acceleration: (N, 3), in the IMU's frame.
        gyro: Rates (N, 3) in the same frame, rad/s, where it is to be told what sways.
    """
    sizes = np.linalg.norm(acceleration, axis=1)
    quiet = sizes <= LOUD * np.median(sizes) if len(sizes) else np.zeros(0, dtype=bool)
    stamps, acceleration = stamps[quiet], acceleration[quiet]
    gyro = None if gyro is None else gyro[quiet]
    if len(stamps) < 4:
        return None
    number = (stamps - stamps[0]) // PART
    starts = np.flatnonzero(np.diff(number, prepend=-1))
    counts = np.diff(np.append(starts, len(stamps)))
    parts = np.add.reduceat(acceleration, starts, axis=0) / counts[:, None]
    norms = np.linalg.norm(parts, axis=1)
    size = float(np.median(norms))
    low, high = np.percentile(norms, (10.0, 90.0))
    spread = float(high - low) / max(size, 1e-12)
    lasting = np.nan if gyro is None or spread < STEADY else _lasting(stamps, acceleration, gyro)
    mean = (parts / np.maximum(norms, 1e-12)[:, None]).mean(axis=0)
    coherence = float(np.linalg.norm(mean))
    return Gravity(
        seconds=len(parts) * PART / NANOSECONDS,
        size=size,
        spread=spread,
        direction=mean / max(coherence, 1e-12),
        coherence=coherence,
        lasting=lasting,
    )


def off_upright(found: Gravity, settings: Imu) -> float:
    """Angle in degrees between gravity and the z axis of base_link, 0 to 180."""
    up = settings.matrix()[2, :3] @ found.direction
    return float(np.degrees(np.arccos(np.clip(up, -1.0, 1.0))))


def check_gravity(found: Gravity, settings: Imu, gravity: float) -> Finding | None:
    """Hold the size of the accelerations against gravity.

    Args:
        found: What was measured, with ``settings`` applied.
        settings: Those of the IMU.
        gravity: What is expected, m/s^2; where it is 0, nothing is.

    Returns:
        What is wrong, None where nothing is or where it is too early to tell.
    """
    if gravity <= 0.0 or found.seconds < FIRST:
        return None
    if _sways(found, gravity):
        return None
    share = found.size / gravity
    if SANE[0] < share < SANE[1]:
        small = abs(share - 1.0) > SMALL and found.seconds > LATE
        return _off_scale(found, settings, gravity) if small else None
    unit = _unit(found, settings, gravity)
    if unit is not None:
        factor, name = unit
        return Finding(
            'imu_in_g' if name.endswith('g') else 'imu_acceleration_unit',
            Severity.MENDED,
            'imu',
            f'accelerations are in {name}: {found.size:.3g} where gravity is {gravity:.2f} m/s^2',
            f'converted; imu.acceleration_scale: {factor * settings.acceleration_scale:g}',
            {'imu': {'acceleration_scale': factor * settings.acceleration_scale}},
        )
    if found.seconds < SOON:
        return None
    if share < NO_GRAVITY:
        return Finding(
            'imu_without_gravity',
            Severity.MENDED,
            'imu',
            f'gravity was taken out of the accelerations: {found.size:.2f} m/s^2 over '
            f'{found.seconds:.1f} s',
            'no gravity is expected in them, so the map is levelled less well; they are believed '
            'less, for the attitude errs by which it was taken out; preintegration.gravity: 0, '
            f'preintegration.accelerometer_noise: {LEVELLED:g}',
            {'preintegration': {'gravity': 0.0, 'accelerometer_noise': LEVELLED}},
        )
    return _off_scale(found, settings, gravity)


def _unit(found: Gravity, settings: Imu, gravity: float) -> tuple[float, str] | None:
    """The factor of a unit that explains the size, and its name."""
    fitting = {
        abs(found.size * factor / gravity - 1.0): (factor, name)
        for factor, name in UNITS.items()
        if SANE[0] < found.size * factor / gravity < SANE[1]
    }
    if not fitting:
        return None
    factor, name = fitting[min(fitting)]
    # Without gravity the accelerations of a car may be as large as 1 g is in g, but not upright.
    upright = abs(off_upright(found, settings) - 90.0) > 90.0 - UPRIGHT
    if name == 'g' and not (found.coherence > 0.9 and (upright or _steady(found))):
        return None
    return factor, name


def _sways(found: Gravity, gravity: float) -> bool:
    """Whether all that is beside gravity averages out, as on a mast, a leg or a boat."""
    return abs(found.lasting / gravity - 1.0) < SMALL


def _lasting(
    stamps: NDArray[np.int64], acceleration: NDArray[np.float64], gyro: NDArray[np.float64]
) -> float:
    """Median over blocks of ``LATE`` seconds of the mean force in the axes of their beginnings."""
    number = (stamps - stamps[0]) // round(LATE * NANOSECONDS)
    edges = np.searchsorted(number, np.arange(number[-1] + 1))  # the last block is not whole
    means = [
        _turned_back(stamps[a:b], gyro[a:b]).apply(acceleration[a:b]).mean(axis=0)
        for a, b in pairwise(edges.tolist())
        if b - a > 1
    ]
    return float(np.median(np.linalg.norm(means, axis=1))) if means else np.nan


def _turned_back(stamps: NDArray[np.int64], gyro: NDArray[np.float64]) -> Rotation:
    """Rotations T_first_each (N,) by the rates; products are made of pairs, of fours, and so on."""
    passed = np.diff(stamps, prepend=stamps[0]) / NANOSECONDS
    turned = Rotation.from_rotvec(passed[:, None] * gyro).as_quat()
    reach = 1
    while reach < len(turned):
        later = Rotation.from_quat(turned[:-reach]) * Rotation.from_quat(turned[reach:])
        turned[reach:] = later.as_quat()
        reach *= 2
    return Rotation.from_quat(turned)


def _steady(found: Gravity) -> bool:
    return found.seconds > SOON and found.spread < STEADY and found.coherence > 0.95


def _off_scale(found: Gravity, settings: Imu, gravity: float) -> Finding:
    """Accelerations of no known unit; where they are steady, gravity gives the factor."""
    factor = settings.acceleration_scale * gravity / max(found.size, 1e-12)
    steady = _steady(found)
    return Finding(
        'imu_acceleration_scale',
        Severity.MENDED if steady else Severity.WARNING,
        'imu',
        f'accelerations are {found.size:.4g} over {found.seconds:.1f} s where gravity is '
        f'{gravity:.2f} m/s^2',
        f'{"scaled by" if steady else "if their unit is another:"} imu.acceleration_scale: '
        f'{factor:.6g}',
        {'imu': {'acceleration_scale': float(f'{factor:.6g}')}},
    )
