"""Two measurements of one sensor with one stamp: which of them is used."""

from collections.abc import Callable

import numpy as np

from incremental_mapper.checks.fix_covariance import checked_covariance
from incremental_mapper.config import Config
from incremental_mapper.errors import MeasurementError
from incremental_mapper.measurements import CoreInput, LidarScan

FULLER = 2.0
"""A later cloud takes the place of one that came before where it has so many times the points
within range. Less may be chance, or the other half of a sweep: then the first one stays."""


def prefer_usable(config: Config) -> Callable[[CoreInput, CoreInput], bool]:
    """Make the rule that a measurement which cannot be used displaces none that can.

    Args:
        config: What is within range, and which fixes are used.

    Returns:
        Tells of a new measurement and the one that is held, both of one sensor and stamp, whether
        the new one takes its place.
    """

    def better(new: CoreInput, held: CoreInput) -> bool:
        if isinstance(new, LidarScan) and isinstance(held, LidarScan):
            return _in_range(new, config) > FULLER * _in_range(held, config)
        return _worth(new, config) and not _worth(held, config)

    return better


def _in_range(scan: LidarScan, config: Config) -> int:
    """How many different points of a scan can be used."""
    least, most = config.odometry.min_range, config.odometry.max_range
    with np.errstate(over='ignore'):
        squares = (scan.points * scan.points).sum(axis=1)
    kept = scan.points[(squares >= least**2) & (squares <= most**2)]
    return len(np.unique(kept, axis=0))


def _worth(item: CoreInput, config: Config) -> bool:
    """Whether a fix would be used."""
    if isinstance(item, LidarScan):
        return True
    try:
        checked_covariance(item, config.fixes)
    except MeasurementError:
        return False
    return True
