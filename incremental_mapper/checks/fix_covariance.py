"""Which fixes may be used, by what they say of themselves, and how far they are trusted."""

import math

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.config import GnssSettings
from incremental_mapper.errors import MeasurementError
from incremental_mapper.measurements import NO_VERTICAL_SIGMA, GnssFix


def checked_covariance(fix: GnssFix, settings: GnssSettings) -> NDArray[np.float64]:
    """Covariance of a fix, with the settings' floor in every direction, or their default.

    The vertical of a fix without altitude has the standard deviation ``NO_VERTICAL_SIGMA``.

    Args:
        fix: A fix of the antenna.
        settings: Wanted status, floor, limit and default.

    Returns:
        Covariance (3, 3) in ENU, m^2.

    Raises:
        MeasurementError: The fix is below the wanted status, or too uncertain.
    """
    where = f'{fix.sensor} at {fix.stamp}'
    if fix.status < settings.min_status:
        raise MeasurementError(
            'low_status', f'{where}: status {fix.status.name} is below fixes.min_status'
        )
    if fix.covariance is None:
        vertical = NO_VERTICAL_SIGMA if math.isnan(fix.altitude) else settings.default_sigma
        return np.diag([settings.default_sigma, settings.default_sigma, vertical]) ** 2
    horizontal = float(np.sqrt(max(fix.covariance[0, 0], fix.covariance[1, 1])))
    if horizontal > settings.max_sigma:
        raise MeasurementError(
            'too_uncertain',
            f'{where}: standard deviation {horizontal:.2f} m is above fixes.max_sigma '
            f'{settings.max_sigma} m',
        )
    covariance = (fix.covariance + fix.covariance.T) / 2.0
    # A floor on every axis, and on every direction between them.
    values, vectors = np.linalg.eigh(covariance)
    floored: NDArray[np.float64] = (vectors * np.maximum(values, settings.min_sigma**2)) @ vectors.T
    return floored
