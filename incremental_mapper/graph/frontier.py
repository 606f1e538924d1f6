"""The frontier of G(t-1): what a new factor may touch, and how a chain of spans starts there."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from incremental_mapper.graph.factors import FactorKind
from incremental_mapper.variables import bias_key, pose_key, velocity_key


@dataclass(frozen=True, slots=True)
class Frontier:
    """What a new factor may touch, by cluster id.

    ``chains`` holds the cluster, and the stamp, of each LiDAR's last scan; ``head`` is the
    cluster to connect from and ``head_inertial`` says whether it has velocity and bias;
    ``inertial`` is the last one that has. ``bias`` is the cluster whose bias is the newest one, and
    ``bias_stamp`` where the first span with it started: with ``graph.bias_period`` a bias may serve
    many spans.
    """

    chains: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    head: int | None = None
    head_stamp: int = 0
    head_inertial: bool = False
    inertial: int | None = None
    inertial_stamp: int = 0
    newest: int | None = None
    newest_stamp: int = 0
    bias: int | None = None
    bias_stamp: int = 0

    def homes(self) -> dict[tuple[str, int], int]:
        """Cluster of each LiDAR's last scan, by sensor and stamp (ns)."""
        return {(name, stamp): id_ for name, (id_, stamp) in self.chains.items()}

    def keys(self) -> set[int]:
        """Every variable that may still be touched; some may not exist."""
        ids = {id_ for id_, _ in self.chains.values()}
        ids |= {id_ for id_ in (self.head, self.newest) if id_ is not None}
        keys = {pose_key(id_) for id_ in ids}
        for id_ in (self.head, self.inertial):
            if id_ is not None:
                keys |= {velocity_key(id_), bias_key(id_)}
        if self.bias is not None:
            keys.add(bias_key(self.bias))
        return keys


def chain_start(before: int | None, stamp: int, max_gap: int) -> tuple[FactorKind, FactorKind]:
    """What holds velocity and bias where a chain of IMU spans starts.

    A bias goes on for ever, a velocity for as long as a span may have a hole.

    Args:
        before: Stamp of the last velocity and bias, ns; None where there are none.
        stamp: Where the chain starts, ns.
        max_gap: Longest hole in a span, ns.

    Returns:
        The kind of factor for the velocity, and that for the bias.
    """
    if before is None:
        return FactorKind.PRIOR_VELOCITY, FactorKind.PRIOR_BIAS
    if stamp - before > max_gap:
        return FactorKind.PRIOR_VELOCITY, FactorKind.BIAS_RANDOM_WALK
    return FactorKind.CONSTANT_VELOCITY, FactorKind.BIAS_RANDOM_WALK
