"""Whether the track of the fixes has the shape of odometry's: mirrored, exchanged, of another size.

A turn and a shift lie between the two, nothing else. Latitude and longitude that are exchanged
where both are in range, and a longitude that lost its sign, make a mirrored track: in a bend no
turn lays it on that of odometry. On a straight road nobody can tell.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pymap3d
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding, Severity

FEWEST = 10
"""Fixes that tell a shape."""
BENT = 3.0
"""Metres, in the smaller direction of odometry's track, from which it is bent."""
LENGTH = 20.0
"""Metres that it spreads at least."""
MISFIT, NOISE = 0.05, 5.0
"""Share of a track's extent, beside so many deviations of the fixes, by which the two differ at
least (root mean square) where something is wrong. Simulated drives with bends and KITTI: 0.002 to
0.01 of the extent."""
_CAUSES = {
    'optimistic_covariance': {'exchanged_degrees', 'lost_sign', 'gnss_clock', 'point_unit'},
    'imu_noise': {'imu_in_deg', 'imu_rate_unit', 'imu_rate_scale'},
    'imu_in_deg': {'imu_disagrees'},
    'imu_rate_unit': {'imu_disagrees'},
}
"""Rules, and those whose finding explains what they found before."""
BETTER = 0.2
"""Share of that misfit that is left, at most, where the cause is found."""
STRETCHED, WIDE = 0.015, 5.0
"""Share of the extent by which a track is off at least, and metres in its smaller direction, where
it may be stretched."""
LONGER = 0.04
"""By which it must be too long or too short to the east or to the north. Sound drives with bends:
at most 0.02; a field without structure 0.06, but there that explains only half of the misfit.
Gons: 0.05 and 0.13."""
GON = 0.9
"""Degrees in a gon."""


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """Fixes, and the same places by odometry.

    Attributes:
        degrees: Latitude and longitude (K, 2) as received.
        local: Position of the antenna by odometry (K, 2), metres.
        sigma: Median horizontal deviation of the fixes, metres.
        stretches: Number (K,) of the stretch, without a hole in odometry, that each lies in; None
            where there is only one. Over a hole odometry is a guess, which may turn and shift what
            follows by metres.
    """

    degrees: NDArray[np.float64]
    local: NDArray[np.float64]
    sigma: float
    stretches: NDArray[np.int64] | None = None

    @property
    def bent(self) -> float:
        """Metres in the smaller direction of odometry's track, root mean square."""
        spread = np.linalg.svd(self.local - self.local.mean(axis=0), compute_uv=False)
        return float(spread[1] / np.sqrt(len(self.local)))

    @property
    def extent(self) -> float:
        """Metres from corner to corner of odometry's track."""
        return float(np.hypot(*np.ptp(self.local, axis=0)))

    def longest(self) -> 'Shape':
        """Its longest stretch, by the number of fixes."""
        if self.stretches is None:
            return self
        numbers, counts = np.unique(self.stretches, return_counts=True)
        inside = self.stretches == numbers[counts.argmax()]
        return Shape(self.degrees[inside], self.local[inside], self.sigma)


def shape_finding(sensor: str, shape: Shape) -> Finding | None:
    """Hold the shapes of the two tracks against each other.

    Args:
        sensor: Name of the receiver.
        shape: Fixes of a few hundred metres, over which odometry hardly drifts.

    Returns:
        ``exchanged_degrees`` or ``lost_sign``, mended; ``track_stretched``, an error; None where
        the shapes agree, or where none of these is what is wrong.
    """
    if len(shape.local) < FEWEST or shape.bent < BENT or shape.extent < LENGTH:
        return None
    now = misfit(metres(shape.degrees), shape.local)
    least = MISFIT * shape.extent + NOISE * shape.sigma
    if now < least:
        return _stretched(sensor, shape.longest())
    latitude, longitude = shape.degrees.T
    causes = []
    if np.abs(longitude).max() <= 90.0:
        exchanged = np.stack([longitude, latitude], axis=1)
        causes.append((misfit(metres(exchanged), shape.local), 'exchanged_degrees'))
    signed = np.stack([latitude, -longitude], axis=1)
    causes.append((misfit(metres(signed), shape.local), 'lost_sign'))
    left, rule = min(causes)
    if left > min(BETTER * now, least):
        return None
    what, key = {
        'exchanged_degrees': ('latitude and longitude are exchanged', 'exchanged'),
        'lost_sign': ('the longitude has the wrong sign, west for east', 'mirrored'),
    }[rule]
    return Finding(
        rule,
        Severity.MENDED,
        sensor,
        f'{what}: the track of {len(shape.local)} fixes is off that of odometry by {now:.1f} m as '
        f'it is, and by {left:.1f} m with that put right',
        f'put right as with fixes.{key}: true; correct the driver',
        {'fixes': {key: True}},
    )


