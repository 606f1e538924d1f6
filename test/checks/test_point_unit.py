"""The unit of the points by the way of the fixes."""

import numpy as np
import pytest

from incremental_mapper.checks.finding import Severity
from incremental_mapper.checks.point_unit import unit_finding, way_ratios


def ratios(unit=1.0, noise=0.03, count=20, step=3.0):
    rng = np.random.default_rng(0)
    way = step * np.arange(count)
    enu = np.stack([way, 0.0 * way], axis=1) + rng.normal(scale=noise, size=(count, 2))
    return way_ratios(way / unit, enu, noise)


@pytest.mark.parametrize(('unit', 'name'), [(0.3048, 'feet'), (0.0254, 'inches')])
def test_feet_and_inches_are_known_by_the_way(unit, name):
    found = unit_finding(['left', 'right'], ratios(unit), {'left': 1.0})
    assert found is not None and found.severity is Severity.MENDED and name in found.text
    assert found.settings == {'lidars': {'left': {'scale': unit}, 'right': {'scale': unit}}}


@pytest.mark.parametrize('unit', [1.0, 0.9, 0.6, 0.35, 0.5, 2.0, 1.0 / 0.3048])
def test_ways_that_differ_otherwise_are_no_unit(unit):
    assert unit_finding(['left'], ratios(unit), {}) is None


def test_fixes_that_scatter_or_hardly_move_tell_nothing():
    assert unit_finding(['left'], ratios(0.3048, noise=3.0), {}) is None
    assert unit_finding(['left'], ratios(0.3048, step=0.1), {}) is None
    scattered = np.array([1.0, 3.3, 3.3, 8.0, 3.2, 0.5])
    assert unit_finding(['left'], scattered, {}) is None


def test_a_scale_that_is_in_force_is_part_of_the_new_one():
    found = unit_finding(['left'], ratios(0.3048), {'left': 0.5})
    assert found is not None
    assert found.settings == {'lidars': {'left': {'scale': 0.1524}}}
