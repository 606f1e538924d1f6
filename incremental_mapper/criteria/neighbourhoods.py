"""Which points lie around a query.

Every window asks once, and of points that stand elsewhere in the next window, so that building a
tree does not pay. The points are sorted into rows instead: a grid in x and z, and along y within
a row. A ball is then a piece of each of a few rows.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.criteria.moments import NUMBERS, sum_products

BLOCK = 300
"""Queries that are answered together."""
FINE = 4.0
"""Steps a metre into which y is cut at the least, so that keys may be short."""


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Neighbours of ``queries``, a range of them.

    Query queries.start + rows[i] and point ``columns[i]`` are a pair, ``squares[i]`` m^2 apart.
    """

    queries: slice
    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    squares: NDArray[np.float64]


class RowIndex:
    """Points sorted into rows.

    ``points`` (3, N) are the points in their new order, metres; ``order`` (N,) are the places that
    they had before. ``radius`` in metres is about the largest of the later searches.
    """

    def __init__(self, points: NDArray[np.float64], radius: float) -> None:
        count = points.shape[1]
        self._low = points.min(axis=1) if count else np.zeros(3)
        extent = points.max(axis=1) - self._low if count else np.zeros(3)
        # A ball of that radius never meets more than two by two rows.
        self._width = 2.0 * radius
        self._columns, self._layers = (int(extent[axis] / self._width) + 1 for axis in (0, 2))
        # A row goes on until self._end; the next one begins so far behind it that no piece meets
        # both.
        self._end = float(extent[1]) + 2.0
        self._span = self._end + 1.0
        # A key and a point's number share an integer: sorting values is several times as fast as
        # sorting numbers by their keys, and of 32 bits twice as fast as of 64. What is cut off a
        # key only makes pieces a little longer.
        bits = count.bit_length()
        top = self._columns * self._layers * self._span
        short = FINE * top < 2.0 ** (31 - bits)
        self._kind: type[np.uint32 | np.uint64] = np.uint32 if short else np.uint64
        self._scale = 2.0 ** ((31 if short else 62) - bits - int(np.log2(top)))
        self._slack = 4.0 * float(np.spacing(top))
        keys = self._whole(self._keys(points))
        keys <<= bits
        keys |= np.arange(count, dtype=self._kind)
        keys.sort()
        self.order = (keys & self._kind((1 << bits) - 1)).astype(np.int64)
        self.points = points.take(self.order, axis=1)
        keys >>= bits
        self._sorted = keys

    def search(self, queries: NDArray[np.float64], radii: NDArray[np.float64]) -> Iterator[Pairs]:
        """All pairs of ``queries`` (3, Q) and points within each query's ``radii`` (Q,).

        They come in blocks of queries; the columns count in the new order.
        """
        for first in range(0, len(radii), BLOCK):
            block = slice(first, first + BLOCK)
            places, reach = queries[:, block], radii[block]
            owner, starts, sizes = self._pieces(places, reach)
            columns = np.repeat(starts - np.cumsum(sizes) + sizes, sizes)
            columns += np.arange(len(columns))
            asked = places.take(owner, axis=1)
            squares = self._squares(0, columns, asked, sizes)
            squares += self._squares(1, columns, asked, sizes)
            squares += self._squares(2, columns, asked, sizes)
            near = np.flatnonzero(squares <= np.repeat(np.square(reach).take(owner), sizes))
            rows = np.repeat(owner, sizes).take(near)
            yield Pairs(block, rows, columns.take(near), squares.take(near))

    def _squares(
        self,
        axis: int,
        columns: NDArray[np.int64],
        asked: NDArray[np.float64],
        sizes: NDArray[np.int64],
    ) -> NDArray[np.float64]:
        """Squared steps (N,) along an axis to points from ``asked`` (3, K), each for its piece."""
        steps: NDArray[np.float64] = self.points[axis].take(columns)
        steps -= np.repeat(asked[axis], sizes)
        steps *= steps
        return steps

    def _keys(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        keys: NDArray[np.float64] = points[0] - self._low[0]
        other: NDArray[np.float64] = points[2] - self._low[2]
        for cells in keys, other:
            cells /= self._width
            np.floor(cells, out=cells)
        keys *= self._layers
        keys += other
        keys *= self._span
        keys += np.subtract(points[1], self._low[1] - 1.0, out=other)
        return keys

    def _whole(self, keys: NDArray[np.float64]) -> NDArray[np.uint32] | NDArray[np.uint64]:
        """Keys as whole numbers; what was ascending remains so."""
        whole: NDArray[np.uint32] | NDArray[np.uint64] = (keys * self._scale).astype(self._kind)
        return whole

    def _pieces(
        self, queries: NDArray[np.float64], radii: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Query, start and length (K,) of the pieces of rows that balls reach into."""
        places = queries - self._low[:, None]
        # Cells (K, 2, Q) across and up, and the squared distances to them.
        most = int(np.ceil(2.0 * radii.max() / self._width)) + 1
        cells = np.floor((places[::2] - radii) / self._width) + np.arange(most)[:, None, None]
        edges = cells * self._width - places[::2]
        gaps = np.maximum(np.maximum(edges, -self._width - edges), 0.0)
        gaps *= gaps
        gaps[(cells < 0.0) | (cells >= [[self._columns], [self._layers]])] = np.inf
        # Squared half lengths (K, K, Q) of the pieces, below zero where there is none.
        rest = (np.square(radii) - gaps[:, 1]) - gaps[:, None, 0]
        wanted = np.flatnonzero(rest >= 0.0)
        owner = wanted % len(radii)
        begin = ((cells[:, None, 0] * self._layers + cells[:, 1]) * self._span).take(wanted)
        half = np.sqrt(rest.take(wanted))
        half += self._slack
        middle = places[1].take(owner) + 1.0
        low = np.minimum(np.maximum(middle - half, 0.0), self._end)
        high = np.minimum(np.maximum(middle + half, 0.0), self._end)
        first = np.searchsorted(self._sorted, self._whole(begin + low), side='left')
        last = np.searchsorted(self._sorted, self._whole(begin + high), side='right')
        return owner, first, last - first


def moments_around(
    points: NDArray[np.float64], places: NDArray[np.float64], radius: float
) -> NDArray[np.float64]:
    """Moments (10, P) of the ``points`` (N, 3) within ``radius`` metres of ``places`` (P, 3)."""
    index = RowIndex(points.T, radius)
    moments = np.zeros((NUMBERS, len(places)))
    for pairs in index.search(places.T, np.full(len(places), radius)):
        asked = len(places[pairs.queries])
        moments[:, pairs.queries] = sum_products(pairs.rows, pairs.columns, index.points, asked)
    return moments
