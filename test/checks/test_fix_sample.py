"""Fixes by themselves: far ones, and those that are not used."""

import numpy as np

from incremental_mapper.checks.fix_sample import far_fixes, unusable_fixes
from incremental_mapper.measurements import NANOSECONDS


def drive(count=20, speed=15.0):
    stamps = np.arange(count, dtype=np.int64) * NANOSECONDS
    places = np.stack([36.5 + np.arange(count) * speed / 111_000.0, np.full(count, 127.0)], axis=1)
    return stamps, places


def test_a_drive_is_near_itself():
    assert far_fixes('gnss', *drive()) == []
    assert far_fixes('gnss', *drive(600, 40.0)) == []


def test_a_fix_of_another_city_is_far():
    stamps, places = drive()
    places[0] = (37.5, 127.0)
    (found,) = far_fixes('gnss', stamps, places)
    assert found.rule == 'far_fix'
    assert found.text.startswith('1 of 20 fixes') and '111.0 km' in found.text


def test_most_fixes_unused_names_the_setting():
    assert unusable_fixes('gnss', 10, {'too_uncertain': 5}, 12.0) == []
    (found,) = unusable_fixes('gnss', 10, {'too_uncertain': 8}, 12.0)
    assert found.remedy.startswith('fixes.max_sigma: 24')
    (found,) = unusable_fixes('gnss', 10, {'low_status': 9}, 0.0)
    assert 'fixes.min_status: 0' in found.remedy
    assert unusable_fixes('gnss', 0, {}, 0.0) == []
