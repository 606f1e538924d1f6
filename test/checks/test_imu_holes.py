"""Holes between an IMU's samples."""

from incremental_mapper.checks.imu_holes import check_holes


def test_some_holes_are_no_matter():
    assert check_holes(2.0, 10.0, 1.0, 0.01, 0.1) is None
    assert check_holes(0.0, 0.0, 0.0, 0.0, 0.1) is None


def test_a_slow_imu_needs_another_setting():
    found = check_holes(6.0, 10.0, 0.12, 0.11, 0.1)
    assert found.settings == {'preintegration': {'max_gap': 0.14}}
    assert 'preintegration.max_gap: 0.14' in found.remedy
    assert not found.changes


def test_one_that_fell_silent_does_not():
    found = check_holes(8.0, 10.0, 8.0, 0.01, 0.1)
    assert (found.rule, found.settings) == ('imu_holes', {})
