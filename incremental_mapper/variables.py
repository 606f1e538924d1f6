"""The variables of the graph: their keys, and values that are put in and copied.

Keys follow GTSAM's habit: ``x`` pose T_map_base, ``v`` velocity of base_link in the map (m/s),
``b`` accelerometer and gyroscope bias, each with the number of its cluster.
"""

from functools import lru_cache

import gtsam

LETTER = 56
"""Bits of a key below its letter."""
POSE, VELOCITY, BIAS = map(ord, 'xvb')
"""What a key has above them."""
# As gtsam.symbol(letter, cluster) makes them, at a fifth of the cost.
_POSE, _VELOCITY, _BIAS = (letter << LETTER for letter in (POSE, VELOCITY, BIAS))


def pose_key(cluster: int) -> int:
    """Key of a cluster's pose."""
    return _POSE | cluster


def velocity_key(cluster: int) -> int:
    """Key of a cluster's velocity."""
    return _VELOCITY | cluster


def bias_key(cluster: int) -> int:
    """Key of a cluster's IMU bias."""
    return _BIAS | cluster


def cluster_of(key: int) -> int:
    """Number of the cluster that a variable belongs to."""
    return key & ((1 << LETTER) - 1)  # as gtsam.Symbol(key).index(), without making one


def kind_of(key: int) -> str:
    """Letter of a variable: ``x``, ``v`` or ``b``."""
    return chr(key >> LETTER)  # as gtsam.Symbol(key).chr(), without making one


def key_name(key: int) -> str:
    """Readable name of a key, for example ``x12``."""
    return f'{kind_of(key)}{cluster_of(key)}'


@lru_cache(maxsize=1024)
def _no_bias(key: int) -> gtsam.Values:
    values = gtsam.Values()
    values.insert(key, gtsam.imuBias.ConstantBias())
    return values


def insert_bias(values: gtsam.Values, key: int, bias: gtsam.imuBias.ConstantBias) -> None:
    """As ``values.insert(key, bias)``, whose 44 overloads take ten times as long to tell apart.

    Only where keys come again: a new one is inserted that way once.
    """
    step = gtsam.VectorValues()
    step.insert(key, bias.vector())
    values.insert(_no_bias(key).retract(step))


def insert_moved(
    source: gtsam.Values, key: int, T_new_old: gtsam.Pose3, target: gtsam.Values
) -> None:
    """Copy one variable between ``Values`` of different frames; biases are the vehicle's own."""
    kind = kind_of(key)
    if kind == 'x':
        target.insert(key, T_new_old.compose(source.atPose3(key)))
    elif kind == 'v':
        target.insert(key, T_new_old.rotation().rotate(source.atVector(key)))
    else:
        target.insert(key, source.atConstantBias(key))


def copy_value(
    source: gtsam.Values, key: int, target: gtsam.Values, name: int | None = None
) -> None:
    """Copy one variable between two ``Values``, under another key if ``name`` is given."""
    kind = kind_of(key)
    new = key if name is None else name
    if kind == 'x':
        target.insert(new, source.atPose3(key))
    elif kind == 'v':
        target.insert(new, source.atVector(key))
    else:
        target.insert(new, source.atConstantBias(key))
