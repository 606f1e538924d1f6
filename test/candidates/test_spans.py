"""Which IMU samples make a span, and across which holes none is made."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from incremental_mapper.candidates.spans import ImuStamps


def first_by_definition(samples, start, end, max_gap):
    inside = [stamp for stamp in sorted(samples) if start <= stamp < end]
    if not inside:
        return None
    edges = [start, *inside, end]
    return inside[0] if max(np.diff(edges)) <= max_gap else None


@given(
    st.sets(st.integers(0, 60), max_size=20),
    st.integers(-5, 65),
    st.integers(1, 70),
    st.integers(1, 40),
)
def test_span_is_usable_where_no_hole_is_longer_than_the_setting(samples, start, length, gap):
    imu = ImuStamps(np.array(sorted(samples), dtype=np.int64), gap)
    expected = first_by_definition(samples, start, start + length, gap)
    assert imu.first_sample(start, start + length) == expected
    # Asked again, it says the same.
    assert imu.first_sample(start, start + length) == expected
    low, high = imu.bounds(start, start + length)
    assert imu.stamps[low:high].tolist() == [
        stamp for stamp in sorted(samples) if start <= stamp < start + length
    ]


@pytest.mark.parametrize(
    ('start', 'end', 'usable'),
    [(0, 30, True), (-1, 30, False), (0, 31, False), (10, 10, False), (11, 30, True)],
)
def test_hole_may_be_as_long_as_the_setting_and_no_longer(start, end, usable):
    imu = ImuStamps(np.array([10, 20], dtype=np.int64), 10)
    assert (imu.first_sample(start, end) is not None) == usable
    assert imu.first_sample(0, 30) == 10
