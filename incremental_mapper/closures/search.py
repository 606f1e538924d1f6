"""Local maps in, closures out: candidates, their verification, and what they say together."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

from incremental_mapper.closures.candidate_pairs import (
    Relative,
    by_looks,
    by_place,
    can_recognise,
)
from incremental_mapper.closures.consistency import consistent_set
from incremental_mapper.closures.local_maps import LocalMap
from incremental_mapper.closures.verification import Closure, Verifier
from incremental_mapper.config import ClosureSettings, OdometrySettings


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """The closures among local maps, and why other candidates are none, by a word each."""

    closures: tuple[Closure, ...]
    candidates: int = 0
    refused: Counter[str] = field(default_factory=Counter)


def find_closures(
    maps: Sequence[LocalMap],
    relative: Relative,
    settings: ClosureSettings,
    odometry: OdometrySettings,
    placed: bool = True,
) -> Found:
    """Find out which local maps show the same place.

    Args:
        maps: Local maps, drive by drive, each in the order of its way. Those of different drives
            (``LocalMap.run``) are compared as well.
        relative: What is known of the relative pose of two of them.
        settings: Those of closures.
        odometry: Those that tell the covariance of a match.
        placed: Whether all poses are in one frame, so that what lies side by side is a candidate.

    Returns:
        The closures, the first always before the second in ``maps``.
    """
    candidates = by_place(maps, settings) if placed else []
    if can_recognise():
        candidates += by_looks(maps, settings)
    verifier = Verifier(maps, settings, odometry)
    refused: Counter[str] = Counter()
    tried = 0
    best: dict[tuple[int, int], Closure] = {}
    for candidate in sorted(candidates, key=lambda one: (one.second, one.first)):
        pair = candidate.first, candidate.second
        if pair in best:
            continue
        tried += 1
        known = relative(maps[candidate.first], maps[candidate.second])
        outcome = verifier.verify(candidate, known)
        if isinstance(outcome, str):
            refused[outcome] += 1
        else:
            best[pair] = outcome
    held, contradicted, alone = consistent_set(list(best.values()), maps)
    refused['contradicted'] += len(contradicted)
    refused['alone'] += len(alone)
    return Found(tuple(held), tried, +refused)
