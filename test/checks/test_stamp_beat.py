"""Whether a LiDAR's stamps keep an even beat."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from incremental_mapper.checks.stamp_beat import RUNS, UNEVEN, beat_finding, beat_scatter

MS = 1_000_000


def stamps(count=24, period=100.9, jitter=0.0, seed=1):
    late = jitter * np.random.default_rng(seed).exponential(size=count)
    return np.sort(((np.arange(count) * period + late) * MS).astype(np.int64))


@given(st.floats(25.0, 400.0), st.sets(st.integers(1, 22), max_size=4))
def test_an_even_beat_scatters_by_nothing_however_fast_and_with_gaps(period, lost):
    whole = stamps(period=period)
    assert beat_scatter(np.delete(whole, sorted(lost))) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize('share', [2, 3])
def test_every_second_or_third_scan_may_be_lost(share):
    whole = stamps(count=36)
    for start in range(share):
        assert beat_scatter(np.delete(whole, slice(start, None, share))) == pytest.approx(
            0.0, abs=1e-6
        )


@pytest.mark.parametrize('jitter', [7.0, 10.0])
def test_times_of_arrival_scatter_by_their_jitter(jitter):
    scatters = [beat_scatter(stamps(jitter=jitter, seed=seed)) for seed in range(200)]
    # A line through 24 stamps takes two of the 24 degrees of freedom.
    unbiased = np.sqrt(np.mean(np.square(scatters)) * 24.0 / 22.0)
    assert unbiased == pytest.approx(jitter / 1000.0, rel=0.1)
    found = beat_finding('left', scatters)
    assert found.rule == 'uneven_stamps' and found.sensor == 'left'


def test_a_millisecond_is_nothing_to_speak_of():
    scatters = [beat_scatter(stamps(jitter=1.0, seed=seed)) for seed in range(20)]
    assert max(scatters) < UNEVEN and beat_finding('left', scatters) is None


def test_keyframes_and_few_stamps_have_no_beat():
    keyframes = np.cumsum(np.random.default_rng(2).uniform(50, 800, 24) * MS).astype(np.int64)
    assert beat_scatter(keyframes) is None
    assert beat_scatter(stamps(count=8)) is None
    assert beat_finding('left', [1.0] * (RUNS - 1)) is None
