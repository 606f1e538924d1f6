"""The smooth step from 0 to 1 that speed ramps and road bends are made of.

Its slope and the slope's first two derivatives vanish at both ends, so speeds and curvatures
that are joined from such steps are three times continuously differentiable.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def step(u: Array) -> Array:
    """Value at ``u``; 0 before u = 0 and 1 after u = 1."""
    x = np.clip(u, 0.0, 1.0)
    return x**4 * (35.0 + x * (-84.0 + x * (70.0 - 20.0 * x)))


def step_slope(u: Array) -> Array:
    """Derivative of ``step``; its peak is 35/16 at u = 0.5."""
    x = np.clip(u, 0.0, 1.0)
    return 140.0 * (x * (1.0 - x)) ** 3


def step_integral(u: Array) -> Array:
    """Integral of ``step`` from 0 to ``u`` for u <= 1; it is 0.5 at u = 1."""
    x = np.clip(u, 0.0, 1.0)
    return x**5 * (7.0 + x * (-14.0 + x * (10.0 - 2.5 * x)))
