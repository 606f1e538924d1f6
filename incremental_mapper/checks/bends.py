"""Whether a map follows what its LiDARs measured over seconds.

From one scan to the next a bent map hides in the noise of a match. Over a stretch of many matches
noise averages out and a pull to one side adds up: by fixes that drift, by an IMU that was knocked,
by odometry that reads the way short.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.measurements import NANOSECONDS

STRETCH = 2.0
"""Seconds of matches that are held against the map together."""
FEWEST = 4
"""Stretches of a LiDAR that make a judgement of the whole map."""
BENT = 1.8
"""Median of the stretches' deviations, in their standard deviations by axis, from which the map
as a whole is bent. Sound drives: 0.15 to 0.4 in simulated streets, 0.6 to 0.85 on KITTI, 1.15 in a
field without structure. Fixes that drift by 1 m/s: 2.2; clouds of ranges and angles: 5."""
SHARP = 3.0
"""The same of a single stretch, from which the map is bent there. Sound drives: 1.7 at the most,
2.2 in the field; an antenna that was taken to be 0.6 m aside: 3.5."""
AGREED = 1.0
"""The same, within which the matches of another LiDAR and the map say the same."""
SMALL = 0.25
"""Metres of a stretch of which nothing is said."""


@dataclass(frozen=True, slots=True, eq=False)
class Stretches:
    """What one LiDAR measured over some seconds at a time, and what the map has there.

    Attributes:
        sensor: Name of the LiDAR.
        stamps: Stamps (K,) of their ends, ns.
        metres: How far (K,) the translations of map and matches are apart.
        deviations: The same (K,) in standard deviations of an axis, by the covariances of the
            matches: about 1 where these are honest, less where they are cautious.
    """

    sensor: str
    stamps: NDArray[np.int64]
    metres: NDArray[np.float64]
    deviations: NDArray[np.float64]


def bend_findings(every: Sequence[Stretches], first: int) -> list[Finding]:
    """Say where a map is bent against what its LiDARs measured.

    Args:
        every: The stretches of each LiDAR.
        first: Stamp of the first pose, from which seconds are told, ns.

    Returns:
        ``map_bent`` for each LiDAR that the map does not follow.
    """
    found = (_judge(one, every, first) for one in every if len(one.stamps))
    return [finding for finding in found if finding is not None]


def _agreed(one: Stretches, others: Sequence[Stretches]) -> NDArray[np.bool_]:
    """Where (K,) another LiDAR says the same as the map: then it is a match that is wrong there."""
    agreed = np.zeros(len(one.stamps), dtype=bool)
    for other in others:
        apart = np.abs(one.stamps[:, None] - other.stamps)
        alike = (apart < STRETCH * NANOSECONDS) & (other.deviations < AGREED)
        agreed |= alike.any(axis=1) & (other is not one)
    return agreed


def _judge(one: Stretches, every: Sequence[Stretches], first: int) -> Finding | None:
    off = (one.metres > SMALL) & ~_agreed(one, every)
    typical = float(np.median(one.metres))
    if len(one.stamps) >= FEWEST and np.median(one.deviations) > BENT and typical > SMALL:
        text = f'all along the map has a way that is {typical:.1f} m off within {STRETCH:.0f} s'
    elif len(sharp := np.flatnonzero(off & (one.deviations > SHARP))):
        worst = sharp[np.argmax(one.metres[sharp])]
        seconds = (int(one.stamps[worst]) - first) / NANOSECONDS
        text = (
            f'at {seconds:.1f} s the map has a way that is {one.metres[worst]:.1f} m off within '
            f'{STRETCH:.0f} s'
        )
        if len(sharp) > 1:
            text += f', and at {len(sharp) - 1} other places'
    else:
        return None
    return Finding(
        'map_bent',
        Severity.ERROR,  # a decimetre a second is metres in a minute; one bend turns all behind it
        one.sensor,
        f'{text}, held against its matches, far beyond their noise: something else pulls at it',
        'see what pulls: fixes that drift or come late (gnss.time_offset, fixes.min_sigma), an IMU '
        'that was knocked or has other units; or its matches are wrong: check its extrinsics',
    )
