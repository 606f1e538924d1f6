"""``graph.json``: every variable, cluster and factor of G(t) in plain values."""

from collections.abc import Sequence
from typing import Any

import gtsam

from incremental_mapper.graph.factors import Factor, pose_numbers
from incremental_mapper.graph.values import cluster_of, key_name, kind_of
from incremental_mapper.smoothing.graph_state import PlacedCluster

KINDS = {'x': 'pose', 'v': 'velocity', 'b': 'bias'}


def graph_tree(
    clusters: Sequence[PlacedCluster], factors: Sequence[Factor], values: gtsam.Values
) -> dict[str, Any]:
    """All of G(t) in plain values, as ``graph.json`` holds it.

    Args:
        clusters: The clusters of G(t), each with its place.
        factors: The factors of G(t).
        values: The estimate: a pose T_map_base for each cluster, and a velocity (m/s, in the map)
            and a bias for those that IMU spans touch.

    Returns:
        ``format``, ``frame``, ``units``, and three lists. ``variables``: key, kind (pose, velocity
        or bias), cluster, stamp_ns and value (of a pose x, y, z and the quaternion x, y, z, w).
        ``clusters``: id, window, stamp_ns, first_ns, last_ns and members (sensor, kind, stamp_ns).
        ``factors``: kind, variables, sensor, stamps_ns, and what the factor measured.
    """
    stamps = {placed.id: placed.cluster.stamp for placed in clusters}
    keys = sorted(
        (int(key) for key in values.keys()),  # noqa: SIM118 (no mapping)
        key=lambda key: (cluster_of(key), kind_of(key) != 'x', key),
    )
    return {
        'format': 1,
        'frame': 'map',
        'units': 'metres, radians, seconds; stamps in nanoseconds',
        'variables': [
            {
                'key': key_name(key),
                'kind': KINDS[kind_of(key)],
                'cluster': cluster_of(key),
                'stamp_ns': stamps[cluster_of(key)],
                'value': _value(values, key),
            }
            for key in keys
        ],
        'clusters': [
            {
                'id': placed.id,
                'window': placed.window,
                'stamp_ns': placed.cluster.stamp,
                'first_ns': placed.cluster.members[0].stamp,
                'last_ns': placed.cluster.members[-1].stamp,
                'members': [
                    {'sensor': core.sensor, 'kind': str(core.kind), 'stamp_ns': core.stamp}
                    for core in placed.cluster.members
                ],
            }
            for placed in clusters
        ],
        'factors': [
            {
                'kind': str(factor.kind),
                'variables': [key_name(key) for key in factor.keys],
                'sensor': factor.sensor,
                'stamps_ns': list(factor.stamps),
                **factor.data,
            }
            for factor in factors
        ],
    }


def _value(values: gtsam.Values, key: int) -> list[float]:
    kind = key_name(key)[0]
    if kind == 'x':
        return pose_numbers(values.atPose3(key))
    vector = values.atVector(key) if kind == 'v' else values.atConstantBias(key).vector()
    return [float(number) for number in vector]
