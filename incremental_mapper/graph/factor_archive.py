"""The factors of G(t) while it grows: an hour of them takes 250 MB, packed a third of that.

Windows and watchers look at the newest factors alone, again and again. Older ones are asked for
when all of G(t) is solved: in the end, beside the windows, and as it is laid into another frame.
"""

import pickle
import zlib
from collections.abc import Iterable, Iterator, MutableSequence
from itertools import chain
from typing import TypeAlias, overload

import gtsam

from incremental_mapper.graph.factors import Factor

BLOCK = 64
"""Factors that are packed together: 4 ms, every second or two."""
NEWEST = 2048
"""So many, or a few more, are as they are: a minute of two LiDARs."""
MOST_AT_ONCE = 2
"""Blocks that one window packs at the most, where many wait."""
FAST = 1

_Block: TypeAlias = bytes | list[Factor]
"""Packed factors; or plain ones, where a strategy of a user's own made what cannot be packed."""


class FactorArchive(MutableSequence[Factor]):
    """Factors in their order, each at the place of its number."""

    def __init__(self, factors: Iterable[Factor] = ()) -> None:
        """Keep some factors as they are; ``extend`` packs them little by little.

        Args:
            factors: They.
        """
        self._blocks: list[_Block] = []
        self._newest = list(factors)
        self._opened: tuple[int, list[Factor]] = (-1, [])

    def __len__(self) -> int:
        return BLOCK * len(self._blocks) + len(self._newest)

    def __iter__(self) -> Iterator[Factor]:
        blocks = (_unpacked(block) for block in self._blocks)
        return chain(chain.from_iterable(blocks), self._newest)

    @overload
    def __getitem__(self, place: int) -> Factor: ...
    @overload
    def __getitem__(self, place: slice) -> list[Factor]: ...
    def __getitem__(self, place: int | slice) -> Factor | list[Factor]:
        packed = BLOCK * len(self._blocks)
        if isinstance(place, slice):
            start, stop, step = place.indices(len(self))
            if start >= packed and step > 0:
                return self._newest[start - packed : max(stop - packed, 0) : step]
            return [self[one] for one in range(start, stop, step)]
        number = range(len(self))[place]  # raises where there is none
        if number >= packed:
            return self._newest[number - packed]
        block, inside = divmod(number, BLOCK)
        if self._opened[0] != block:
            self._opened = (block, _unpacked(self._blocks[block]))
        return self._opened[1][inside]

    @overload
    def __setitem__(self, place: int, factor: Factor) -> None: ...
    @overload
    def __setitem__(self, place: slice, factor: Iterable[Factor]) -> None: ...
    def __setitem__(self, place: int | slice, factor: Factor | Iterable[Factor]) -> None:
        self.unpacked()[place] = factor  # type: ignore[index,assignment]

    def __delitem__(self, place: int | slice) -> None:
        del self.unpacked()[place]

    def insert(self, place: int, factor: Factor) -> None:
        """Put a factor before another one, or at the end."""
        if place >= len(self):
            self._newest.append(factor)
        else:
            self.unpacked().insert(place, factor)

    def extend(self, factors: Iterable[Factor]) -> None:
        """Append factors, and pack old ones where there are enough of them.

        Args:
            factors: They.
        """
        self._newest.extend(factors)
        for _ in range(MOST_AT_ONCE):
            if len(self._newest) < NEWEST + BLOCK:
                return
            self._blocks.append(_packed(self._newest[:BLOCK]))
            del self._newest[:BLOCK]

    def unpacked(self) -> list[Factor]:
        """All factors as they are, for who goes through them more than once.

        From then on they are kept like that, the same objects, until ``extend`` packs them again.
        The list is not to be changed.
        """
        if self._blocks:
            self._newest = list(self)
            self._blocks, self._opened = [], (-1, [])
        return self._newest


def _packed(factors: list[Factor]) -> _Block:
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.push_back(factor.factor)
    plain = [(one.kind, one.keys, one.sensor, one.stamps, one.describe) for one in factors]
    try:
        data = pickle.dumps((graph.serialize(), plain), pickle.HIGHEST_PROTOCOL)
    # Factors of a user's own raise what they like.
    except Exception:
        return factors
    return zlib.compress(data, FAST)


def _unpacked(block: _Block) -> list[Factor]:
    if isinstance(block, list):
        return block
    text, plain = pickle.loads(zlib.decompress(block))
    graph = gtsam.NonlinearFactorGraph()
    graph.deserialize(text)
    return [
        Factor(kind, keys, graph.at(place), sensor, stamps, describe)
        for place, (kind, keys, sensor, stamps, describe) in enumerate(plain)
    ]