def _stretched(sensor: str, shape: Shape) -> Finding | None:
    """A track that is too long to the east or to the north, and otherwise the same."""
    if len(shape.local) < FEWEST or shape.bent < WIDE:
        return None
    enu = metres(shape.degrees)
    now = misfit(enu, shape.local)
    if now < STRETCHED * shape.extent + NOISE * shape.sigma:
        return None
    fixes, places = enu - enu.mean(axis=0), shape.local - shape.local.mean(axis=0)
    affine = np.linalg.lstsq(places, fixes, rcond=None)[0]
    left = float(np.sqrt(np.mean(np.sum((fixes - places @ affine) ** 2, axis=1))))
    scales = np.linalg.norm(affine, axis=0)
    if left > BETTER * now or np.abs(scales - 1.0).max() < LONGER:
        return None
    in_gons = misfit(metres(shape.degrees * GON), shape.local) < BETTER * now
    unit = ': latitude and longitude in gons, 400 of which are a circle' if in_gons else ''
    return Finding(
        'track_stretched',
        Severity.ERROR,
        sensor,
        f'the track of {len(fixes)} fixes is that of odometry, but {_percent(scales[0])} from west '
        f'to east and {_percent(scales[1])} from south to north{unit}',
        'let the driver send degrees of WGS 84'
        if in_gons
        else 'correct what the driver sends: another unit, coordinates of a grid',
    )


def _percent(scale: float) -> str:
    return f'{abs(scale - 1.0):.0%} too {"long" if scale > 1.0 else "short"}'


def without_consequences(before: Sequence[Finding], now: Sequence[Finding]) -> list[Finding]:
    """Take back what was found only because of something that was not known yet.

    Fixes scatter where their track is misshapen, and a gyroscope is loud in the wrong unit.

    Args:
        before: What was found in earlier runs.
        now: What was found since.
    """
    rules = {finding.rule for finding in now}
    follows = {rule for rule, causes in _CAUSES.items() if rules & causes}
    return [one for one in before if one.rule not in follows]


def metres(degrees: NDArray[np.float64]) -> NDArray[np.float64]:
    """East and north (K, 2) of the first of some places, latitude and longitude (K, 2)."""
    latitude, longitude = degrees.T
    east, north, _ = pymap3d.geodetic2enu(latitude, longitude, 0.0, *degrees[0], 0.0)
    return np.stack([east, north], axis=1)


def misfit(enu: NDArray[np.float64], local: NDArray[np.float64], scaled: bool = False) -> float:
    """Root mean square distance (m) of two tracks (K, 2) with the best turn and shift.

    Args:
        enu: One track.
        local: The other, which is moved.
        scaled: Whether its size may change too.
    """
    a, b = enu - enu.mean(axis=0), local - local.mean(axis=0)
    # As complex numbers a turn is one factor of size 1.
    one, other = a[:, 0] + 1j * a[:, 1], b[:, 0] + 1j * b[:, 1]
    turn = np.vdot(other, one)
    turn /= max(np.vdot(other, other).real if scaled else abs(turn), 1e-12)
    return float(np.sqrt(np.mean(np.abs(one - turn * other) ** 2)))
