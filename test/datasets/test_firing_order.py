"""Times of points by the order in which they were fired."""

from pathlib import Path

import numpy as np
import pytest

from incremental_mapper.datasets.firing_order import TimedScans

DATA = Path(__file__).resolve().parents[3] / 'shared' / 'data' / 'kaist_urban30_left'
SPIN = 2.0 * np.pi / 0.1
COLUMNS = 1320
END = 1_544_581_126_000_000_000
PERIOD = 100_850_000


def sweep(end, seen=lambda azimuth: np.full(azimuth.shape, True), lasers=16):
    """Points (N, 3) of a head that turns clockwise for ever, and the true times (N,)."""
    times = np.repeat(-0.1 / COLUMNS * np.arange(COLUMNS - 1.0, -1.0, -1.0), lasers)
    azimuth = -SPIN * ((end - END) / 1e9 + times)
    level = np.tile(np.linspace(-0.3, 0.3, lasers), COLUMNS)
    points = 10.0 * np.column_stack([np.cos(azimuth), np.sin(azimuth), level])
    kept = seen(azimuth % (2.0 * np.pi))
    return points[kept].astype(np.float32), times[kept]


def timed(*sweeps):
    """A stream of (stamp, points)."""
    return TimedScans(np.array([one[0] for one in sweeps]), lambda index: sweeps[index][1])


def test_a_whole_sweep_ends_with_its_stamp():
    points, times = sweep(END)
    np.testing.assert_allclose(timed((END, points)).load(0)[:, 3], times, atol=2e-7)


def test_a_sweep_that_ends_in_the_sky_is_timed_by_a_whole_one():
    later = END + 7 * PERIOD
    points, times = sweep(later, lambda azimuth: (azimuth > 0.1) & (azimuth < 4.5))
    assert times[-1] < -0.005
    whole = sweep(END)[0]
    np.testing.assert_allclose(timed((END, whole), (later, points)).load(1)[:, 3], times, atol=2e-7)
    # One that comes later tells as much.
    earlier, latest = END, END + 7 * PERIOD
    points, times = sweep(earlier, lambda azimuth: (azimuth > 0.3) & (azimuth < 4.5))
    assert times[-1] < -0.004
    found = timed((earlier, points), (latest, sweep(latest)[0])).load(0)[:, 3]
    np.testing.assert_allclose(found, times, atol=2e-7)


def test_half_a_turn_without_points_in_the_middle_is_no_harm():
    points, times = sweep(END, lambda azimuth: (azimuth < 1.4) | (azimuth > 4.8))
    np.testing.assert_allclose(timed((END, points)).load(0)[:, 3], times, atol=2e-7)


def test_where_a_sweep_ended_is_not_guessed():
    points, _ = sweep(END, lambda azimuth: (azimuth > 1.0) & (azimuth < 4.5))
    assert np.isnan(timed((END, points)).load(0)[:, 3]).all()


@pytest.mark.parametrize('order', ['shuffled', 'backwards', 'by laser'])
def test_points_in_another_order_have_no_times(order):
    points, _ = sweep(END)
    places = np.arange(len(points))
    if order == 'shuffled':
        places = np.random.default_rng(1).permutation(places)
    elif order == 'backwards':
        places = places[::-1]
    else:
        places = places.reshape(-1, 16).T.ravel()
    assert np.isnan(timed((END, points[places])).load(0)[:, 3]).all()


def test_points_without_a_direction_have_no_time():
    points, times = sweep(END)
    points[5], points[9] = 0.0, np.nan
    found = timed((END, points)).load(0)[:, 3]
    assert np.flatnonzero(np.isnan(found)).tolist() == [5, 9]
    np.testing.assert_allclose(np.delete(found, [5, 9]), np.delete(times, [5, 9]), atol=2e-7)
    assert np.isnan(timed((END, np.zeros((40, 3), np.float32))).load(0)[:, 3]).all()


@pytest.mark.skipif(not DATA.is_dir(), reason='real scans are absent')
def test_real_scans_are_in_the_order_of_firing():
    paths = sorted(DATA.glob('*.bin'))
    stamps = np.array([int(path.stem) for path in paths])
    stream = TimedScans(stamps, lambda i: np.fromfile(paths[i], '<f4').reshape(-1, 4))
    for index in range(len(paths)):
        times = stream.load(index)[:, 4]
        # The driver's sweeps are as long as its stamps are apart.
        assert times[0] == pytest.approx(-0.1009, abs=2e-4)
        assert times[-1] == 0.0
