"""Whether the motions that LiDARs saw can be those of one vehicle.

Each LiDAR's motion is matched on its own and expressed in base_link by its extrinsics. Wrong ones
turn it: then two LiDARs move in different directions, or the vehicle moves sideways. A graph hides
that, because it settles on a motion in between.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.measurements import NANOSECONDS

FORWARD = np.array([1.0, 0.0, 0.0])
SLOWEST = 0.5
"""m/s; a direction of slower motion is mostly noise."""
FEWEST = 10
"""Motions that make a judgement."""
SHORTEST = 5.0
"""Metres, straight from the first place to the last, that tell a direction. A standing car's noise
adds up to a way of 8 m in 10 s (kaist_paper.yaml), but leads nowhere."""
STRAIGHT = 0.8
"""Least share of the way that leads on, in base_link: a vehicle that turns still drives forward."""
TURNED = 3.0
"""Degrees between the directions of two LiDARs from which they disagree. Sound runs: 0.2 to 2.0
with gicp. Set wrong by 3 and 10 degrees it shows 3.6 and 10.4 (yaw), 2.4 and 9.6 (pitch)."""
APART = 15.0
"""Degrees from which one map of both is not to be trusted: walls at 20 m stand 5 m apart."""
SIGNIFICANT = 6.0
"""How many times its standard error an angle must be. kiss_icp under-reads tilted LiDARs so that
single directions scatter by 30 to 40 degrees: 25 degrees were 4 standard errors there."""
SIDEWAYS = 30.0
"""Degrees between a vehicle's way and its x axis from which its base_link is not as REP-103 has
it. Sound runs: 0.2 to 1.5 with gicp, 21 with kiss_icp on tilted LiDARs."""
FAR = 20.0
"""Metres that are driven like that at least."""
STRETCH = 5.0
"""Metres between two fixes that tell a distance."""
OUT_OF_NOISE = 10.0
"""How many times their standard deviation two fixes are apart at least, where they do."""
HOLE = 0.02
"""Seconds without odometry that are a hole."""
STRETCHES = 3
"""Such distances that make a judgement."""
SHORT, LONG = 0.6, 1.6
"""Ratio of a LiDAR's way to that of the fixes from which one of them is wrong. Sound runs: 0.93 to
1.01 with gicp; kiss_icp reads 0.2 of the way where ground rings outweigh walls."""
MOST = 0.8
"""Share of the distances that must say so."""
NEAR, ALIKE, MANY = (0.92, 1.07), 0.05, 5
"""Ratios in which less is believed where so many distances are that much alike: fixes in another
unit (gons read 0.90 of the way), ranges that are all too long. The others scatter by chance."""


@dataclass(frozen=True, slots=True, eq=False)
class Motions:
    """The odometry of one LiDAR in base_link.

    Attributes:
        sensor: Name of the LiDAR.
        starts: Stamps (K,) of the earlier scans, ns, ascending.
        ends: Stamps (K,) of the later scans, ns.
        translations: Translations (K, 3) between them, metres, in base_link at the earlier scan.
    """

    sensor: str
    starts: NDArray[np.int64]
    ends: NDArray[np.int64]
    translations: NDArray[np.float64]

    @property
    def seconds(self) -> NDArray[np.float64]:
        """How long each takes (K,)."""
        return (self.ends - self.starts) / NANOSECONDS

    @property
    def path(self) -> float:
        """Length of the whole way, metres."""
        return float(np.linalg.norm(self.translations, axis=1).sum())

    @property
    def sum(self) -> NDArray[np.float64]:
        """All translations together (3,), as if the vehicle did not turn, metres."""
        total: NDArray[np.float64] = self.translations.sum(axis=0)
        return total


def motion_findings(lidars: Sequence[Motions]) -> list[Finding]:
    """Say which LiDARs move as no vehicle does.

    Args:
        lidars: The motions of each LiDAR.

    Returns:
        ``lidars_disagree`` for the LiDARs whose extrinsics are wrong against others', and
        ``moves_sideways`` where all agree on a way that is not along the x axis.
    """
    driven = [item for item in lidars if leads_on(item)]
    found = [_compare(one, other) for one, other in combinations(driven, 2)]
    disagreeing = [finding for finding in found if finding is not None]
    if disagreeing:
        return disagreeing
    return [finding for item in driven if (finding := _heading(item)) is not None]


def leads_on(item: Motions) -> bool:
    """Whether a LiDAR saw enough of a way that has a direction."""
    if len(item.starts) < FEWEST:
        return False
    length = float(np.linalg.norm(item.sum))
    return length > SHORTEST and length > STRAIGHT * item.path


def same_moments(
    one: Motions, other: Motions
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Velocities of two LiDARs at the same moments.

    Args:
        one: Whose moments they are.
        other: Whose velocities are interpolated to them.

    Returns:
        Velocities (K, 3) of each in base_link, m/s, where both are faster than noise; None where
        these are too few to judge.
    """
    mine = (one.starts + one.ends) // 2
    theirs = (other.starts + other.ends) // 2
    origin = min(int(mine[0]), int(theirs[0]))
    at, known = (mine - origin) / NANOSECONDS, (theirs - origin) / NANOSECONDS
    first = one.translations / one.seconds[:, None]
    rates = other.translations / other.seconds[:, None]
    second = np.stack([np.interp(at, known, column) for column in rates.T], axis=1)
    fast = (at >= known[0]) & (at <= known[-1])
    fast &= np.linalg.norm(first, axis=1) > SLOWEST
    fast &= np.linalg.norm(second, axis=1) > SLOWEST
    return (first[fast], second[fast]) if fast.sum() >= FEWEST else None


