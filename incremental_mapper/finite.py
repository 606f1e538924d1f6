"""The one place that tells numbers that are none, before they reach a file or a message."""

from collections.abc import Mapping
from typing import Any

import numpy as np


def not_finite(numbers: Mapping[str, Any]) -> str:
    """Say which numbers are not finite.

    Args:
        numbers: Arrays of floats, or what NumPy makes them of, by name; None is left out.

    Returns:
        Each name with how many of how many, ``''`` where all are finite.
    """
    found = []
    for name, values in numbers.items():
        if values is None:
            continue
        array = np.asarray(values)
        wrong = array.size - int(np.isfinite(array).sum())
        if wrong:
            found.append(f'{wrong} of {array.size} numbers of {name}')
    return ', '.join(found)
