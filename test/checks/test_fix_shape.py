"""The shape of the fixes' track beside that of odometry."""

from dataclasses import replace

import numpy as np
import pytest

from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.checks.fix_shape import Shape, shape_finding, without_consequences

METRE = np.degrees(1.0 / 6_371_000.0)


def bend(latitude=48.1, longitude=11.6, count=30, straight=False):
    """Fixes of a drive around a bend, and odometry that begins with another yaw."""
    angles = np.linspace(0.0, 0.0 if straight else 1.5, count)
    steps = 4.0 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    enu = np.cumsum(steps, axis=0)
    local = enu @ np.array([[0.6, -0.8], [0.8, 0.6]]) + [3.0, -2.0]
    noise = np.random.default_rng(0).normal(scale=0.05, size=enu.shape)
    east, north = (enu + noise).T
    degrees = np.stack(
        [latitude + METRE * north, longitude + METRE * east / np.cos(np.radians(latitude))], axis=1
    )
    return Shape(degrees, local, 0.05)


@pytest.mark.parametrize('place', [(48.1, 11.6), (-33.0, 151.0), (60.0, -20.0), (0.5, 0.5)])
def test_a_sound_track_has_the_shape_of_odometry(place):
    assert shape_finding('gnss', bend(*place)) is None


def test_exchanged_degrees_are_known_by_the_bend():
    shape = bend()
    found = shape_finding('gnss', replace(shape, degrees=shape.degrees[:, ::-1]))
    assert found is not None and found.severity is Severity.MENDED
    assert (found.rule, found.settings) == ('exchanged_degrees', {'fixes': {'exchanged': True}})


def test_a_lost_sign_is_known_by_the_bend():
    shape = bend(52.0, -1.5)
    found = shape_finding('gnss', replace(shape, degrees=shape.degrees * [1.0, -1.0]))
    assert found is not None
    assert (found.rule, found.settings) == ('lost_sign', {'fixes': {'mirrored': True}})


def test_gons_are_known_by_a_track_of_another_size_each_way():
    shape = bend()
    found = shape_finding('gnss', replace(shape, degrees=shape.degrees / 0.9))
    assert found is not None and found.severity is Severity.ERROR
    assert found.rule == 'track_stretched' and 'gons' in found.text
    assert '11% too long from south to north' in found.text


def test_a_track_that_is_stretched_is_told_without_a_unit():
    shape = bend()
    stretched = shape.degrees[0] + [1.0, 0.8] * (shape.degrees - shape.degrees[0])
    found = shape_finding('gnss', replace(shape, degrees=stretched))
    assert found is not None and found.rule == 'track_stretched'
    assert 'gons' not in found.text and '20% too short from west to east' in found.text


def test_on_a_straight_road_nobody_can_tell():
    shape = bend(straight=True)
    for degrees in (shape.degrees[:, ::-1], shape.degrees * [1.0, -1.0]):
        assert shape_finding('gnss', replace(shape, degrees=degrees)) is None


def test_fixes_that_are_wrong_otherwise_are_not_blamed_on_it():
    shape = bend()
    jump = shape.degrees.copy()
    jump[10:14] += 30.0 * METRE
    drift = shape.degrees + METRE * np.arange(30)[:, None] * [1.0, 0.3]
    for degrees in (jump, drift, shape.degrees[0] + 0.1 * (shape.degrees - shape.degrees[0])):
        assert shape_finding('gnss', replace(shape, degrees=degrees)) is None


def test_what_followed_from_a_misshapen_track_is_taken_back():
    scatter, other, shape = (
        Finding(rule, Severity.MENDED, 'gnss', '')
        for rule in ('optimistic_covariance', 'imu_clock', 'lost_sign')
    )
    assert without_consequences([scatter, other], [shape]) == [other]
    assert without_consequences([scatter], [other]) == [scatter]


def test_a_gyroscope_that_is_loud_in_the_wrong_unit_is_not_loud():
    loud, unit = (Finding(rule, Severity.MENDED, 'imu', '') for rule in ('imu_noise', 'imu_in_deg'))
    assert without_consequences([loud], [unit]) == []
    assert without_consequences([loud], [loud]) == [loud]


def with_holes(shape, each):
    """The track as odometry has it that loses a tenth of the way north with every few fixes."""
    begins = np.arange(len(shape.local)) // each * each
    north = shape.degrees[begins, 0] - shape.degrees[0, 0]
    back = np.array([[0.6, -0.8], [0.8, 0.6]])  # as odometry's axes lie in bend()
    lost = 0.1 / METRE * np.stack([np.zeros(len(north)), north], axis=1) @ back
    return replace(shape, local=shape.local - lost, stretches=begins // each)


def test_holes_in_odometry_stretch_no_track_of_fixes():
    shape = with_holes(bend(count=200), 12)
    found = shape_finding('gnss', replace(shape, stretches=None))
    assert found is not None and found.rule == 'track_stretched'  # as if it were one stretch
    assert shape_finding('gnss', shape) is None


def test_a_stretch_without_a_hole_tells_a_stretched_track():
    shape = bend()
    stretched = shape.degrees[0] + [1.0, 0.8] * (shape.degrees - shape.degrees[0])
    stretches = np.repeat([0, 1], [4, 26])
    found = shape_finding('gnss', replace(shape, degrees=stretched, stretches=stretches))
    assert found is not None and found.rule == 'track_stretched'
    short = np.repeat([0, 1, 2, 3], [8, 8, 8, 6])
    assert shape_finding('gnss', replace(shape, degrees=stretched, stretches=short)) is None
