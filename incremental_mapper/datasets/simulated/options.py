"""What a user chooses about a simulated drive."""

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from incremental_mapper.errors import ConfigError

MIN_DURATION = 1.0
MAX_DURATION = 7200.0
DEFAULT_DURATION = 15.0


class SceneKind(StrEnum):
    """Surroundings of the drive."""

    STREET = 'street'
    CURVE = 'curve'
    FIELD = 'field'
    REVISIT = 'revisit'
    TERRACE = 'terrace'


class MotionKind(StrEnum):
    """How the car's speed changes."""

    ZERO = 'zero'
    ACCEL = 'accel'
    CONST = 'const'
    DECEL = 'decel'
    MIXED = 'mixed'


@dataclass(frozen=True, slots=True)
class SimulationOptions:
    """Settings of one simulated drive.

    ``duration`` is in seconds and counts only where ``timing`` is None; ``timing`` is a CSV file
    with the columns ``stamp_ns,sensor`` whose stamps are used exactly. ``scene_seed`` replaces
    ``seed`` for the surroundings, so that drives with seeds of their own share them. The same
    options make byte-identical folders. Raises ConfigError for a value out of its range.
    """

    scene: SceneKind = SceneKind.STREET
    motion: MotionKind = MotionKind.MIXED
    duration: float = DEFAULT_DURATION
    seed: int = 0
    timing: Path | None = None
    overwrite: bool = False
    scene_seed: int | None = None

    def __post_init__(self) -> None:
        if self.timing is None and not MIN_DURATION <= self.duration <= MAX_DURATION:
            raise ConfigError(
                f'duration is {self.duration:g} s; choose one between {MIN_DURATION:g} '
                f'and {MAX_DURATION:g} s'
            )
        if self.seed < 0:
            raise ConfigError(f'seed is {self.seed}; choose a whole number from 0 on')
        if self.scene_seed is not None and self.scene_seed < 0:
            raise ConfigError(f'scene seed is {self.scene_seed}; choose a whole number from 0 on')
