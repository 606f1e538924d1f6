"""Whether one candidate's map is truly sharper than another's, or only by chance.

Two candidates are judged at the same query points, so they are compared in pairs: what counts is
the difference of each point's plane variance, not the scores' own spread, which is that of the
street. Points of one plane are moved alike by one pose and are no independent witnesses, so the
standard error is that of the planes' sums (cluster-robust).
"""

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.quantiles import chi_squared, student_t

FEWEST_PLANES = 3
"""With fewer planes their spread tells nothing, and the lower score stands."""


def planes_of(
    points: NDArray[np.float64],
    family: NDArray[np.int64],
    axes: NDArray[np.float64],
    thickness: float,
) -> NDArray[np.int64]:
    """Tell which query points lie in one plane.

    Args:
        points: Query points (P, 3), metres.
        family: Family of each point (P,), a row of ``axes``.
        axes: Normals of the families (3, 3), one unit vector a row.
        thickness: Points of one family whose offsets along its axis are in the same slice of so
            many metres are of one plane.

    Returns:
        A number for each point (P,), 0 to G - 1 for G planes.
    """
    offsets = np.einsum('pi,pi->p', points, axes[family])
    slices = np.floor(offsets / thickness).astype(np.int64)
    slices -= slices.min(initial=0)
    # One number for both is sorted at a third of the cost of a pair.
    both = family * (slices.max(initial=0) + 1) + slices
    order = both.argsort()
    ordered = both[order]
    number = np.zeros(len(both), dtype=np.int64)
    number[order[1:]] = (ordered[1:] != ordered[:-1]).cumsum()
    return number


def ties(
    variances: NDArray[np.float64],
    best: int,
    weights: NDArray[np.float64],
    planes: NDArray[np.int64],
    confidence: float,
) -> NDArray[np.bool_]:
    """Tell which candidates cannot be told from the best one.

    Args:
        variances: Plane variance of every query point under every candidate (C, P), m^2.
        best: Index of the candidate with the lowest score.
        weights: Weights (P,) with which the variances make the score.
        planes: Plane of each point (P,).
        confidence: A candidate is worse where the mean difference is above zero at this level of
            a one-sided t-test.

    Returns:
        Whether each candidate (C,) ties with the best, which always does.
    """
    count = int(planes.max()) + 1 if len(planes) else 0
    sums = np.zeros((len(variances), count))
    np.add.at(sums.T, planes, ((variances - variances[best]) * weights).T)
    total = sums.sum(axis=1)
    tied: NDArray[np.bool_] = total <= 0.0
    if count >= FEWEST_PLANES:
        spread = ((sums - total[:, None] / count) ** 2).sum(axis=1)
        error = np.sqrt(spread * count / (count - 1))
        # Not finite are those without a map, which never win.
        with np.errstate(invalid='ignore'):
            tied = total <= student_t(confidence, count - 1) * error
    tied[best] = True
    return tied


def agrees(
    cost: float, freedom: int, least_cost: float, least_freedom: int, confidence: float
) -> bool:
    """Tell whether a candidate's factors agree as well as those of the least contradicted one.

    A smaller graph has fewer variables to satisfy the same measurements with; what it contradicts
    them more by is chi-squared distributed with the variables' number of degrees of freedom, if
    its clusters do no harm. Where even the least contradicted graph has more than its degrees of
    freedom, the measurements' noise is larger than it is said to be, and so may the difference be.

    Args:
        cost: Σ‖h(x)−z‖²_Σ of its factors and of what they move in G(t-1).
        freedom: Its degrees of freedom: dimensions of factors less those of variables.
        least_cost: The same of the candidate with the least cost.
        least_freedom: The degrees of freedom of that one.
        confidence: Level of the test.

    Returns:
        Whether it does.
    """
    scale = max(least_cost / max(least_freedom, 1), 1.0)
    more = max(freedom - least_freedom, 1)
    return bool(cost - least_cost <= scale * chi_squared(confidence, more))
