"""Whether two LiDARs on one vehicle read the same way."""

from dataclasses import replace

import numpy as np
import pytest

from incremental_mapper.checks.lidar_ways import way_findings
from incremental_mapper.checks.motions import Motions, Track

S = 1_000_000_000
NO_FIXES = Track(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros(0))


def lidar(sensor, scale=1.0, noise=0.03, shift=0):
    """Ten seconds at 5 m/s; single motions scatter, their sum hardly does."""
    random = np.random.default_rng(len(sensor))
    starts = (np.arange(100) * S // 10 + shift).astype(np.int64)
    jitter = noise * np.diff(random.normal(size=(101, 3)), axis=0)
    moved = scale * (np.array([0.5, 0.0, 0.0]) + jitter)
    return Motions(sensor, starts, starts + S // 10, moved)


def fixes(speed=5.0):
    stamps = np.arange(10, dtype=np.int64) * S
    places = np.stack([speed * stamps / S, 0.0 * stamps, 0.0 * stamps], axis=1)
    return Track(stamps, places, np.full(10, 0.03))


@pytest.mark.parametrize('scale', [1.0, 1.03, 0.97])
def test_sound_lidars_read_the_same_way(scale):
    pair = [lidar('left', scale), lidar('right', shift=S // 20)]
    assert way_findings(pair, fixes()) == []


@pytest.mark.parametrize(('scale', 'line'), [(1.1, '0.909'), (0.85, '1.17')])
def test_the_one_with_wrong_ranges_is_named_by_the_fixes(scale, line):
    pair = [lidar('left'), lidar('right', scale, shift=S // 20)]
    (found,) = way_findings(pair, fixes())
    assert (found.rule, found.sensor) == ('ways_differ', 'right')
    assert f'lidars.right.scale: {line}' in found.remedy


def test_without_fixes_both_are_named():
    (found,) = way_findings([lidar('left', 1.1), lidar('right')], NO_FIXES)
    assert found.sensor == 'left, right'
    assert 'lidars.left.scale: 0.9' in found.remedy and 'lidars.right.scale: 1.1' in found.remedy


def test_what_noise_can_do_says_nothing():
    pair = [lidar('left', 1.1, noise=0.4), lidar('right', noise=0.4)]
    assert way_findings(pair, NO_FIXES) == []


def test_a_car_that_stands_has_no_way():
    still = [
        replace(item, translations=0.1 * item.translations - [0.05, 0.0, 0.0])
        for item in (lidar('left', 1.1), lidar('right'))
    ]
    assert way_findings(still, NO_FIXES) == []
