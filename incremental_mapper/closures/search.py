"""Local maps in, closures out: candidates, their verification, and what they say together."""

import math
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

from incremental_mapper.closures.candidate_pairs import (
    Candidate,
    Relative,
    by_looks,
    by_place,
    can_recognise,
)
from incremental_mapper.closures.consistency import NEIGHBOURHOOD, consistent_set
from incremental_mapper.closures.local_maps import LocalMap
from incremental_mapper.closures.verification import (
    IMPROBABLE,
    Closure,
    Verifier,
    conceivable,
    probable,
)
from incremental_mapper.config import ClosureSettings, OdometrySettings

Pair: TypeAlias = tuple[int, int]
"""The clusters of two local maps."""
Tested: TypeAlias = Mapping[Pair, Closure | str]
"""What registration has led to for pairs of local maps of one drive."""
NOT_TESTED: Tested = {}
BARREN = 20
"""So many candidates in a row that were no closures, and every second local map is passed over."""
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
    recognise: Collection[int] | None = None,
    tested: Tested = NOT_TESTED,
    most: float = math.inf,
    closed: Collection[Pair] = (),
    once: bool = False,
) -> Found:
    """Find out which local maps show the same place.

    Args:
        maps: Local maps, drive by drive, each in the order of its way. Those of different drives
            (``LocalMap.run``) are compared as well.
        relative: What is known of the relative pose of two of them.
        settings: Those of closures.
        odometry: Those that tell the covariance of a match.
        placed: Whether all poses are in one frame, so that what lies side by side is a candidate.
        recognise: The places in ``maps`` of those that are compared by what they look like, too,
            where that is possible; None is all.
        tested: Pairs of one drive that need not be registered again, nor have points.
        most: Pairs that are registered at the most.
        closed: Tested pairs whose closures are among what is known already, which so cannot speak
            against them.
        once: Nobody goes on with ``tested``: what cannot become a closure is not looked at to the
            end.

    Returns:
        The closures, the first always before the second in ``maps``.
    """
    candidates = by_place(maps, settings) if placed else []
    wanted = recognise is None or len(recognise) > 0
    looks = by_looks(maps, settings, recognise) if wanted and can_recognise() else []
    looking = _Looking(
        maps, relative, Verifier(maps, settings, odometry), tested, most, closed, once
    )
    leading = {id(one) for one in (*_leading(candidates), *_leading(looks))}
    waiting: list[Candidate] = []
    for candidate in sorted((*candidates, *looks), key=in_order):
        if once and (id(candidate) not in leading or looking.passes_over(candidate)):
            waiting.append(candidate)
        else:
            looking.look(candidate)
        waiting = looking.look_beside(waiting, candidate.second)
    looking.refused['alone'] += len(waiting)
    best = list(looking.best.values())
    held, contradicted, alone = consistent_set(best, maps)
    refused = looking.refused
    refused['contradicted'] += len(contradicted)
    refused['alone'] += len(alone)
    return Found(
        tuple(held),
        looking.tried + len(waiting),
        +refused,
        {**looking.registrations, **looking.known_pairs},
    )


class _Looking:
    """What was found so far; see ``find_closures``."""

    def __init__(
        self,
        maps: Sequence[LocalMap],
        relative: Relative,
        verifier: Verifier,
        tested: Tested,
        most: float,
        closed: Collection[Pair],
        once: bool,
    ) -> None:
        self._maps, self._relative, self._verifier = maps, relative, verifier
        self._most, self._closed, self._once = most, closed, once
        self.known_pairs, self.registrations = dict(tested), dict(tested)
        self.refused: Counter[str] = Counter()
        self.best: dict[tuple[int, int], Closure] = {}
        self.tried = self._registered = self._barren = 0
        self._recent: list[Closure] = []

    def passes_over(self, candidate: Candidate) -> bool:
        """Whether a candidate waits until one beside it is a closure: none was for a long way.

        Two at least must agree, of different local maps, so each place has one that does not wait.
        """
        return self._barren >= BARREN and candidate.second % 2 == 1

    def look(self, candidate: Candidate) -> None:
        """Find out whether a candidate is a closure."""
        maps, pair = self._maps, (candidate.first, candidate.second)
        if pair in self.best:
            return
        self.tried += 1
        names = maps[candidate.first].cluster, maps[candidate.second].cluster
        outcome = self.known_pairs.get(names)
        if not isinstance(outcome, str) and (outcome is None or names not in self._closed):
            # What is improbable, more of the drive may change; what registration says stays.
            known = self._relative(maps[candidate.first], maps[candidate.second])
            if outcome is None and conceivable(candidate, known):
                if self._registered < self._most:
                    self._registered += 1
                    self._barren += 1
                    outcome = self._verifier.verify(candidate, known, self._once)
                    self.registrations[names] = outcome
                else:
                    outcome = LEFT
            if outcome is None or (isinstance(outcome, Closure) and not probable(outcome, known)):
                outcome = IMPROBABLE
            # By looks it may lie elsewhere than by its place, so it may be tried again.
            elif outcome not in (LEFT, IMPROBABLE):
                self.known_pairs[names] = outcome
        if isinstance(outcome, str):
            self.refused[outcome] += 1
        else:
            self._barren = 0
            found = replace(outcome, first=candidate.first, second=candidate.second)
            self.best[pair] = found
            self._recent.append(found)

    def look_beside(self, waiting: list[Candidate], newest: int) -> list[Candidate]:
        """Look at candidates that a closure may confirm: alone, one would be left out.

        Args:
            waiting: They.
            newest: The local map that the search has come to.

        Returns:
            Those that still wait; what is too far back to be confirmed is counted.
        """
        waiting = [one for one in waiting if (one.first, one.second) not in self.best]
        if not waiting:
            return []
        maps = self._maps
        self._recent = [c for c in self._recent if _along(maps[c.second], maps[newest])]
        while near := [one for one in waiting if any(_beside(one, c, maps) for c in self._recent)]:
            waiting = [one for one in waiting if one not in near]
            for candidate in near:
                self.look(candidate)
        wait = [one for one in waiting if _along(maps[one.second], maps[newest])]
        self.refused['alone'] += len(waiting) - len(wait)
        self.tried += len(waiting) - len(wait)
        return wait


def _leading(candidates: Sequence[Candidate]) -> Iterator[Candidate]:
    """The first candidate of each local map, which is its best."""
    seen: set[int] = set()
    for candidate in candidates:
        if candidate.second not in seen:
            yield candidate
        seen.add(candidate.second)


def _beside(candidate: Candidate, closure: Closure, maps: Sequence[LocalMap]) -> bool:
    """Whether a closure may confirm a candidate: it is near on both ways."""
    return _along(maps[candidate.first], maps[closure.first]) and _along(
        maps[candidate.second], maps[closure.second]
    )


def _along(one: LocalMap, other: LocalMap) -> bool:
    """Whether two local maps are near each other on their way."""
    return one.run == other.run and abs(one.travelled - other.travelled) <= NEIGHBOURHOOD
