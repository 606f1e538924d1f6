"""What holds two sessions together where one goes on as the other ends: a recording in two files.

Within a moment a vehicle moves on as it did, and its IMU is the same: without that the second
session begins cold, and the two are 1 to 2 cm apart in height where they meet.
"""

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.config import Config
from incremental_mapper.graph.factors import Factor, FactorKind, between_factor, bias_random_walk
from incremental_mapper.mapping.result import MapResult
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.variables import bias_key, cluster_of, kind_of, pose_key, velocity_key

LONGEST = 1.0
"""Seconds between two sessions of one recording, at the most."""
SAME_PLACE = 2.0
"""Metres by which the second one may begin elsewhere than the first one leads: fixes tell both
places, and another vehicle is not so near."""
NEAR = 0.5
"""Seconds within which a velocity is that of the end of a session."""
ACCELERATION, RATE = 1.0, 0.5
"""What the vehicle may do between its two velocities besides what they say, m/s^2, and how it may
turn, rad/s: both are told by what comes before and after, better than by this."""
LEAST_TRANSLATION, LEAST_ROTATION = 0.003, 0.002
"""Standard deviations for the shortest gap, metres and radians."""


def seam_factors(before: MapResult, after: MapResult, config: Config) -> list[Factor]:
    """Factors between the last poses of a map and the first ones of the session that goes on.

    Args:
        before: The map before.
        after: The session, in the same frame.
        config: All settings of it.

    Returns:
        The motion between the two by their velocities, and the walk of the IMU's bias, under the
        numbers of the joint map; nothing where the one does not go on as the other ends.
    """
    last, first = before.clusters[-1], after.clusters[0]
    gap = (first.cluster.stamp - last.cluster.stamp) / NANOSECONDS
    ends = _velocity(before, last.id, -1), _velocity(after, first.id, 1)
    if not 0.0 < gap <= LONGEST or ends[0] is None or ends[1] is None:
        return []
    here = before.values.atPose3(pose_key(last.id))
    there = after.values.atPose3(pose_key(first.id))
    moved = 0.5 * gap * (ends[0] + ends[1])
    if np.linalg.norm(there.translation() - here.translation() - moved) > SAME_PLACE:
        return []
    count, stamps = len(before.clusters), (last.cluster.stamp, first.cluster.stamp)
    translation = LEAST_TRANSLATION + ACCELERATION * gap**2
    rotation = LEAST_ROTATION + RATE * gap
    factors = [
        between_factor(
            FactorKind.DEAD_RECKONING,
            (pose_key(last.id), pose_key(first.id + count)),
            gtsam.Pose3(here.rotation().between(there.rotation()), here.rotation().unrotate(moved)),
            np.diag(np.square([rotation] * 3 + [translation] * 3)),
            None,
            stamps,
        )
    ]
    biases = [_of_kind(part, 'b') for part in (before, after)]
    if all(biases):
        imu = config.preintegration
        walks = [imu.accelerometer_bias_walk] * 3 + [imu.gyroscope_bias_walk] * 3
        keys = bias_key(biases[0][-1]), bias_key(biases[1][0] + count)
        # A bias is that of a second of spans.
        passed = gap + config.graph.bias_period
        factors.append(bias_random_walk(keys, np.sqrt(passed) * np.array(walks), stamps))
    return factors


def _velocity(part: MapResult, end: int, step: int) -> NDArray[np.float64] | None:
    """Velocity (3,) at an end of a session, m/s in the map, from where ``step`` leads inwards."""
    stamp = part.clusters[end].cluster.stamp
    inside = range(end, len(part.clusters) if step > 0 else -1, step)
    for number in inside:
        passed = abs(part.clusters[number].cluster.stamp - stamp) / NANOSECONDS
        if passed > NEAR:
            return None
        if part.values.exists(velocity_key(number)):
            velocity: NDArray[np.float64] = part.values.atVector(velocity_key(number))
            return velocity
    return None


def _of_kind(part: MapResult, kind: str) -> list[int]:
    """Numbers of the clusters that have a variable of a kind, ascending."""
    keys = part.values.keys()
    return sorted(cluster_of(key) for key in keys if kind_of(key) == kind)
