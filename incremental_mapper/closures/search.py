"""Local maps in, closures out: candidates, their verification, and what they say together."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

from incremental_mapper.closures.candidate_pairs import (
    Relative,
    by_looks,
    by_place,
    can_recognise,
)
from incremental_mapper.closures.consistency import consistent_set
from incremental_mapper.closures.local_maps import LocalMap
from incremental_mapper.closures.verification import Closure, Verifier, probable
from incremental_mapper.config import ClosureSettings, OdometrySettings

Pair: TypeAlias = tuple[int, int]
"""The clusters of two local maps."""
Tested: TypeAlias = Mapping[Pair, Closure | str]
"""What registration has led to for pairs of local maps of one drive."""
NOT_TESTED: Tested = {}


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """The closures among local maps, and why other candidates are none, by a word each.

    ``tested`` is what was given, and what came to it.
    """

    closures: tuple[Closure, ...]
    candidates: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    tested: Tested = field(default_factory=dict)


def find_closures(
    maps: Sequence[LocalMap],
    relative: Relative,
    settings: ClosureSettings,
    odometry: OdometrySettings,
    placed: bool = True,
    recognise: bool = True,
    tested: Tested = NOT_TESTED,
) -> Found:
    """Find out which local maps show the same place.

    Args:
        maps: Local maps, drive by drive, each in the order of its way. Those of different drives
            (``LocalMap.run``) are compared as well.
        relative: What is known of the relative pose of two of them.
        settings: Those of closures.
        odometry: Those that tell the covariance of a match.
        placed: Whether all poses are in one frame, so that what lies side by side is a candidate.
        recognise: Whether to look for places by what they look like, too, where that is possible.
        tested: Pairs of one drive that need not be registered again, nor have points.

    Returns:
        The closures, the first always before the second in ``maps``.
    """
    candidates = by_place(maps, settings) if placed else []
    if recognise and can_recognise():
        candidates += by_looks(maps, settings)
    verifier = Verifier(maps, settings, odometry)
    refused: Counter[str] = Counter()
    tried = 0
    known_pairs = dict(tested)
    best: dict[tuple[int, int], Closure] = {}
    for candidate in sorted(candidates, key=lambda one: (one.second, one.first)):
        pair = candidate.first, candidate.second
        if pair in best:
            continue
        tried += 1
        names = maps[candidate.first].cluster, maps[candidate.second].cluster
        before = known_pairs.get(names)
        outcome = before
        known = None
        if not isinstance(before, str):
            known = relative(maps[candidate.first], maps[candidate.second])
        if outcome is None:
            outcome = verifier.verify(candidate, known)
        if isinstance(outcome, Closure) and before is not None:
            outcome = replace(outcome, first=candidate.first, second=candidate.second)
            outcome = outcome if probable(outcome, known) else 'improbable'
        elif outcome != 'improbable':  # which more of the drive may change
            known_pairs[names] = outcome
        if isinstance(outcome, str):
            refused[outcome] += 1
        else:
            best[pair] = outcome
    held, contradicted, alone = consistent_set(list(best.values()), maps)
    refused['contradicted'] += len(contradicted)
    refused['alone'] += len(alone)
    return Found(tuple(held), tried, +refused, known_pairs)
