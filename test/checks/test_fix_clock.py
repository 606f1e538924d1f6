"""A receiver whose clock is off, by the way of odometry."""

import numpy as np
import pytest

from incremental_mapper.checks.finding import Severity
from incremental_mapper.checks.fix_clock import TimedTracks, clock_finding
from incremental_mapper.measurements import NANOSECONDS

METRE = np.degrees(1.0 / 6_371_000.0)
START = 1_544_676_777_000_000_000
SECONDS = 25.0


def way(at, straight=False):
    """East and north (K, 2) of a car that speeds up, brakes and turns, at some seconds."""
    grid = np.arange(-5.0, SECONDS + 5.0, 0.01)
    speed = 6.0 if straight else 6.0 + 4.0 * np.sin(0.5 * grid)
    yaw = 0.0 * grid if straight else 0.8 * np.sin(0.3 * grid)
    steps = 0.01 * speed * np.stack([np.cos(yaw), np.sin(yaw)])
    return np.stack([np.interp(at, grid, np.cumsum(one)) for one in steps], axis=1)


def tracks(late=0.0, straight=False, noise=0.03, rate=1.0, drift=0.0):
    """Fixes that say where the car was ``late`` seconds before their stamps."""
    rng = np.random.default_rng(0)
    at = np.arange(0.5, SECONDS - 0.5, 1.0 / rate)
    enu = way(at - late, straight) + rng.normal(scale=noise, size=(len(at), 2))
    latitude = 36.4 + METRE * enu[:, 1]
    longitude = 129.0 + METRE * enu[:, 0] / np.cos(np.radians(36.4))
    moments = np.arange(0.0, SECONDS, 0.1)
    turn = np.array([[0.6, 0.8], [-0.8, 0.6]])
    places = (1.0 + drift) * way(moments, straight) @ turn + [3.0, 1.0]
    return TimedTracks(
        START + np.round(at * NANOSECONDS).astype(np.int64),
        np.stack([latitude, longitude], axis=1),
        noise,
        START + np.round(moments * NANOSECONDS).astype(np.int64),
        places,
    )


@pytest.mark.parametrize(('late', 'rate'), [(0.8, 1.0), (-0.5, 1.0), (0.3, 5.0), (2.0, 5.0)])
def test_the_lag_of_a_clock_is_found_and_mended(late, rate):
    found = clock_finding('gnss', tracks(late, rate=rate), 0.25)
    assert found is not None and found.severity is Severity.MENDED
    assert found.rule == 'gnss_clock'
    assert found.settings['gnss']['time_offset'] == pytest.approx(0.25 - late, abs=0.03)
    assert f'gnss.time_offset: {found.settings["gnss"]["time_offset"]:g}' in found.remedy


@pytest.mark.parametrize('drift', [0.0, 0.02, -0.05])
def test_fixes_in_time_are_left_alone_though_odometry_drifts(drift):
    assert clock_finding('gnss', tracks(drift=drift), 0.0) is None


def test_noise_is_no_lag():
    for late in (0.0, 0.1):
        assert clock_finding('gnss', tracks(late, noise=2.0), 0.0) is None


def test_on_a_straight_road_at_one_speed_nobody_can_tell():
    assert clock_finding('gnss', tracks(0.8, straight=True), 0.0) is None


def test_fixes_that_drift_away_have_no_lag():
    sound = tracks()
    away = METRE * np.arange(len(sound.stamps))[:, None] * [1.0, 0.0]
    moved = TimedTracks(
        sound.stamps, sound.degrees + away, sound.sigma, sound.moments, sound.places
    )
    assert clock_finding('gnss', moved, 0.0) is None
