"""Single decisions lead from any candidate to any other, and never out of the enumeration."""

from hypothesis import given, settings
from test_search import windows

from incremental_mapper.candidates.enumeration import base_candidate, candidates
from incremental_mapper.candidates.neighbours import neighbours


@settings(deadline=None, max_examples=80)
@given(windows())
def test_neighbours_are_candidates_and_reach_all_of_them(window):
    parts, head, imu = window
    every = set(candidates(parts, head, imu))
    start = base_candidate(parts, head, imu)
    seen, waiting = {start}, [start]
    while waiting:
        for other in neighbours(waiting.pop(), parts, head, imu):
            assert other in every
            if other not in seen:
                seen.add(other)
                waiting.append(other)
    assert seen == every
