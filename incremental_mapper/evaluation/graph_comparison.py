"""Whether two saved graphs are the same: what was chosen, and where it lies."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from incremental_mapper.errors import InputError

TOLERANCE = 1e-6
"""Largest difference of a number between equal graphs: metres, quaternions, m/s."""


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


def read_graph(folder: Path) -> dict[str, Any]:
    """The tree of a saved map's graph.json; raises InputError where it cannot be read."""
    path = folder / 'graph.json'
    try:
        tree = json.loads(path.read_text(encoding='utf-8'))
    except (OSError, ValueError) as error:
        raise InputError(f'{path}: cannot be read ({error})') from error
    if not isinstance(tree, dict) or not {'clusters', 'variables', 'factors'} <= tree.keys():
        raise InputError(f'{path}: is no graph that this package has saved')
    return tree


def compare_graphs(
    one: Mapping[str, Any], other: Mapping[str, Any], tolerance: float = TOLERANCE
) -> Comparison:
    """Compare two graph trees: clusters and their members, factors, and values of variables.

    Clusters and factors must be the same ones in the same order, values equal to ``tolerance``.
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
