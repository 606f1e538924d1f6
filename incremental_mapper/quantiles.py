"""Medians of a few numbers, and quantiles of the distributions that tests are made of.

These are from ``scipy.special``: ``scipy.stats`` takes as long to start as most other libraries
together, and as long for a quantile as a small solve. ``np.median`` takes ten times as long as
sorting does.
"""

from collections.abc import Iterable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv, stdtrit


def median(values: Iterable[float]) -> float:
    """Median of a few finite numbers, at least one."""
    ordered = sorted(values)
    half = len(ordered) // 2
    return ordered[half] if len(ordered) % 2 else (ordered[half - 1] + ordered[half]) / 2.0


def median_row(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Median (k,) of each column of a few finite rows (N, k), at least one."""
    ordered = np.sort(rows, axis=0)
    half = len(ordered) // 2
    middle: NDArray[np.float64] = ordered[half]
    return middle.copy() if len(ordered) % 2 else (ordered[half - 1] + middle) / 2.0


@lru_cache(maxsize=4096)
def chi_squared(probability: float, freedom: float) -> float:
    """Quantile of chi squared.

    Args:
        probability: Of a smaller value, 0 to 1.
        freedom: Degrees of freedom.
    """
    return float(2.0 * gammaincinv(0.5 * freedom, probability))


@lru_cache(maxsize=4096)
def student_t(probability: float, freedom: float) -> float:
    """Quantile of Student's t.

    Args:
        probability: Of a smaller value, 0 to 1.
        freedom: Degrees of freedom.
    """
    return float(stdtrit(freedom, probability))
