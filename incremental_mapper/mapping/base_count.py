"""Counting the base graph of the same measurements, without building it (paper, Base)."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from incremental_mapper.candidates.model import CoreKind
from incremental_mapper.candidates.partitions import group_elements
from incremental_mapper.candidates.spans import ImuStamps
from incremental_mapper.frontend.front_end import Prepared
from incremental_mapper.frontend.prepared_scan import PreparedScan
from incremental_mapper.graph.factors import FactorKind
from incremental_mapper.graph.frontier import chain_start


@dataclass(slots=True)
class BaseCount:
    """Counts the base graph of the same measurements without building it (paper, Base).

    Every element has a pose, one IMU factor joins every consecutive pair with a usable span, and
    velocity and bias exist at the ends of those. ``max_gap`` is how long, in ns, a velocity is
    known after a chain of spans ended.
    """

    max_gap: int
    clusters: int = 0
    inertial: int = 0
    factors: dict[str, int] = field(default_factory=dict)
    last: int | None = None
    _last_inertial: int | None = None

    def add_window(self, prepared: Sequence[Prepared], imu: ImuStamps) -> None:
        """Count a window's measurements, each of them once.

        Args:
            prepared: Core measurements that no window before had.
            imu: The IMU samples that no span has used yet.
        """
        known = {item.core: item for item in prepared}
        for element in group_elements(known):
            stamp, before = element[0].stamp, self.last
            joined = before is not None and imu.first_sample(before, stamp) is not None
            items = [known[core] for core in element]
            odometry = sum(
                isinstance(item, PreparedScan) and item.previous is not None for item in items
            )
            gnss = sum(core.kind is CoreKind.GNSS for core in element)
            self.add_element(stamp, odometry, gnss, joined)

    def add_element(self, stamp: int, odometry: int, gnss: int, connected: bool) -> None:
        """One more element, with its factors and whether a span joins it to the one before."""
        self.clusters += 1
        self._count(FactorKind.ODOMETRY, odometry)
        self._count(FactorKind.GNSS, gnss)
        if self.clusters == 1:
            self._count(FactorKind.PRIOR_POSE, 1)
        if connected:
            assert self.last is not None
            self._count(FactorKind.IMU, 1)
            if self._last_inertial != self.last:
                self.inertial += 1  # the element before starts a chain
                for kind in chain_start(self._last_inertial, self.last, self.max_gap):
                    self._count(kind, 1)
            self.inertial += 1
            self._last_inertial = stamp
        self.last = stamp

    def _count(self, kind: FactorKind, number: int) -> None:
        self.factors[kind] = self.factors.get(kind, 0) + number

    @property
    def vertices(self) -> int:
        """Poses, velocities and biases."""
        return self.clusters + 2 * self.inertial

    @property
    def total_factors(self) -> int:
        """All factors with priors, but for those that hold unconnected components."""
        return sum(self.factors.values())
