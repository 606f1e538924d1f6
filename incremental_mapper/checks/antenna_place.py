"""Whether the antenna is where the settings put it, by how fixes swing about the car in turns.

An antenna that is elsewhere on the car shifts the fixes by a vector that turns with the car. Where
it only ever drives straight on that is a shift like any other; in turns it is none. Along the car
it is told from a clock that is off by the speed, which does not matter to an antenna.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.measurements import NANOSECONDS

FEWEST = 12
"""Fixes that tell it."""
LEAST = 0.5
"""Metres of which a user is told. Sound drives with turns (60 s of the simulated town, KITTI 0009):
at most 0.2 m."""
SURE = 0.4
"""Metres to which it must be known: 0.15 to 0.23 over 25 s of bends. Where odometry is wrong itself
(LiDARs turned, a lorry alongside, late fixes) it was 4 to 200 m off, to 0.55 to 30 m."""
CERTAIN = 6.0
"""Standard deviations of it that it has at least."""
OUTLIER = 4.0
"""So many times as far off as half of the others, a fix says nothing here."""
ODOMETRY = 0.05
"""Metres by which odometry is off from one fix to the next, whatever the fixes say."""
OWN = 0.03
"""Share of what an antenna ahead does, at least, that a lag does not: speeds that vary by 17 %."""
_ARM = slice(2, 4)
"""Where ahead and left stand among the unknowns."""


@dataclass(frozen=True, slots=True, eq=False)
class TurningTrack:
    """Fixes, and where odometry has the antenna and the car's heading then.

    Attributes:
        stamps: Nanoseconds (K,), ascending.
        enu: The fixes (K, 2), east and north, metres.
        local: Position of the antenna by odometry (K, 2), in a frame of its own, metres.
        headings: Of the car there (K,), radians.
        sigmas: Horizontal deviations of the fixes (K,), metres.
        slipped: How far odometry may have slipped until then (K,), metres: it only grows, where
            scans hold a match weakly.
    """

    stamps: NDArray[np.int64]
    enu: NDArray[np.float64]
    local: NDArray[np.float64]
    headings: NDArray[np.float64]
    sigmas: NDArray[np.float64]
    slipped: NDArray[np.float64]


def antenna_finding(
    sensor: str, track: TurningTrack, lever_arm: NDArray[np.float64], early: bool
) -> Finding | None:
    """Look for the place of the antenna that makes fixes and odometry agree.

    Args:
        sensor: Name of the receiver.
        track: Of some hundred metres, over which odometry hardly drifts.
        lever_arm: The antenna in base_link (3,) as the settings have it, metres.
        early: Whether little is lost where the map begins anew.

    Returns:
        ``antenna_place``, with the place that is measured, in force where it is ``early`` and else
        a proposal; None where it is right or does not show.
    """
    measured = arm_error(track)
    if measured is None:
        return None
    error, deviation = measured
    # A direction that does not show is left as it is.
    # Less than the deviation of the fixes matters to no map.
    least = np.maximum(max(LEAST, float(np.median(track.sigmas))), CERTAIN * deviation)
    error = np.where((np.abs(error) > least) & (deviation < SURE), error, 0.0)
    if not error.any():
        return None
    x, y = (float(value) for value in np.round(lever_arm[:2] + error, 2))
    place = [x, y, float(lever_arm[2]), 0.0, 0.0, 0.0, 1.0]
    words = (
        f'{abs(value):.1f} m {ahead if value > 0.0 else behind}'
        for value, ahead, behind in zip(error, ('ahead', 'left'), ('behind', 'right'), strict=True)
        if value
    )
    line = f'gnss.T_base_sensor: {place}'
    return Finding(
        'antenna_place',
        Severity.WARNING,
        sensor,
        f'in turns {len(track.stamps)} fixes swing about the car as those of an antenna that is '
        f'{" and ".join(words)} of where gnss.T_base_sensor has it (to '
        f'{float(deviation[error != 0.0].max()):.2f} m)',
        f'{"in force is" if early else "by this it is"} {line} (its height does not show); measure '
        'where it is on the car, or find all LiDARs wrong by as much',
        {'gnss': {'T_base_sensor': place}},
        in_force=early,
    )


def arm_error(
    track: TurningTrack,
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """How far the antenna is from where it should be, by least squares.

    From fix to fix, so that the drift of odometry counts for a step alone; its size and direction
    against the fixes, and a lag of their clock, are found beside. Fixes count by their deviations:
    ten of 2 m among those of 2 cm once put an antenna 0.6 m aside. Steps in which odometry may have
    slipped do not count at all: along bare ground it slips to the same side of the car for seconds,
    and that turns with the car as an antenna does.

    Args:
        track: Fixes and odometry.

    Returns:
        Metres ahead and left (2,), and their standard deviations; None where these are too few.
    """
    seconds = (track.stamps - track.stamps[:1]) / NANOSECONDS
    sound = np.diff(track.slipped) <= ODOMETRY
    if sound.sum() + 1 < FEWEST or not (np.diff(seconds) > 0.0).all():
        return None
    # Places and directions as complex numbers: a turn is a factor.
    place = track.local[:, 0] + 1j * track.local[:, 1]
    weights = sound / np.sqrt(ODOMETRY**2 + track.sigmas[1:] ** 2 + track.sigmas[:-1] ** 2)
    steps = weights * np.diff(track.enu[:, 0] + 1j * track.enu[:, 1])
    moved = weights * np.diff(place)
    ahead = np.exp(1j * track.headings)
    turned = weights * np.diff(ahead)
    lagged = weights * np.diff(np.abs(np.gradient(place, seconds)) * ahead)
    every = np.stack([moved, turned, lagged], axis=1)
    yaw = np.linalg.lstsq(every, steps, rcond=None)[0][0]
    steps = steps * np.conj(yaw) / max(abs(yaw), 1e-9)
    table = np.stack([moved, 1j * moved, turned, 1j * turned, lagged], axis=1)
    keep = sound
    for _ in range(2):
        solution = np.linalg.lstsq(_real(table[keep]), _real(steps[keep]), rcond=None)[0]
        off = np.abs(steps - table @ solution)
        keep = sound & (off <= OUTLIER * np.median(off[sound]))
    rows, left = _real(table[keep]), _real(steps[keep])
    solution, _, rank, _ = np.linalg.lstsq(rows, left, rcond=None)
    if rank < table.shape[1] or len(rows) <= rank:
        return None
    variance = float(np.sum((left - rows @ solution) ** 2)) / (len(rows) - rank)
    covariance = variance * np.linalg.inv(rows.T @ rows)
    deviations: NDArray[np.float64] = np.sqrt(np.diag(covariance))[_ARM]
    common = abs(np.vdot(turned, lagged)) / (np.linalg.norm(turned) * np.linalg.norm(lagged))
    if 1.0 - common**2 < OWN:
        deviations[0] = np.inf
    return np.asarray(solution[_ARM], dtype=np.float64), deviations


def _real(values: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Both parts of complex equations (K, ...), one after the other (2K, ...)."""
    return np.concatenate([values.real, values.imag])
