"""Points that are too far away to be in metres."""

import numpy as np
import pytest

from incremental_mapper.checks.finding import Severity
from incremental_mapper.checks.point_ranges import CLOUDS, far_points, point_ranges
from incremental_mapper.config import Config, LidarSensor
from incremental_mapper.mapping.range_watch import EVERY, RangeWatch
from incremental_mapper.measurements import make_scan


def street(scale, seed=0):
    """Ground from 2.3 m on, and walls up to 60 m."""
    rng = np.random.default_rng(seed)
    ways = rng.normal(size=(3000, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    ranges = 2.3 * (60.0 / 2.3) ** (rng.random(len(ways)) ** 1.5)
    return (scale * ways * ranges[:, None]).astype(np.float32)


def looks(scale):
    found = [point_ranges(street(scale, seed)) for seed in range(CLOUDS)]
    return [one for one in found if one is not None]


@pytest.mark.parametrize('scale', [0.3, 1.0, 3.2808])
def test_metres_and_less_than_all_that_is_told_by_the_way_are_not_far(scale):
    assert far_points('left', looks(scale)) is None


@pytest.mark.parametrize('scale', [10.0, 100.0, 1000.0])
def test_decimetres_and_smaller_units_are_told(scale):
    found = far_points('left', looks(scale))
    assert found is not None and found.severity is Severity.WARNING
    assert 'lidars.left.scale' in found.remedy


def test_the_ground_below_an_aircraft_is_far_but_not_as_far_as_all_that():
    below = np.random.default_rng(0).uniform(30.0, 80.0, (3000, 1)) * [[0.0, 0.0, -1.0]]
    assert far_points('left', [point_ranges(below.astype(np.float32))] * CLOUDS) is None


def test_few_points_tell_nothing():
    assert point_ranges(street(10.0)[:40]) is None
    assert point_ranges(street(10.0) * np.nan) is None


@pytest.mark.parametrize(('scale', 'count'), [(1.0, 1), (0.1, 0)])
def test_the_scale_of_the_settings_counts_and_it_is_told_once(scale, count):
    watch = RangeWatch(Config(lidars={'left': LidarSensor(scale=scale)}))
    scans = [make_scan(10**18 + n, 'left', street(10.0, n)) for n in range(3 * CLOUDS * EVERY)]
    assert sum(watch.scan(one) is not None for one in scans) == count
