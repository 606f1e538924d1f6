"""Whether the solved graph fits its measurements: by kind of factor, by sensor, and over time.

The squared residual of a factor, whitened by its noise and divided by its dimension, is about 1
where the noise is as the settings say. Robust losses are left out: they hide what is looked for.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.measurements import NANOSECONDS

SEGMENT = 5.0
"""Seconds that are judged together: what disagrees for a moment is the solver's to settle."""
FEWEST = 5
"""Factors that make a judgement; a receiver of 1 Hz has as many in a segment."""
DOUBTFUL = 6.0
"""Median of the squared residual per dimension in a segment from which a sensor is said to
disagree. Sound runs, four strategies, `kaist.yaml`, `kaist_paper.yaml` and the defaults: 0.7 at the
most. Two LiDARs turned by 90 degrees against each other: 29, by 180 degrees: 68; of 10 degrees the
residuals tell nothing (0.7), which is why motions are compared as well."""
DOUBTFUL_SPAN = 100.0
"""The same of IMU spans. In a map that still grows velocities and biases are not settled: 9 once in
60 s of a sound drive. Accelerations in g: 7000."""
HOPELESS = 15.0
"""The same over the whole drive, from which the map is not to be trusted: ATE of 1.7 m and more in
5 s in all cases above it, 0.09 m at the most in all below."""


OFF = 1.0
"""Metres by which fixes may disagree with the solved graph all along, and the map still be one."""
SMALL = {'gnss': 0.3}
"""Metres of which nothing is said, by kind, however small the deviations that a receiver tells:
fixes of RTK wander by as much between houses."""


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """Residuals of the factors of one kind and one sensor, at the solution.

    Attributes:
        kind: ``odometry``, ``gnss`` or ``imu``.
        sensor: Name of the sensor.
        stamps: Stamps (K,) of the last measurement of each factor, ns, in time order.
        squared: Squared whitened residuals (K,) by dimension, without any robust loss.
        metres: Lengths (K,) of the residuals' translations.
        radians: Angles (K,) of the residuals' rotations; 0 where they have none.
    """

    kind: str
    sensor: str
    stamps: NDArray[np.int64]
    squared: NDArray[np.float64]
    metres: NDArray[np.float64]
    radians: NDArray[np.float64]


def fit_findings(groups: Iterable[Residuals], first: int) -> list[Finding]:
    """Say which sensors the solved graph does not fit.

    Args:
        groups: Residuals of each kind of factor and sensor.
        first: Stamp of the first pose, from which seconds are told, ns.

    Returns:
        A finding for every kind and sensor that disagrees with the rest.
    """
    found = (_judge(group, first) for group in groups if len(group.stamps) >= FEWEST)
    return [finding for finding in found if finding is not None]


def _judge(group: Residuals, first: int) -> Finding | None:
    count = len(group.stamps)
    seconds = (group.stamps[-1] - group.stamps[0]) / NANOSECONDS
    parts = max(1, min(round(seconds / SEGMENT), count // FEWEST))
    pieces = np.array_split(np.arange(count), parts)
    medians = np.array([np.median(group.squared[piece]) for piece in pieces])
    bad = np.flatnonzero(medians > (DOUBTFUL_SPAN if group.kind == 'imu' else DOUBTFUL))
    if not len(bad):
        return None
    overall = float(np.median(group.squared))
    chosen = np.concatenate([pieces[index] for index in bad])
    if np.median(group.metres[chosen]) < SMALL.get(group.kind, 0.0):
        return None
    start, end = (
        (int(group.stamps[index]) - first) / NANOSECONDS for index in (chosen[0], chosen[-1])
    )
    where = 'all along' if len(bad) == parts else f'in {len(bad)} of {parts} parts'
    astray = group.kind == 'gnss' and overall > DOUBTFUL and np.median(group.metres) > OFF
    subject, cause = _words(group)
    return Finding(
        f'{group.kind}_misfit',
        Severity.ERROR if overall > HOPELESS or astray else Severity.WARNING,
        group.sensor,
        f'{subject} does not fit the other measurements {where}, from {start:.1f} s to '
        f'{end:.1f} s: it is off by {_size(group, chosen)}, '
        f'{np.sqrt(np.median(group.squared[chosen])):.0f} times its standard deviation',
        cause,
    )


def _size(group: Residuals, chosen: NDArray[np.intp]) -> str:
    metres = float(np.median(group.metres[chosen]))
    if group.kind == 'gnss':
        return f'{metres:.2f} m'
    degrees = float(np.degrees(np.median(group.radians[chosen])))
    each = 'from scan to scan' if group.kind == 'odometry' else 'a span'
    return f'{metres:.2f} m and {degrees:.2f} degrees {each}'


def _words(group: Residuals) -> tuple[str, str]:
    """What disagrees, and what to look at."""
    if group.kind == 'odometry':
        section = f'lidars.{group.sensor}'
        return (
            'its odometry',
            f'check {section}.T_base_sensor and those of the other LiDARs, and '
            f'{section}.time_offset; an IMU or fixes that are wrong pull at it as well',
        )
    if group.kind == 'gnss':
        return (
            'its track',
            'check gnss.time_offset (its clock), gnss.T_base_sensor (the antenna), whether the '
            'first fix is of this place, fixes.min_status, and T_base_sensor of the LiDARs',
        )
    return (
        'what it integrates',
        'check its units (m/s^2 and rad/s, gravity included), imu.T_base_sensor and '
        'imu.time_offset; without "imu" among the topics the map is made of the rest',
    )
