"""A graph as plain values and GTSAM's own text: how journals and sessions hold it."""

import json
import zlib
from collections.abc import Mapping, Sequence
from itertools import accumulate, pairwise
from typing import Any

import gtsam
import numpy as np

from incremental_mapper.candidates.model import Cluster, CoreKind, CoreMeasurement
from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.graph.factors import Factor, FactorKind, beside_gtsam, describer
from incremental_mapper.smoothing.graph_state import PlacedCluster, PlacedFix

Tree = Mapping[str, Any]
FAST = 1
"""Level of compression."""


def packed(tree: dict[str, Any], *texts: str) -> bytes:
    """A tree, and texts behind it, whose lengths it tells."""
    tree['texts'] = [len(text) for text in texts]
    text = json.dumps(tree, default=_plain, separators=(',', ':'))
    return zlib.compress('\n'.join([text, ''.join(texts)]).encode('ascii'), FAST)


def _plain(value: Any) -> Any:
    """What numpy holds, as JSON has it."""
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    raise TypeError(f'{type(value).__name__} cannot be written')


def unpacked(data: bytes) -> dict[str, Any]:
    """What ``packed`` was given: the tree, with its texts in place of their lengths.

    Args:
        data: What it gave.

    Raises:
        ValueError: It is none.
    """
    try:
        text, _, rest = zlib.decompress(data).decode('ascii').partition('\n')
    except zlib.error as error:
        raise ValueError(str(error)) from error
    tree: dict[str, Any] = json.loads(text)
    ends = list(accumulate(tree['texts'], initial=0))
    tree['texts'] = [rest[low:high] for low, high in pairwise(ends)]
    return tree


def core_tree(core: CoreMeasurement) -> list[Any]:
    """A measurement as plain values."""
    return [core.stamp, core.sensor, str(core.kind)]


def cluster_tree(placed: PlacedCluster) -> dict[str, Any]:
    """A cluster as plain values."""
    cluster = placed.cluster
    return {
        'id': placed.id,
        'window': placed.window,
        'members': [core_tree(core) for core in cluster.members],
        'bounds': [cluster.first, cluster.last],
        'joined': [core_tree(core) for core in placed.joined],
        'stood': placed.stood,
    }


def fix_tree(fix: PlacedFix) -> dict[str, Any]:
    """A fix as plain values."""
    return {
        'cluster': fix.cluster,
        'stamp': fix.stamp,
        'enu': fix.enu,
        'covariance': fix.covariance,
        'lever_arm': fix.lever_arm,
        'factor': fix.factor,
    }


def factor_tree(factor: Factor) -> dict[str, Any]:
    """What GTSAM does not hold of a factor, as plain values."""
    return {
        'kind': str(factor.kind),
        'keys': factor.keys,
        'sensor': factor.sensor,
        'stamps': factor.stamps,
        'beside': beside_gtsam(factor),
    }


def values_of(text: str) -> gtsam.Values:
    """The values of what GTSAM wrote; none of an empty text."""
    values = gtsam.Values()
    if text:
        values.deserialize(text)
    return values


def core_of(tree: list[Any]) -> CoreMeasurement:
    """What ``core_tree`` was made of."""
    stamp, sensor, kind = tree
    return CoreMeasurement(stamp, sensor, CoreKind(kind))


def cluster_of_tree(tree: Tree) -> PlacedCluster:
    """What ``cluster_tree`` was made of."""
    cluster = Cluster(tuple(map(core_of, tree['members'])), *tree['bounds'])
    joined = tuple(map(core_of, tree['joined']))
    return PlacedCluster(tree['id'], tree['window'], cluster, joined, tuple(tree['stood']))


def fix_of(tree: Tree) -> PlacedFix:
    """What ``fix_tree`` was made of."""
    return PlacedFix(
        tree['cluster'],
        tree['stamp'],
        np.array(tree['enu']),
        np.array(tree['covariance']),
        np.array(tree['lever_arm']),
        tree['factor'],
    )


def factors_of(trees: list[dict[str, Any]], text: str) -> list[Factor]:
    """Factors: what ``factor_tree`` told of each, and their graph as GTSAM wrote it."""
    graph = gtsam.NonlinearFactorGraph()
    if text:
        graph.deserialize(text)
    made = []
    for place, told in enumerate(trees):
        kind = FactorKind(told['kind'])
        made.append(
            Factor(
                kind=kind,
                keys=tuple(told['keys']),
                factor=graph.at(place),
                sensor=told['sensor'],
                stamps=tuple(told['stamps']),
                describe=describer(kind, told['beside']),
            )
        )
    return made


def findings_of(trees: Sequence[Tree]) -> tuple[Finding, ...]:
    """Findings of what ``Finding.to_tree`` told of them."""
    return tuple(Finding(**{**tree, 'severity': Severity(tree['severity'])}) for tree in trees)
