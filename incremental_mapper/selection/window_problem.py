"""What is needed to choose a window's candidate."""

from dataclasses import dataclass

from incremental_mapper.candidates.partitions import Element
from incremental_mapper.candidates.spans import ImuStamps
from incremental_mapper.graph.factor_builder import WindowFactors
from incremental_mapper.selection.local_map import LocalMapBuilder
from incremental_mapper.smoothing.marginal_prior import MarginalPrior


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """A window's elements, their factors, and what they are judged on.

    ``prior`` is what G(t-1) says of its frontier; its eliminated are the earlier poses that
    candidates are judged by. ``head`` is the stamp and ``head_cluster`` the number of
    the cluster to connect from, ``inertial_cluster`` that of the last one with velocity and bias.
    Without ``may_merge`` candidates that merge are taken only where
    no other is connected.
    """

    elements: tuple[Element, ...]
    head: int | None
    head_cluster: int | None
    inertial_cluster: int | None
    imu: ImuStamps
    factors: WindowFactors
    local_maps: LocalMapBuilder
    prior: MarginalPrior
    may_merge: bool
    max_iterations: int
