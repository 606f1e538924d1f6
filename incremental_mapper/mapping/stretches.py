"""The matches of each LiDAR over some seconds at a time, held against a solved map."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.bends import STRETCH, Stretches
from incremental_mapper.frontend.match_noise import carried
from incremental_mapper.graph.factors import Factor, FactorKind
from incremental_mapper.measurements import NANOSECONDS


@dataclass(slots=True)
class _Chain:
    """Matches that follow each other, composed.

    ``covariance`` (6, 6) is that of ``T_first_last``, in the frame of the last scan.
    """

    first: int
    last: int
    start: int
    T_first_last: gtsam.Pose3 = field(default_factory=gtsam.Pose3)
    covariance: NDArray[np.float64] = field(default_factory=lambda: np.zeros((6, 6)))


def stretches(factors: Iterable[Factor], values: gtsam.Values) -> list[Stretches]:
    """Hold the matches of each LiDAR, some seconds at a time, against a map.

    Args:
        factors: Of any kind; those of odometry are looked at.
        values: The poses of their clusters.

    Returns:
        The stretches of each LiDAR that has any.
    """
    by_sensor: dict[str, list[Factor]] = {}
    for factor in factors:
        if factor.kind is FactorKind.ODOMETRY:
            by_sensor.setdefault(factor.sensor or '', []).append(factor)
    made = (_of_lidar(sensor, own, values) for sensor, own in sorted(by_sensor.items()))
    return [one for one in made if len(one.stamps)]


def _of_lidar(sensor: str, factors: list[Factor], values: gtsam.Values) -> Stretches:
    rows = []
    chain: _Chain | None = None
    for factor in sorted(factors, key=lambda factor: factor.stamps):
        first, last = factor.keys
        if chain is None or chain.last != first:
            chain = _Chain(first, first, factor.stamps[0])
        measured: Any = factor.factor
        motion = measured.measured()
        noise = measured.noiseModel().covariance()
        chain.covariance = carried(chain.covariance, motion.inverse()) + noise
        chain.T_first_last = chain.T_first_last.compose(motion)
        chain.last = last
        if factor.stamps[1] - chain.start >= STRETCH * NANOSECONDS:
            rows.append((factor.stamps[1], *_off(chain, values)))
            chain = None
    stamps, metres, deviations = zip(*rows, strict=True) if rows else ((), (), ())
    return Stretches(
        sensor, np.array(stamps, dtype=np.int64), np.array(metres), np.array(deviations)
    )


def _off(chain: _Chain, values: gtsam.Values) -> tuple[float, float]:
    """How far the map is from a chain of matches: metres, and standard deviations of an axis."""
    mapped = values.atPose3(chain.first).between(values.atPose3(chain.last))
    apart = chain.T_first_last.between(mapped).translation()
    squared = float(apart @ np.linalg.solve(chain.covariance[3:, 3:], apart))
    return float(np.linalg.norm(apart)), float(np.sqrt(squared / len(apart)))
