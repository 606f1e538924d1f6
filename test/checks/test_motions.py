"""Whether the motions of LiDARs are those of one vehicle."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from incremental_mapper.checks.finding import Severity
from incremental_mapper.checks.motions import (
    APART,
    Motions,
    Track,
    angle,
    distance_findings,
    distance_ratios,
    motion_findings,
)

S = 1_000_000_000


def motions(sensor='left', turn=None, speed=5.0, seconds=8.0, noise=0.02, shift=0, scale=1.0):
    """A LiDAR at 10 Hz on a car that drives forward; ``turn`` is the error of its extrinsics."""
    random = np.random.default_rng(len(sensor))
    count = int(10 * seconds)
    starts = (np.arange(count) * S // 10 + shift).astype(np.int64)
    moved = np.tile([scale * speed / 10.0, 0.0, 0.0], (count, 1)) + random.normal(
        0.0, noise, (count, 3)
    )
    if turn is not None:
        moved = Rotation.from_euler(*turn, degrees=True).apply(moved)
    return Motions(sensor, starts, starts + S // 10, moved)


def test_two_sound_lidars_agree():
    assert motion_findings([motions('left'), motions('right', shift=S // 20)]) == []


@pytest.mark.parametrize('turn', [('z', 180), ('z', 90), ('z', 10), ('y', 90), ('y', -10)])
def test_the_one_that_is_turned_is_named(turn):
    (found,) = motion_findings([motions('left', turn), motions('right', shift=S // 20)])
    assert (found.rule, found.sensor) == ('lidars_disagree', 'left')
    wrong = abs(turn[1]) > APART
    assert found.severity is (Severity.ERROR if wrong else Severity.WARNING)
    assert abs(int(re.search(r'by (\d+) degrees', found.text)[1]) - abs(turn[1])) <= 1
    assert 'lidars.left.T_base_sensor' in found.remedy and 'lidars.right' not in found.remedy


def test_mirrored_extrinsics_name_both():
    (found,) = motion_findings([motions('left', ('z', 88)), motions('right', ('z', -88))])
    assert found.sensor == 'left, right'
    assert 'lidars.left' in found.remedy and 'lidars.right' in found.remedy


def test_a_car_that_stands_has_no_direction():
    still = [motions('left', speed=0.0), motions('right', ('z', 90), speed=0.0)]
    assert motion_findings(still) == []


def test_noise_is_no_disagreement():
    """As kiss_icp on tilted LiDARs: little of the motion, and that in all directions."""
    poor = motions('left', ('z', 8), noise=0.3, scale=0.5)
    assert motion_findings([poor, motions('right')]) == []


@pytest.mark.parametrize(
    ('turn', 'word'),
    [(('z', 90), 'to the left'), (('z', 180), 'backward'), (('y', 90), 'down'), (('y', -90), 'up')],
)
def test_a_vehicle_that_does_not_drive_forward_is_told_of(turn, word):
    (found,) = motion_findings([motions('top', turn)])
    assert (found.rule, found.severity) == ('moves_sideways', Severity.WARNING)
    assert word in found.text


def test_a_holonomic_robot_that_goes_everywhere_is_not():
    robot = motions('top')
    turns = Rotation.from_euler('z', np.linspace(0, 720, len(robot.starts))[:, None], degrees=True)
    moved = turns.apply(robot.translations)
    assert motion_findings([Motions('top', robot.starts, robot.ends, moved)]) == []


def test_neither_is_a_way_of_some_metres():
    assert motion_findings([motions('top', ('z', 90), seconds=2.0)]) == []


def track(seconds=6, scale=1.0, sigma=0.05, speed=5.0):
    stamps = np.arange(seconds + 1, dtype=np.int64) * S
    east = scale * speed * np.arange(seconds + 1.0)
    positions = np.stack([np.zeros(seconds + 1), east, np.zeros(seconds + 1)], axis=1)
    return Track(stamps, positions, np.full(seconds + 1, sigma))


def test_ways_by_lidar_and_fixes_are_compared():
    assert distance_findings([motions()], track(8)) == []
    (short,) = distance_findings([motions(scale=0.3)], track(8))
    assert (short.rule, short.sensor) == ('distance_disagrees', 'left')
    assert '0.3' in short.text
    (long,) = distance_findings([motions(scale=2.5)], track(8))
    assert long.rule == 'distance_disagrees'


@pytest.mark.parametrize(('scale', 'told'), [(0.88, True), (1.12, True), (0.95, False)])
def test_ways_that_differ_by_a_tenth_all_along_are_told(scale, told):
    found = distance_findings([motions(scale=scale, seconds=20.0)], track(20))
    assert [item.rule for item in found] == ['distance_disagrees'] * told


def test_a_stop_in_which_nothing_is_matched_takes_no_stretch_away_but_its_own():
    driven = motions(scale=0.5, seconds=20.0)
    keep = (np.arange(200) < 80) | (np.arange(200) > 100)
    stopped = Motions('left', driven.starts[keep], driven.ends[keep], driven.translations[keep])
    assert [item.rule for item in distance_findings([stopped], track(20))]
    assert distance_ratios(stopped, track(20)) == pytest.approx(0.5, abs=0.02)


def test_a_tenth_that_is_chance_is_not():
    uneven = motions(scale=0.88, seconds=20.0)
    wave = 1.0 + 0.3 * np.sin(2.0 * np.arange(len(uneven.starts)) / len(uneven.starts) * np.pi)
    poor = Motions('left', uneven.starts, uneven.ends, uneven.translations * wave[:, None])
    assert distance_findings([poor], track(20)) == []


def test_fixes_that_are_as_uncertain_as_the_way_is_long_tell_nothing():
    assert distance_findings([motions(scale=0.3)], track(sigma=3.0)) == []


@given(
    st.lists(st.floats(-1e3, 1e3), min_size=3, max_size=3),
    st.lists(st.floats(-1e3, 1e3), min_size=3, max_size=3),
)
def test_an_angle_is_one_for_all_vectors(one, other):
    degrees = angle(np.array(one), np.array(other))
    assert 0.0 <= degrees <= 180.0
    assert degrees == pytest.approx(angle(np.array(other), np.array(one)))
