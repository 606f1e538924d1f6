"""Stretches of matches that a map does not follow."""

import numpy as np
import pytest

from incremental_mapper.checks.bends import Stretches, bend_findings
from incremental_mapper.checks.finding import Severity
from incremental_mapper.measurements import NANOSECONDS


def stretches(metres, deviations):
    count = len(metres)
    stamps = (np.arange(count) + 1) * 2 * NANOSECONDS
    return Stretches('left', stamps, np.array(metres), np.array(deviations))


def test_a_map_within_the_noise_of_its_matches_is_not_bent():
    # As in a field without structure: metres, but no more than the matches say.
    assert bend_findings([stretches([0.9] * 6, [1.2] * 6)], 0) == []


def test_many_deviations_of_few_centimetres_are_no_bend():
    assert bend_findings([stretches([0.05] * 6, [8.0] * 6)], 0) == []


@pytest.mark.parametrize('metres', [1.0, 0.4])
def test_a_map_that_is_bent_all_along(metres):
    (found,) = bend_findings([stretches([metres] * 6, [2.5] * 6)], 0)
    assert (found.rule, found.sensor, found.severity) == ('map_bent', 'left', Severity.ERROR)
    assert 'all along' in found.text and f'{metres:.1f} m' in found.text


def test_a_single_bend_is_told_with_its_place():
    metres, deviations = [0.05] * 8, [0.4] * 8
    metres[4], deviations[4] = 0.6, 6.0
    (found,) = bend_findings([stretches(metres, deviations)], 0)
    # All that is behind it is turned and moved: a map that is known to be wrong is no success.
    assert found.severity is Severity.ERROR
    assert 'at 10.0 s' in found.text and '0.6 m' in found.text


def test_a_match_that_another_lidar_contradicts_is_no_bend_of_the_map():
    metres, deviations = [0.05] * 8, [0.4] * 8
    other = Stretches('right', np.arange(1, 9) * 2 * NANOSECONDS, np.array(metres), np.full(8, 0.4))
    metres[4], deviations[4] = 0.6, 6.0
    assert bend_findings([stretches(metres, deviations), other], 0) == []


def test_lidars_without_stretches_say_nothing():
    assert bend_findings([stretches([], [])], 0) == []
