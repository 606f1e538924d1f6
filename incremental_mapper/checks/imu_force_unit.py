"""The unit of accelerations without gravity, by those of scan matching."""

import numpy as np

from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.checks.imu_gravity import UNITS
from incremental_mapper.checks.imu_motion import MotionEvidence, force_pairs
from incremental_mapper.config import Imu

FEWEST = 8
"""Seconds in which a car speeds up, brakes or turns."""
ALIKE = 0.8
"""Correlation of the two from which on they are the same motion: 0.94 in 25 s of bends."""
NEAR = 1.6
"""Factor by which the ratio of the two may be off a unit's."""


def force_unit_finding(evidence: MotionEvidence, settings: Imu) -> Finding | None:
    """Hold accelerations that have no gravity in them against those of scan matching.

    Where gravity is in them, its size tells the unit at once.

    Args:
        evidence: Matches and samples, with ``settings`` applied to these.
        settings: Those of the IMU.

    Returns:
        ``imu_in_g`` or ``imu_acceleration_unit``, mended; None where the unit is right, or too
        little is known.
    """
    if evidence.gravity > 0.0:
        return None
    seen, felt = force_pairs(evidence)
    if len(seen) < FEWEST:
        return None
    seen, felt = seen - seen.mean(axis=0), felt - felt.mean(axis=0)
    both, own = float((seen * felt).sum()), float((felt**2).sum())
    if both < ALIKE * np.sqrt(own * float((seen**2).sum())) or own == 0.0:
        return None
    for unit, name in UNITS.items():
        if 1.0 / NEAR < both / own / unit < NEAR:
            factor = unit * settings.acceleration_scale
            return Finding(
                'imu_in_g' if name.endswith('g') else 'imu_acceleration_unit',
                Severity.MENDED,
                'imu',
                f'accelerations, without gravity, are {own / both:.3g} times those of scan '
                f'matching over {len(seen)} s: they are in {name}',
                f'converted; imu.acceleration_scale: {factor:g}',
                {'imu': {'acceleration_scale': factor}},
            )
    return None
