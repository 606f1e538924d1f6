"""Which points lie around a query, and their moments, when both may still move a little.

A pair that is well inside the radius stays inside under any small motion, so its share goes into
a moment once and for all. Pairs near the rim, the shell, are looked at again for every candidate.
With that, the fast evaluation has the very neighbourhoods that a new search would find, as long
as nothing moves by more than the margin.
"""

from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import KDTree

_UPPER = np.triu_indices(4)


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Neighbours of queries: query ``rows`` (N,), point ``columns`` (N,), ``squares`` (N,) m^2.

    ``rows`` ascend unless somebody renumbered them.
    """

    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    squares: NDArray[np.float64]

    def select(self, mask: NDArray[np.bool_]) -> 'Pairs':
        """The pairs where ``mask`` (N,) holds."""
        return Pairs(self.rows[mask], self.columns[mask], self.squares[mask])


def find_pairs(points: NDArray[np.float64], queries: NDArray[np.float64], radius: float) -> Pairs:
    """All pairs of ``queries`` (Q, 3) and ``points`` (N, 3) within ``radius`` metres."""
    # An unbalanced tree is built in half the time and is asked only once.
    tree = KDTree(points, leafsize=24, balanced_tree=False, compact_nodes=False)
    lists = tree.query_ball_point(queries, radius, return_sorted=False, workers=-1)
    lengths = np.fromiter((len(found) for found in lists), dtype=np.int64, count=len(lists))
    columns = np.fromiter(chain.from_iterable(lists), dtype=np.int64, count=int(lengths.sum()))
    rows = np.repeat(np.arange(len(queries)), lengths)
    steps = points[columns] - queries[rows]
    return Pairs(rows, columns, np.einsum('ij,ij->i', steps, steps))


def outer_products(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """The ten different numbers (N, 10) of p̃ p̃ᵀ with p̃ = (p, 1)."""
    tilde = np.append(points, np.ones((len(points), 1)), axis=1)
    products: NDArray[np.float64] = tilde[:, _UPPER[0]] * tilde[:, _UPPER[1]]
    return products


def to_moments(sums: NDArray[np.float64]) -> NDArray[np.float64]:
    """Symmetric matrices (..., 4, 4) of their ten numbers (..., 10)."""
    moments = np.empty((*sums.shape[:-1], 4, 4))
    moments[..., _UPPER[0], _UPPER[1]] = sums
    moments[..., _UPPER[1], _UPPER[0]] = sums
    return moments


def sum_moments(
    pairs: Pairs,
    products: NDArray[np.float64],
    queries: int,
    owner: NDArray[np.int64] | None = None,
    owners: int = 1,
) -> NDArray[np.float64]:
    """Moments (owners, queries, 4, 4): Σ p̃ p̃ᵀ over each query's neighbours, split by owner.

    ``products`` (N, 10) are those of the points and ``owner`` (N,) says whose they are; without
    it the rows of ``pairs`` must ascend.
    """
    shape = (owners * queries, len(products))
    ones = np.ones(len(pairs.rows))
    if owner is None:
        # The pairs come query by query, so the matrix need not be sorted first.
        starts = np.searchsorted(pairs.rows, np.arange(queries + 1))
        matrix = csr_array((ones, pairs.columns, starts), shape=shape)
    else:
        rows = owner[pairs.columns] * queries + pairs.rows
        matrix = csr_array((ones, (rows, pairs.columns)), shape=shape)
    return to_moments(np.asarray(matrix @ products).reshape(owners, queries, 10))


@dataclass(frozen=True, slots=True, eq=False)
class Shell:
    """Pairs near the rim, sorted by the scan that the point belongs to.

    ``points`` (N, 3) are in that scan's frame; scan s has the pairs starts[s] to starts[s + 1].
    """

    rows: NDArray[np.int64]
    points: NDArray[np.float64]
    starts: NDArray[np.int64]

    def moments(
        self, poses: NDArray[np.float64], queries: NDArray[np.float64], radius: float
    ) -> NDArray[np.float64]:
        """Moments (Q, 4, 4) of the shell's points that are inside, at ``poses`` (S, 4, 4)."""
        placed = np.empty_like(self.points)
        for pose, low, high in zip(poses, self.starts[:-1], self.starts[1:], strict=True):
            placed[low:high] = self.points[low:high] @ pose[:3, :3].T + pose[:3, 3]
        steps = placed - queries[self.rows]
        inside = np.einsum('ij,ij->i', steps, steps) <= radius**2
        rows, products = self.rows[inside], outer_products(placed[inside])
        sums: NDArray[np.float64] = np.stack(
            [np.bincount(rows, weights=products[:, i], minlength=len(queries)) for i in range(10)],
            axis=-1,
        )
        return to_moments(sums)
