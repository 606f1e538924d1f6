"""Which local maps may show the same place: by where they lie, and by what they look like."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, TypeAlias

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.closures.local_maps import LocalMap
from incremental_mapper.config import ClosureSettings

LIBRARY = 'map_closures'
INSTALL = 'pip install "incremental_mapper[closures]"'
SPACING = 4
"""The library skips local maps whose numbers differ by 3 or less; here ``min_travel`` decides."""
FEWEST_POINTS = 200
"""A local map with fewer points has nothing to be recognised by."""


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """What is known of a relative pose already.

    ``covariance`` (6, 6) is that of ``T_first_second`` in the frame of the second, rotation first.
    """

    T_first_second: gtsam.Pose3
    covariance: NDArray[np.float64]


Relative: TypeAlias = Callable[[LocalMap, LocalMap], Known | None]
"""What is known of the relative pose of two local maps, None for nothing at all."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """Two local maps, by their places in a list, and where the second may lie in the first."""

    first: int
    second: int
    T_first_second: gtsam.Pose3


def can_recognise() -> bool:
    """Whether the library is installed that finds places by what they look like."""
    try:
        import_module(LIBRARY)
    except ImportError:
        return False
    return True


def comparable(first: LocalMap, second: LocalMap, settings: ClosureSettings) -> bool:
    """Whether the way between two local maps is long enough for a closure to tell anything."""
    if first.run != second.run:
        return True
    return abs(second.travelled - first.travelled) >= settings.min_travel


def by_place(maps: Sequence[LocalMap], settings: ClosureSettings) -> list[Candidate]:
    """Pairs that lie near each other by the poses that are known so far.

    Args:
        maps: Local maps in one frame, drive by drive in the order of their ways.
        settings: How near, and how many for each local map.

    Returns:
        For each local map the nearest ones before it.
    """
    positions = np.array([one.T_map_base.translation() for one in maps]).reshape(-1, 3)
    found: list[Candidate] = []
    for second, own in enumerate(maps):
        apart = np.linalg.norm(positions[:second, :2] - positions[second, :2], axis=1)
        taken = 0
        for first in np.argsort(apart, kind='stable').tolist():
            if apart[first] > settings.radius or taken == settings.candidates:
                break
            if comparable(maps[first], own, settings):
                relative = maps[first].T_map_base.between(own.T_map_base)
                found.append(Candidate(first, second, relative))
                taken += 1
    return found


def by_looks(
    maps: Sequence[LocalMap], settings: ClosureSettings, among: Collection[int] | None = None
) -> list[Candidate]:
    """Pairs that look alike from above (density maps), wherever they are thought to lie.

    Args:
        maps: As for ``by_place``; the library must be installed, see ``can_recognise``.
        settings: How many for each local map.
        among: The places in ``maps`` of those that are compared with each other; None is all. What
            it costs grows with the square of their number.
    """
    library: Any = import_module(LIBRARY + '.map_closures')
    detector = library.MapClosures()
    found: list[Candidate] = []
    for second, own in enumerate(maps):
        if len(own.points) < FEWEST_POINTS or not (among is None or second in among):
            continue
        alike = detector.get_closures(SPACING * second, own.points.astype(np.float64))
        alike = sorted(alike, key=lambda one: (-one.number_of_inliers, one.source_id))
        taken = 0
        for one in alike:
            first = int(one.source_id) // SPACING
            if taken == settings.candidates or first >= second:
                break
            # The pose that the library tells moves the earlier local map onto the later one.
            pose = np.asarray(one.pose, dtype=np.float64)
            if comparable(maps[first], own, settings) and np.isfinite(pose).all():
                found.append(Candidate(first, second, gtsam.Pose3(pose).inverse()))
                taken += 1
    return found
