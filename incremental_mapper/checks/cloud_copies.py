"""Clouds that somebody made of the clouds of another topic: cropped, thinned, de-skewed, moved."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from incremental_mapper.measurements import Points

FULL_CLOUDS = 3
"""First clouds of a topic that are compared point by point."""
_COMMON = 0.8
"""Share of stamps that a copy has from its original; LiDARs of their own have stamps of their own,
or are synchronised to the nanosecond."""
_FEWEST_COMMON = 3
_COMPARED = 300
"""Points of a copy whose nearest in the original is looked for."""
_NEAR = 0.15
"""Metres from half of a copy's points to the nearest of the original."""


@dataclass(frozen=True, slots=True, eq=False)
class CloudTopic:
    """What the first clouds of a topic show.

    Attributes:
        frame: Their frame_id.
        sizes: Number of usable points by stamp.
        clouds: Usable points (N, 3) by stamp of the first ``FULL_CLOUDS``.
    """

    frame: str
    sizes: Mapping[int, int]
    clouds: Mapping[int, Points]


def copied_from(topics: Mapping[str, CloudTopic]) -> dict[str, str]:
    """Find the topics that are copies of others.

    Args:
        topics: By name, the likeliest originals first where two are equal.

    Returns:
        The original of each copy; an original is the copy of none.
    """
    ordered = sorted(topics, key=lambda name: -np.median([*topics[name].sizes.values(), 0]))
    found: dict[str, str] = {}
    for index, name in enumerate(ordered):
        originals = (other for other in ordered[:index] if other not in found)
        original = next((other for other in originals if _copy(topics[name], topics[other])), None)
        if original is not None:
            found[name] = original
    return found


def _copy(copy: CloudTopic, original: CloudTopic) -> bool:
    """Whether the stamps are the original's, and the points as well."""
    common = copy.sizes.keys() & original.sizes.keys()
    fewest = min(len(copy.sizes), len(original.sizes))
    if len(common) < _FEWEST_COMMON or len(common) < _COMMON * fewest:
        return False
    if copy.frame != original.frame:
        # Moved to another frame, no point is where it was, but none is lost either.
        sizes = {copy.sizes[stamp] for stamp in common}
        return len(sizes) > 1 and all(copy.sizes[at] == original.sizes[at] for at in common)
    at = next((stamp for stamp in copy.clouds if stamp in original.clouds), None)
    if at is None or not len(copy.clouds[at]) or not len(original.clouds[at]):
        return False
    points = copy.clouds[at]
    some = points[np.linspace(0, len(points) - 1, _COMPARED).astype(int)]
    distances, _ = cKDTree(original.clouds[at]).query(some)
    return bool(np.median(distances) < _NEAR)
