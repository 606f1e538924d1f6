"""What a generator of harmed recordings is, and the list of them."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TypeAlias

from lies.recording import Recording


class Verdict(StrEnum):
    """What a user may expect of a recording."""

    SOUND = 'sound'
    """It is unusual, but nothing is wrong with it: a map as good as unharmed, and no warning."""
    MENDED = 'mended'
    """The map is as good as unharmed, and it is said what was wrong."""
    WARNED = 'warned'
    """There is a map, and a warning that names the culprit."""
    REFUSED = 'refused'
    """There is no map, and a message that names the culprit."""


Maker: TypeAlias = Callable[[Recording, Path], Path]


@dataclass(frozen=True)
class Lie:
    """One harmed recording.

    Attributes:
        name: A short name, to choose it by.
        situation: What is wrong, in one line.
        make: Writes it below a folder, and returns what is to be mapped.
        expected: Any of these is right.
        about: A regular expression that one of the warnings must match, for it to be about this.
        drive: Name of the drive that is harmed, see ``recording.DRIVES``.
        factor: How much larger than that of the unharmed drive the ATE may be where it is mended.
        share: Share of the unharmed map's points that a good one has at least.
        options: Further words for the command line.
    """

    name: str
    situation: str
    make: Maker
    expected: tuple[Verdict, ...]
    about: str
    drive: str
    factor: float
    share: float
    options: tuple[str, ...]


LIES: dict[str, Lie] = {}


def lie(
    *expected: Verdict,
    about: str = '',
    drive: str = 'street',
    factor: float = 1.5,
    share: float = 0.6,
    options: tuple[str, ...] = (),
) -> Callable[[Maker], Maker]:
    """Enter a generator in the list under the name of its function.

    The first line of its docstring is the situation. Parameters are as in ``Lie``.
    """

    def enter(make: Maker) -> Maker:
        name = make.__name__
        situation = (make.__doc__ or '').splitlines()[0].rstrip('.')
        LIES[name] = Lie(name, situation, make, expected, about, drive, factor, share, options)
        return make

    return enter
