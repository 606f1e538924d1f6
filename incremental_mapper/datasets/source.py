"""What every input looks like to the rest of the package: an iterator of measurements."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from incremental_mapper.checks.finding import Finding
from incremental_mapper.measurements import Drops, Measurement
from incremental_mapper.trajectory import Trajectory


@dataclass(frozen=True, slots=True, eq=False)
class SourceInfo:
    """What is known of an input before it is read.

    Attributes:
        path: where it is.
        kind: what it is, in words.
        counts: how many measurements ``measurements`` will try to make, by sensor.
        duration: seconds from its first record to its last.
        settings: a partial settings tree (extrinsics, topics) that the input brings itself; the
            user's settings are laid over it.
        notes: remarks on how it was understood.
        findings: what is wrong with it.
    """

    path: Path
    kind: str
    counts: dict[str, int]
    duration: float
    settings: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()

    @property
    def count(self) -> int:
        """Number of measurements of all sensors."""
        return sum(self.counts.values())


class Source(Protocol):
    """An input, opened and checked.

    Whatever has these members can be mapped; ``open_source`` makes one of a folder or a bag.
    """

    @property
    def info(self) -> SourceInfo:
        """Facts about the input; after a run its notes tell what was used but not as it was."""

    @property
    def drops(self) -> Drops:
        """Records that could not be made measurements so far, by sensor and reason."""

    def measurements(self) -> Iterator[Measurement]:
        """Read all usable measurements, one at a time, in the order of the recording.

        Raises:
            InputError: the input is damaged so that nothing can be read.
        """

    def truth(self) -> Trajectory | None:
        """The true trajectory T_world_base, or None where the input holds none.

        Raises:
            InputError: there is one, but it cannot be read.
        """
