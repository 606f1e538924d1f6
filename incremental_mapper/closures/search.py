"""Local maps in, closures out: candidates, their verification, and what they say together."""

import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

from incremental_mapper.closures.candidate_pairs import (
    Candidate,
    Relative,
    by_looks,
    by_place,
    can_recognise,
)
from incremental_mapper.closures.consistency import consistent_set
from incremental_mapper.closures.local_maps import LocalMap
from incremental_mapper.closures.verification import Closure, Verifier, conceivable, probable
from incremental_mapper.config import ClosureSettings, OdometrySettings

Pair: TypeAlias = tuple[int, int]
"""The clusters of two local maps."""
Tested: TypeAlias = Mapping[Pair, Closure | str]
"""What registration has led to for pairs of local maps of one drive."""
NOT_TESTED: Tested = {}
LEFT = 'left_for_later'
"""Why a pair is no closure yet: as many as were wanted were registered before it."""


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """The closures among local maps, and why other candidates are none, by a word each.

    ``tested`` is what was given, and what came to it.
    """

    closures: tuple[Closure, ...]
    candidates: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    tested: Tested = field(default_factory=dict)


def in_order(pair: Candidate) -> tuple[int, int]:
    """By what comes first of candidates that are registered: those of the earlier way."""
    return pair.second, pair.first


def find_closures(
    maps: Sequence[LocalMap],
    relative: Relative,
    settings: ClosureSettings,
    odometry: OdometrySettings,
    placed: bool = True,
    recognise: bool = True,
    tested: Tested = NOT_TESTED,
    most: float = math.inf,
    closed: Collection[Pair] = (),
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
        most: Pairs that are registered at the most.
        closed: Tested pairs whose closures are among what is known already, which so cannot speak
            against them.

    Returns:
        The closures, the first always before the second in ``maps``.
    """
    candidates = by_place(maps, settings) if placed else []
    if recognise and can_recognise():
        candidates += by_looks(maps, settings)
    verifier = Verifier(maps, settings, odometry)
    refused: Counter[str] = Counter()
    tried = registered = 0
    known_pairs, registrations = dict(tested), dict(tested)
    best: dict[tuple[int, int], Closure] = {}
    for candidate in sorted(candidates, key=in_order):
        pair = candidate.first, candidate.second
        if pair in best:
            continue
        tried += 1
        names = maps[candidate.first].cluster, maps[candidate.second].cluster
        outcome = known_pairs.get(names)
        if not isinstance(outcome, str) and (outcome is None or names not in closed):
            # What is improbable, more of the drive may change; what registration says stays.
            known = relative(maps[candidate.first], maps[candidate.second])
            if outcome is None and conceivable(candidate, known):
                if registered < most:
                    registered += 1
                    outcome = verifier.verify(candidate, known)
                    registrations[names] = outcome
                else:
                    outcome = LEFT
            if outcome is None or (isinstance(outcome, Closure) and not probable(outcome, known)):
                outcome = 'improbable'  # by looks it may lie elsewhere, so it may be tried again
            elif outcome != LEFT:
                known_pairs[names] = outcome
        if isinstance(outcome, Closure):
            outcome = replace(outcome, first=candidate.first, second=candidate.second)
        if isinstance(outcome, str):
            refused[outcome] += 1
        else:
            best[pair] = outcome
    held, contradicted, alone = consistent_set(list(best.values()), maps)
    refused['contradicted'] += len(contradicted)
    refused['alone'] += len(alone)
    return Found(tuple(held), tried, +refused, {**registrations, **known_pairs})
