"""Neighbours that come and go between candidates.

Let scan s hold a point p and scan t the query q, both placed at the reference, and let a candidate
move them by D_s and D_t. Then D_s p − D_t q = R_s (p − q) + (D_s − D_t) q, so the distance of the
pair changes by at most the drift |(D_s − D_t) q|, whatever p is. Pairs whose distance is
further from the radius than any candidate's drift stay in or out. The few others, the shell, are
looked at again for every candidate.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.criteria.moments import sum_products

ROUNDING = 1e-9
"""Metres that a distance may be off by rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class Shell:
    """Pairs near the rim: ``judge`` (N,), ``scan`` (N,) of the point, ``points`` (3, N).

    ``apart`` (3, N) is point minus judge and ``inside`` (N,) whether it is within the radius, all
    at the reference.
    """

    judge: NDArray[np.int64]
    scan: NDArray[np.int64]
    points: NDArray[np.float64]
    apart: NDArray[np.float64]
    inside: NDArray[np.bool_]

    def flips(
        self, motions: NDArray[np.float64], drifts: NDArray[np.float64], radius: float
    ) -> NDArray[np.float64]:
        """Moments (10, C, P) of what came, less those of what went, of P judges.

        ``motions`` (C, S, 4, 4) are the D_s and ``drifts`` (3, C, S, P) those of the judges.
        """
        count, judges = drifts.shape[1], drifts.shape[3]
        squares = np.zeros((count, len(self.judge)))
        place = self.scan * judges + self.judge
        for drift, apart in zip(drifts.reshape(3, count, -1), self.apart, strict=True):
            steps = drift.take(place, axis=1, mode='clip')
            steps += apart
            steps *= steps
            squares += steps
        changed = np.flatnonzero((squares <= radius**2) != self.inside)
        candidate, pair = np.divmod(changed, max(len(self.judge), 1))
        moved = motions[candidate, self.scan[pair]]
        placed = np.einsum('nij,jn->in', moved[:, :3, :3], self.points[:, pair]) + moved[:, :3, 3].T
        rows, size = candidate * judges + self.judge[pair], count * judges
        # What went is summed behind what came.
        rows += size * self.inside[pair]
        sums = sum_products(rows, np.arange(len(rows)), placed, 2 * size)
        return (sums[:, :size] - sums[:, size:]).reshape(-1, count, judges)


def drifts(
    motions: NDArray[np.float64], queries: NDArray[np.float64], scan: NDArray[np.int64]
) -> NDArray[np.float64]:
    """R_sᵀ(D_s − D_t) q in metres, (3, C, S, Q), for ``queries`` (3, Q) of the scans ``scan`` (Q,).

    The turn by R_sᵀ makes |p − q + drift| the distance of a pair. ``scan`` must ascend.
    """
    count, scans = motions.shape[:2]
    tilde = np.ones((4, queries.shape[1]))
    tilde[:3] = queries
    back = np.swapaxes(motions[:, :, :3, :3], -1, -2)
    found = np.empty((3 * count * scans, queries.shape[1]))
    bounds = np.searchsorted(scan, np.arange(scans + 1)).tolist()
    for own, (start, end) in enumerate(pairwise(bounds)):
        if start == end:
            continue
        mine = slice(start, end)
        against = back @ (motions[:, :, :3] - motions[:, own : own + 1, :3])
        rows = against.transpose(2, 0, 1, 3).reshape(-1, 4)
        # For so short a sum einsum is twice as quick as a matrix product.
        np.einsum('rk,kq->rq', rows, tilde[:, mine], out=found[:, mine])
    return found.reshape(3, count, scans, queries.shape[1])


def squared_lengths(drifts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Squared lengths (C, S, Q) of ``drifts`` (3, C, S, Q)."""
    squares: NDArray[np.float64] = drifts[0] * drifts[0]
    squares += drifts[1] * drifts[1]
    squares += drifts[2] * drifts[2]
    return squares
