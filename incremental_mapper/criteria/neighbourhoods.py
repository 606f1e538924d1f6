"""Which points lie around a query.

Every window asks once, and of points that stand elsewhere in the next window, so that building a
tree does not pay. The points are sorted into rows instead: a grid in x and z, exact coordinates
in y. A ball is then a piece of each of a few rows.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.criteria.moments import NUMBERS, products, sum_products

BLOCK = 150
"""Queries that are answered together; with more, the work would leave the processor's cache."""


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Neighbours of ``queries`` (Q,), given by their numbers.

    Query queries[rows[i]] and point ``columns[i]`` are a pair, ``squares[i]`` m^2 apart.
    """

    queries: NDArray[np.int64]
    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    squares: NDArray[np.float64]


class RowIndex:
    """Points sorted into rows.

    ``points`` (3, N) are the points in their new order, metres; ``order`` (N,) are the places that
    they had before. ``radius`` in metres is about that of the later searches.
    """

    def __init__(self, points: NDArray[np.float64], radius: float) -> None:
        self._low = points.min(axis=1, initial=np.inf)
        extent = points.max(axis=1, initial=-np.inf) - self._low
        if not points.shape[1]:
            self._low, extent = np.zeros(3), np.zeros(3)
        self._width, self._height = radius, 2.0 * radius
        self._layers = int(extent[2] / self._height) + 1
        # A row ends at self._end; the next one begins so far behind it that no piece meets both.
        self._end = float(extent[1]) + 1.0
        self._span = self._end + 2.0
        keys = self._keys(points)
        self.order = np.argsort(keys)
        self.points = points[:, self.order]
        self._sorted = keys[self.order]

    def search(self, queries: NDArray[np.float64], radii: NDArray[np.float64]) -> Iterator[Pairs]:
        """All pairs of ``queries`` (3, Q) and points within each query's ``radii`` (Q,).

        They come in blocks of queries; the columns count in the new order.
        """
        if not queries.shape[1]:
            return
        along, starts, lengths = self._pieces(queries, radii)
        for first in range(0, len(along), BLOCK):
            members = along[first : first + BLOCK]
            sizes = lengths[first : first + BLOCK].ravel()
            filled = np.flatnonzero(sizes > 0)
            sizes = sizes[filled]
            rows = np.repeat(filled // lengths.shape[1], sizes)
            offsets = starts[first : first + BLOCK].ravel()[filled] - np.cumsum(sizes) + sizes
            columns = np.repeat(offsets, sizes)
            columns += np.arange(len(columns))
            squares = np.zeros(len(columns))
            for own, asked in zip(self.points, queries[:, members], strict=True):
                steps = own[columns]
                steps -= asked[rows]
                steps *= steps
                squares += steps
            near = np.flatnonzero(squares <= np.square(radii[members])[rows])
            yield Pairs(members, rows[near], columns[near], squares[near])

    def _keys(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        low = self._low
        keys: NDArray[np.float64] = np.floor((points[0] - low[0]) / self._width)
        keys *= self._layers
        keys += np.floor((points[2] - low[2]) / self._height)
        keys *= self._span
        keys += points[1] - low[1]
        return keys

    def _pieces(
        self, queries: NDArray[np.float64], radii: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Start and length (Q, K) of all pieces of rows that balls may reach into.

        The queries (Q,) that they belong to come first: pieces are looked up three times as
        quickly where neighbours come one after the other.
        """
        along = np.argsort(self._keys(queries))
        (x, y, z), radii = queries[:, along] - self._low[:, None], radii[along]
        largest = float(radii.max())
        beside = np.ceil(largest / self._width)
        columns = np.floor(x / self._width) + np.arange(-beside, beside + 1.0)[:, None]
        gaps = np.maximum(columns * self._width - x, x - (columns + 1.0) * self._width)
        rest = np.square(radii) - np.square(np.maximum(gaps, 0.0))
        slack = 4.0 * np.spacing(self._sorted[-1]) if len(self._sorted) else 0.0
        half = np.sqrt(np.maximum(rest, 0.0)) + slack
        low, high = np.maximum(y - half, -1.0), np.minimum(y + half, self._end)
        above = np.arange(np.ceil(2.0 * largest / self._height) + 1.0)
        layer = np.floor((z - radii) / self._height) + above[:, None]
        real = (layer * self._height <= z + radii) & (layer >= 0.0) & (layer < self._layers)
        wanted = np.flatnonzero(real[:, None] & (rest >= 0.0) & (low <= high))
        begin = (columns * self._layers + layer[:, None]) * self._span
        first = np.searchsorted(self._sorted, (begin + low).ravel()[wanted], side='left')
        last = np.searchsorted(self._sorted, (begin + high).ravel()[wanted], side='right')
        starts, lengths = np.zeros((2, begin.size), dtype=np.int64)
        starts[wanted] = first
        lengths[wanted] = last - first
        return along, starts.reshape(-1, len(along)).T, lengths.reshape(-1, len(along)).T


def moments_around(
    points: NDArray[np.float64], places: NDArray[np.float64], radius: float
) -> NDArray[np.float64]:
    """Moments (10, P) of the ``points`` (N, 3) within ``radius`` metres of ``places`` (P, 3)."""
    index = RowIndex(points.T, radius)
    numbers, moments = products(index.points), np.zeros((len(places), NUMBERS))
    for pairs in index.search(places.T, np.full(len(places), radius)):
        weights = np.ones(len(pairs.rows))
        sums = sum_products(pairs.rows, pairs.columns, weights, numbers, len(pairs.queries))
        moments[pairs.queries] = sums
    return moments.T
