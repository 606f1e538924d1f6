"""Scans that a driver repeats are left out and counted."""

from dataclasses import replace

import numpy as np

from incremental_mapper.config import LidarSensor
from incremental_mapper.mapping.scan_intake import ScanIntake
from incremental_mapper.measurements import Remark, make_scan

POINTS = np.random.default_rng(0).normal(scale=10.0, size=(500, 3))


def scan(number, points, sensor='left'):
    return make_scan(10**18 + number * 10**8, sensor, points)


def test_a_cloud_that_comes_again_is_left_out_and_counted():
    intake = ScanIntake()
    moved = POINTS + 0.01
    taken = [
        intake.take(scan(number, points)) for number, points in enumerate([POINTS] * 3 + [moved])
    ]
    assert [one is not None for one in taken] == [True, False, False, True]
    assert intake.drops == {('left', 'repeated_cloud'): 2}


def test_one_other_point_makes_another_cloud():
    intake = ScanIntake()
    other = POINTS.copy()
    other[100, 2] += 0.002
    assert intake.take(scan(0, POINTS)) and intake.take(scan(1, other))
    assert intake.take(scan(2, POINTS, 'right'))
    assert not intake.drops


def test_the_same_message_twice_is_for_the_window_buffer():
    intake = ScanIntake()
    assert intake.take(scan(0, POINTS)) and intake.take(scan(0, POINTS))


def test_points_are_scaled_to_metres_as_the_settings_say():
    feet = LidarSensor(scale=0.3048)
    intake = ScanIntake({'left': feet, 'right': LidarSensor()})
    taken = intake.take(scan(0, POINTS / 0.3048))
    assert taken is not None
    np.testing.assert_allclose(taken.points, POINTS, rtol=1e-5)
    untouched = scan(0, POINTS, 'right')
    assert intake.take(untouched) is untouched
    assert intake.take(scan(1, POINTS / 0.3048)) is None  # the copy is known by what was sent


def guessed(number):
    return replace(
        scan(number, POINTS + 0.1 * (number + 1)), remarks=(Remark('field_names', 'X, Y, Z'),)
    )


def test_a_cloud_of_another_layout_among_those_of_a_driver_is_left_out():
    intake = ScanIntake()
    taken = [intake.take(one) for one in (guessed(0), scan(1, POINTS), guessed(2), guessed(12))]
    # A driver that was exchanged goes on by itself.
    assert [one is not None for one in taken] == [True, True, False, True]
    assert intake.drops == {('left', 'other_layout'): 1}
