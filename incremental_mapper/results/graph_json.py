"""``graph.json``: G(t) in plain values, and whether two such graphs are the same."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np

from incremental_mapper.candidates.model import CoreMeasurement
from incremental_mapper.graph.factors import Factor, factors_data, poses_numbers
from incremental_mapper.smoothing.graph_state import PlacedCluster
from incremental_mapper.variables import cluster_of, key_name, kind_of

TOLERANCE = 1e-6
"""Largest difference of a number between equal graphs: metres, quaternions, m/s."""
KINDS = {'x': 'pose', 'v': 'velocity', 'b': 'bias'}


@dataclass(frozen=True, slots=True)
class Comparison:
    """What two graphs have in common; ``differences`` is empty where they are the same.

    The counts are those of the first graph; ``worst`` is the largest difference between numbers
    of the variables that both have.
    """

    clusters: int
    variables: int
    factors: int
    worst: float
    differences: tuple[str, ...]


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
        ``clusters``: id, window, stamp_ns, first_ns, last_ns and members (sensor, kind, stamp_ns),
        and, where the vehicle stood, what joined it later, as members are.
        ``factors``: kind, variables, sensor, stamps_ns, and what the factor measured.
    """
    stamps = {placed.id: placed.cluster.stamp for placed in clusters}
    keys = sorted(
        (int(key) for key in values.keys()),  # noqa: SIM118 (no mapping)
        key=lambda key: (cluster_of(key), kind_of(key) != 'x', key),
    )
    poses = [key for key in keys if kind_of(key) == 'x']
    numbers = dict(zip(poses, poses_numbers([values.atPose3(key) for key in poses]), strict=True))
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
                'value': numbers[key] if key in numbers else _value(values, key),
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
                'members': _core_trees(placed.cluster.members),
                **_joined(placed),
            }
            for placed in clusters
        ],
        'factors': [
            {
                'kind': str(factor.kind),
                'variables': [key_name(key) for key in factor.keys],
                'sensor': factor.sensor,
                'stamps_ns': list(factor.stamps),
                **data,
            }
            for factor, data in zip(factors, factors_data(factors), strict=True)
        ],
    }


def _core_trees(some: Sequence[CoreMeasurement]) -> list[dict[str, Any]]:
    return [{'sensor': c.sensor, 'kind': str(c.kind), 'stamp_ns': c.stamp} for c in some]


def _joined(placed: PlacedCluster) -> dict[str, Any]:
    return {'joined': _core_trees(placed.joined)} if placed.joined else {}


def compare_graphs(
    one: Mapping[str, Any], other: Mapping[str, Any], tolerance: float = TOLERANCE
) -> Comparison:
    """Compare two graphs: clusters and their members, factors, and values of variables.

    Args:
        one: A graph as ``graph_tree`` gives it.
        other: Another; the same has the same clusters and factors in the same order.
        tolerance: How far values may be apart, in their own units.
    """
    differences = [
        *_first_unequal('clusters', one['clusters'], other['clusters']),
        *_first_unequal('factors', *(list(map(_made_of, g['factors'])) for g in (one, other))),
    ]
    values, others = ({v['key']: v['value'] for v in g['variables']} for g in (one, other))
    if values.keys() != others.keys():
        unshared = sorted(values.keys() ^ others.keys())
        differences.append(
            f'{len(unshared)} variables are in one graph only, such as {unshared[0]}'
        )
    worst, place = 0.0, ''
    for key in values.keys() & others.keys():
        apart = _apart(values[key], others[key])
        if apart >= worst:
            worst, place = apart, key
    if worst > tolerance:
        differences.append(f'variable {place} differs by {worst:.3g}, more than {tolerance:g}')
    return Comparison(
        clusters=len(one['clusters']),
        variables=len(values),
        factors=len(one['factors']),
        worst=worst,
        differences=tuple(differences),
    )


def _value(values: gtsam.Values, key: int) -> list[float]:
    velocity = kind_of(key) == 'v'
    vector = values.atVector(key) if velocity else values.atConstantBias(key).vector()
    return [float(number) for number in vector]


def _first_unequal(what: str, one: Sequence[Any], other: Sequence[Any]) -> Iterator[str]:
    if len(one) != len(other):
        yield f'{len(one)} and {len(other)} {what}'
    for index, (left, right) in enumerate(zip(one, other, strict=False)):
        if left != right:
            yield f'{what} differ from number {index} on: {left} and {right}'
            return


def _made_of(factor: Mapping[str, Any]) -> dict[str, Any]:
    return {name: factor[name] for name in ('kind', 'variables', 'sensor', 'stamps_ns')}


def _apart(one: Sequence[float], other: Sequence[float]) -> float:
    left, right = np.array(one), np.array(other)
    if left.shape != right.shape:
        return float('inf')
    # A pose is position and quaternion, and a quaternion and its negative are the same turn.
    if len(left) == 7 and left[3:] @ right[3:] < 0:
        right[3:] *= -1
    # No number is as far from every number as can be.
    return float(np.nan_to_num(np.abs(left - right), nan=np.inf).max(initial=0.0))
