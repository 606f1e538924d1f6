"""Counting the base graph of the same measurements, without building it (paper, Base)."""

from dataclasses import dataclass, field

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
        """All factors, priors included, without the weak priors of loose components."""
        return sum(self.factors.values())
