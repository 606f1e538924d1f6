"""Two measurements of one sensor with one stamp: the one that can be used is used."""

from itertools import permutations

import numpy as np
import pytest

from incremental_mapper.config import WindowSettings
from incremental_mapper.mapping.same_stamp import prefer_usable
from incremental_mapper.mapping.window_buffer import WindowBuffer
from incremental_mapper.measurements import make_fix, make_scan
from incremental_mapper.settings import make_config

STAMP = 1_544_676_777_000_000_000
RNG = np.random.default_rng(5)
ROOM = RNG.uniform(-20.0, 20.0, (1000, 3))
USELESS = {
    'two points': ROOM[:2],
    'one point many times': np.tile(ROOM[:1], (5000, 1)),
    'points too far off': ROOM * 1e6,
    'points beyond single precision': ROOM * 1e30,
}


def scan(points):
    return make_scan(STAMP, 'left', points)


def fix(status=2, variance=0.01):
    return make_fix(STAMP, 'gnss', 36.0, 127.0, 50.0, status, variance * np.eye(3).ravel())


def kept(items, config):
    buffer = WindowBuffer(WindowSettings(), ['left'], better=prefer_usable(config))
    for item in items:
        buffer.push(item)
    (window,) = buffer.flush()
    (item,) = window.core
    assert buffer.drops == {(item.sensor, 'duplicate_stamp'): len(items) - 1}
    return item


@pytest.mark.parametrize('useless', USELESS.values(), ids=USELESS)
def test_a_cloud_that_cannot_be_used_displaces_none_that_can(useless):
    good, bad = scan(ROOM), scan(useless)
    for order in permutations([good, bad]):
        assert kept(order, make_config({})) is good


def test_a_cloud_of_a_few_points_more_does_not_displace_the_first():
    items = [scan(ROOM[:600]), scan(ROOM)]
    assert kept(items, make_config({})) is items[0]


@pytest.mark.parametrize('bad', [fix(variance=1e12), fix(status=0)])
def test_a_fix_that_is_not_used_displaces_none_that_is(bad):
    config, good = make_config({'fixes': {'min_status': 1}}), fix()
    for order in permutations([good, bad]):
        assert kept(order, config) is good


def test_of_two_fixes_that_can_be_used_the_first_stays():
    items = [fix(variance=0.04), fix(variance=0.01)]
    assert kept(items, make_config({})) is items[0]
