"""What every input looks like to the rest of the package: an iterator of measurements."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from incremental_mapper.measurements import Drops, Measurement
from incremental_mapper.trajectory import Trajectory


@dataclass(frozen=True, slots=True, eq=False)
class SourceInfo:
    """What is known of an input before it is read.

    ``settings`` is a partial settings tree (extrinsics, topics) that the input brings itself; the
    user's settings are laid over it. ``count`` is how many measurements ``measurements`` will
    try to make, for progress bars; ``counts`` the same by sensor. ``duration`` is in seconds.
    """

    path: Path
    kind: str
    counts: dict[str, int]
    duration: float
    settings: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def count(self) -> int:
        """Number of measurements of all sensors."""
        return sum(self.counts.values())


class Source(Protocol):
    """A KAIST folder or a bag, opened and checked."""

    @property
    def info(self) -> SourceInfo:
        """Facts about the input."""

    @property
    def drops(self) -> Drops:
        """Measurements that could not be used so far, by sensor and reason."""

    def measurements(self) -> Iterator[Measurement]:
        """All usable measurements in the order of the recording; reads lazily."""

    def truth(self) -> Trajectory | None:
        """The true trajectory T_world_base, if the input holds one."""
