"""The best step of a small linear least-squares problem, compiled.

A window's problem has a few dozen unknowns and its rows few entries each, so that calls of a
library cost more than the work.
"""

from math import sqrt

import numpy as np

from incremental_mapper.compiled import kernel
from incremental_mapper.smoothing.tangent_layout import Array


def best_step(
    prior: tuple[Array, Array, Array],
    loose: tuple[float, Array],
    factors: tuple[Array, Array],
) -> tuple[Array, Array, Array, Array] | None:
    """The step δ (n,) that is best by ‖root · δ − rhs‖² of three kinds of rows.

    ``prior`` is root (m, k), rhs (m,) and rootᵀ · root (k, k) of the first k variables, ``loose``
    is one over the standard deviation of the n − k others, and the rhs (n − k,) of each, and
    ``factors`` are rows (r, n) and rhs (r,). What the step leaves of the three rhs comes behind it.
    None where the step would not be finite.

    Normal equations square the condition of the rows, which short IMU spans make large; what
    that costs is made good by solving once more for what the first solution leaves.
    """
    # An array with gaps would be another type to compile for.
    root, prior_rhs, information = map(np.ascontiguousarray, prior)
    rows, factor_rhs = map(np.ascontiguousarray, factors)
    weight, loose_rhs = loose
    found, step, *rest = _best(
        root, prior_rhs, information, weight, np.ascontiguousarray(loose_rhs), rows, factor_rhs
    )
    return (step, rest[0], rest[1], rest[2]) if found else None


def warm_up() -> None:
    """Compile the kernel, or load it from disk."""
    one, none = np.ones((1, 1)), np.zeros(0)
    best_step((one, np.ones(1), one), (1.0, none), (one, np.ones(1)))


@kernel
def _best(
    root: Array,
    prior_rhs: Array,
    information: Array,
    weight: float,
    loose_rhs: Array,
    rows: Array,
    factor_rhs: Array,
) -> tuple[bool, Array, Array, Array, Array]:
    """See best_step; whether there is a step comes first."""
    known, size = root.shape[1], rows.shape[1]
    prior, loose, factors = prior_rhs.copy(), loose_rhs.copy(), factor_rhs.copy()
    step, slope = np.zeros(size), np.empty(size)
    # Only what is not above the diagonal is used.
    a = np.zeros((size, size))
    for i in range(known):
        for j in range(i + 1):
            a[i, j] = information[i, j]
    for i in range(known, size):
        a[i, i] = weight * weight
    for r in range(len(rows)):
        first = 0
        while first < size and rows[r, first] == 0.0:
            first += 1
        for i in range(first, size):
            value = rows[r, i]
            if value != 0.0:
                for j in range(first, i + 1):
                    a[i, j] += value * rows[r, j]
    # The newest variables are eliminated first: along the chain of clusters little fills in.
    # Row k of the triangle L with Lᵀ · L = a takes the place of row k.
    for k in range(size - 1, -1, -1):
        pivot = a[k, k]
        if not 0.0 < pivot < np.inf:
            return False, step, prior, loose, factors
        pivot, first = sqrt(pivot), k
        a[k, k] = pivot
        for j in range(k - 1, -1, -1):
            if a[k, j] != 0.0:
                a[k, j] /= pivot
                first = j
        for i in range(first, k):
            value = a[k, i]
            if value != 0.0:
                for j in range(first, i + 1):
                    a[i, j] -= value * a[k, j]
    for _ in range(2):
        for j in range(known):
            slope[j] = 0.0
        for j in range(known, size):
            slope[j] = loose[j - known] * weight
        for r in range(len(root)):
            for j in range(known):
                slope[j] += prior[r] * root[r, j]
        for r in range(len(rows)):
            for j in range(size):
                slope[j] += factors[r] * rows[r, j]
        for k in range(size - 1, -1, -1):
            slope[k] /= a[k, k]
            for j in range(k):
                slope[j] -= slope[k] * a[k, j]
        for k in range(size):
            for j in range(k):
                slope[k] -= a[k, j] * slope[j]
            slope[k] /= a[k, k]
        for j in range(size):
            step[j] += slope[j]
        for r in range(len(root)):
            for j in range(known):
                prior[r] -= root[r, j] * slope[j]
        for j in range(known, size):
            loose[j - known] -= weight * slope[j]
        for r in range(len(rows)):
            for j in range(size):
                factors[r] -= rows[r, j] * slope[j]
    for j in range(size):
        if not abs(step[j]) < np.inf:
            return False, step, prior, loose, factors
    return True, step, prior, loose, factors