def _compare(one: Motions, other: Motions) -> Finding | None:
    """Hold the velocities of two LiDARs at the same moments against each other."""
    pair = same_moments(one, other)
    if pair is None:
        return None
    first, second = pair
    degrees = angle(first.sum(axis=0), second.sum(axis=0))
    units = [item / np.linalg.norm(item, axis=1, keepdims=True) for item in (first, second)]
    scatter = float(np.degrees((units[1] - units[0]).std(axis=0).max()))
    if degrees < max(TURNED, SIGNIFICANT * scatter / np.sqrt(len(first))):
        return None
    off = {item.sensor: angle(item.sum, FORWARD) for item in (one, other)}
    suspect = max(off, key=lambda name: off[name])
    certain = off[suspect] > 2.0 * min(off.values()) + TURNED / 2.0
    names = suspect if certain else f'{one.sensor}, {other.sensor}'
    remedy = ' and '.join(f'lidars.{name}.T_base_sensor' for name in names.split(', '))
    directions = ', '.join(
        f'{name} {_direction(item)}' for name, item in ((one.sensor, one), (other.sensor, other))
    )
    return Finding(
        'lidars_disagree',
        Severity.ERROR if degrees > APART else Severity.WARNING,
        names,
        f'the motions of {one.sensor} and {other.sensor} are turned by {degrees:.0f} degrees '
        f'against each other over {one.path:.0f} m, which no vehicle does: in base_link '
        f'{directions}',
        f'check {remedy} (sensor to base_link, x forward, y left, z up)',
    )


