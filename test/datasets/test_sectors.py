"""Sectors of a sweep become the sweep that they are of."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from incremental_mapper.datasets.sectors import SectorGatherer
from incremental_mapper.measurements import LidarScan

MS = 1_000_000


def sector(begin, end, stamp, times=None):
    """Points from one azimuth to another, in radians."""
    azimuth = np.linspace(begin, end, 50, endpoint=False)
    points = np.column_stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth]) * 9.0
    return LidarScan(stamp, 'left', points.astype(np.float32), times)


def gather(sectors):
    gatherer = SectorGatherer()
    sweeps = [gatherer.take(part) for part in sectors]
    return [sweep for sweep in [*sweeps, gatherer.finish()] if sweep is not None]


def turning(parts, sweeps, field=2 * np.pi, direction=1.0, start=0.3):
    step = direction * field / parts
    for i in range(parts * sweeps):
        begin = start + (i % parts) * step
        yield sector(begin, begin + step, 100 * MS * i // parts)


@settings(deadline=None)
@given(
    st.integers(2, 40), st.floats(2.0, 2 * np.pi), st.sampled_from([-1.0, 1.0]), st.floats(0, 6.28)
)
def test_every_sweep_has_all_its_sectors(parts, field, direction, start):
    sweeps = gather(turning(parts, 4, field, direction, start))
    assert [len(sweep.points) for sweep in sweeps] == [50 * parts] * 4
    assert [sweep.stamp for sweep in sweeps] == [
        100 * MS * ((i + 1) * parts - 1) // parts for i in range(4)
    ]


@pytest.mark.parametrize('direction', [-1.0, 1.0])
def test_points_without_times_get_them_from_the_turning(direction):
    sweep = gather(turning(10, 2, direction=direction))[0]
    times = sweep.point_times.reshape(10, 50)
    # A sector's stamp is that of its middle.
    np.testing.assert_allclose(times[:, 25], np.arange(-9, 1) * 0.01, atol=2e-4)
    assert (np.diff(times, axis=1) > 0).all() and times[-1, -1] == pytest.approx(0.005, abs=3e-4)


def test_times_of_the_points_themselves_count_from_the_sweep():
    own = np.linspace(0.0, 0.01, 50).astype(np.float32)
    parts = [sector(0.628 * i, 0.628 * (i + 1), 10 * MS * i, own) for i in range(20)]
    sweep = gather(parts)[0]
    np.testing.assert_allclose(sweep.point_times.reshape(10, 50)[0], own - 0.09, atol=1e-6)


def test_intensities_stay_with_their_points():
    light = np.arange(50, dtype=np.float32)
    parts = [replace(part, intensities=light + i) for i, part in enumerate(turning(10, 2))]
    sweep = gather(parts)[0]
    np.testing.assert_array_equal(sweep.intensities.reshape(10, 50)[4], light + 4)
    parts[3] = replace(parts[3], intensities=None)
    assert [sweep.intensities is None for sweep in gather(parts)] == [True, False]


def test_lost_sectors_and_long_pauses():
    parts = list(turning(10, 6))
    del parts[13], parts[30:32]
    sizes = [len(sweep.points) // 50 for sweep in gather(parts)]
    assert sum(sizes) == len(parts) and set(sizes) <= {8, 9, 10}
    late = [*turning(10, 1), *(sector(0, 0.6, 3000 * MS + i) for i in range(1))]
    assert len(gather(late)[0].points) == 500


def test_a_rest_of_a_sweep_at_the_end_is_none():
    assert len(gather(list(turning(10, 3))[:-6])) == 2
