"""Whether two LiDARs on one vehicle read the same way: ranges that are too long lengthen it."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.checks.motions import (
    STRETCHES,
    Motions,
    Track,
    distance_ratios,
    leads_on,
    same_moments,
)

APART = 0.07
"""Relative difference of two ways from which ranges are not the same. Sound runs (nine simulated
drives over streets and bends, gicp): 0.005 to 0.035. Ranges 10 per cent too long: 0.10 to 0.11."""
SIGNIFICANT = 4.0
"""How many times its standard error the difference must be; it was 4.6 to 5.5 there."""


def way_findings(lidars: Sequence[Motions], track: Track) -> list[Finding]:
    """Say which LiDARs read another way than the rest.

    Args:
        lidars: The motions of each LiDAR.
        track: The fixes of the map, which tell whose way is right.

    Returns:
        ``ways_differ`` for each pair that does.
    """
    driven = [item for item in lidars if leads_on(item)]
    found = (_compare(one, other, track) for one, other in combinations(driven, 2))
    return [finding for finding in found if finding is not None]


def _compare(one: Motions, other: Motions, track: Track) -> Finding | None:
    pair = same_moments(one, other)
    if pair is None:
        return None
    speeds = [np.linalg.norm(velocities, axis=1) for velocities in pair]
    # Over the whole way noise is small; single motions tell how large it is.
    lengths = [float(np.linalg.norm(velocities.sum(axis=0))) for velocities in pair]
    apart = float(np.log(lengths[0] / lengths[1]))
    error = float(np.log(speeds[0] / speeds[1]).std()) / np.sqrt(len(speeds[0]))
    if abs(apart) < max(np.log1p(APART), SIGNIFICANT * error):
        return None
    ratio = float(np.exp(apart))
    wrong = _wrong_one(one, other, track)
    if wrong is None:
        longer = one if ratio > 1.0 else other
        shorter = other if longer is one else one
        remedy = (
            f'set lidars.{longer.sensor}.scale: {min(ratio, 1.0 / ratio):.3f}, or '
            f'lidars.{shorter.sensor}.scale: {max(ratio, 1.0 / ratio):.3f}, times what it is now, '
            'whichever has the wrong ranges'
        )
        names = f'{one.sensor}, {other.sensor}'
    else:
        scale = ratio if wrong is other else 1.0 / ratio
        remedy = f'set lidars.{wrong.sensor}.scale: {scale:.3f}, times what it is now'
        names = wrong.sensor
    return Finding(
        'ways_differ',
        Severity.WARNING,
        names,
        f'the odometry of {one.sensor} reads {ratio:.2f} times the way of {other.sensor} over '
        f'{one.path:.0f} m, which on one vehicle means ranges that are too long or too short',
        remedy,
    )


def _wrong_one(one: Motions, other: Motions, track: Track) -> Motions | None:
    """Which of the two reads another way than the fixes; None where they do not tell."""
    off = []
    for item in (one, other):
        ratios = distance_ratios(item, track)
        if len(ratios) < STRETCHES:
            return None
        off.append(abs(float(np.log(np.median(ratios)))))
    if min(off) > 0.5 * max(off):
        return None
    return one if off[0] > off[1] else other
