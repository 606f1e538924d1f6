"""Single decisions lead from any candidate to any other, and never out of the enumeration."""

import numpy as np
from hypothesis import example, given, settings
from window_cases import windows

from incremental_mapper.candidates.enumeration import base_candidate, candidates
from incremental_mapper.candidates.local_moves import neighbours
from incremental_mapper.candidates.model import CoreKind, CoreMeasurement
from incremental_mapper.candidates.spans import ImuStamps

# One sample: the first and the last cluster of a chain cannot be connected to any other, so that
# a connection between two others appears at once or not at all.
PARTS = tuple(
    (CoreMeasurement(stamp, 'gps' if stamp == 10 else 'left', kind),)
    for stamp, kind in (
        (0, CoreKind.LIDAR),
        (1, CoreKind.LIDAR),
        (2, CoreKind.LIDAR),
        (10, CoreKind.GNSS),
        (18, CoreKind.LIDAR),
    )
)
RARE_SAMPLES = PARTS, None, ImuStamps(np.array([9]), max_gap=8)


@settings(deadline=None, max_examples=80)
@given(windows())
@example(RARE_SAMPLES)
def test_neighbours_are_candidates_and_reach_all_of_them(window):
    elements, head, imu = window
    every = set(candidates(elements, head, imu))
    start = base_candidate(elements, head, imu)
    seen, waiting = {start}, [start]
    while waiting:
        for other in neighbours(waiting.pop(), elements, head, imu):
            assert other in every
            if other not in seen:
                seen.add(other)
                waiting.append(other)
    assert seen == every