def _heading(item: Motions) -> Finding | None:
    """Hold the way against the x axis."""
    degrees = angle(item.sum, FORWARD)
    if degrees < SIDEWAYS or item.path < FAR:
        return None
    return Finding(
        'moves_sideways',
        Severity.WARNING,
        item.sensor,
        f'by its odometry the vehicle moves {_direction(item)} for {item.path:.0f} m, '
        f'{degrees:.0f} degrees off the x axis of base_link',
        f'check lidars.{item.sensor}.T_base_sensor (sensor to base_link, x forward, y left, z up); '
        'right only where the vehicle really moves like that',
    )


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Fixes in ENU: stamps (F,) ns ascending, positions (F, 3) and standard deviations (F,), m."""

    stamps: NDArray[np.int64]
    positions: NDArray[np.float64]
    sigmas: NDArray[np.float64]


def distance_findings(lidars: Sequence[Motions], track: Track) -> list[Finding]:
    """Hold the ways of LiDARs against that of the fixes.

    Args:
        lidars: The motions of each LiDAR.
        track: The fixes of the map.

    Returns:
        ``distance_disagrees`` for each LiDAR that reads far less or far more.
    """
    found = []
    for item in lidars:
        ratios = distance_ratios(item, track)
        if len(ratios) < STRETCHES:
            continue
        ratio = float(np.median(ratios))
        share = max(float(np.mean(ratios < SHORT)), float(np.mean(ratios > LONG)))
        alike = float(np.quantile(np.abs(ratios / ratio - 1.0), MOST)) < ALIKE
        little = len(ratios) >= MANY and alike and not NEAR[0] <= ratio <= NEAR[1]
        if not little and (SHORT <= ratio <= LONG or share < MOST):
            continue
        found.append(
            Finding(
                'distance_disagrees',
                # Too little is read where matches slip; nothing makes them read too much.
                Severity.ERROR if ratio > LONG else Severity.WARNING,
                item.sensor,
                f'its odometry reads {ratio:.2f} times the way that the fixes say, over '
                f'{len(ratios)} stretches',
                'too little: odometry.method gicp instead of kiss_icp, and a smaller '
                'odometry.voxel_size; else check the unit of the points (lidars.NAME.scale), the '
                'stamps, and the degrees of the fixes',
            )
        )
    return found


def distance_ratios(item: Motions, track: Track) -> NDArray[np.float64]:
    """Way by a LiDAR over way by the fixes (S,), for stretches that stand out from their noise."""
    if len(item.starts) < FEWEST or len(track.stamps) < 2:
        return np.zeros(0)
    lengths = np.linalg.norm(item.translations, axis=1)
    origin = int(item.starts[0])
    ends = (item.ends - origin) / NANOSECONDS
    ways = np.cumsum(lengths)
    at = (track.stamps - origin) / NANOSECONDS
    covered = (at >= 0.0) & (at <= ends[-1])
    if not covered.any():
        return np.zeros(0)
    # A hole in the odometry would count as standing. There are some in most drives: while the car
    # stands, and where a window needs only one of two LiDARs.
    gone = np.flatnonzero(item.starts[1:] - item.ends[:-1] > HOLE * NANOSECONDS)
    from_, until = ends[gone], (item.starts[gone + 1] - origin) / NANOSECONDS
    at, places, sigmas = at[covered], track.positions[covered, :2], track.sigmas[covered]
    reached = np.interp(at, [0.0, *ends], [0.0, *ways])
    ratios, last = [], 0
    for index in range(1, len(at)):
        if np.any((from_ < at[index]) & (until > at[last])):
            last = index
            continue
        apart = float(np.linalg.norm(places[index] - places[last]))
        noise = float(np.hypot(sigmas[index], sigmas[last]))
        if apart > max(STRETCH, OUT_OF_NOISE * noise):
            ratios.append(float(reached[index] - reached[last]) / apart)
            last = index
    return np.array(ratios)


def angle(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Angle between two vectors (3,), degrees."""
    sine = float(np.linalg.norm(np.cross(one, other)))
    return float(np.degrees(np.arctan2(sine, float(one @ other))))


def _direction(item: Motions) -> str:
    """Where a motion points in base_link, in words."""
    words = (('forward', 'backward'), ('to the left', 'to the right'), ('up', 'down'))
    unit = item.sum / np.linalg.norm(item.sum)
    parts = [
        words[axis][int(unit[axis] < 0)]
        for axis in np.argsort(-np.abs(unit))
        if abs(unit[axis]) > 0.1
    ]
    return ' and '.join(parts)
