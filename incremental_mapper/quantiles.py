"""Quantiles of the distributions that tests are made of.

From ``scipy.special``: ``scipy.stats`` takes as long to start as most other libraries together, and
as long for a quantile as a small solve.
"""

from functools import lru_cache

from scipy.special import gammaincinv, stdtrit


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
