"""Sensors of which nothing came into the map."""

from dataclasses import replace

from incremental_mapper.checks.finding import Severity
from incremental_mapper.checks.sensors import SensorUse, sensor_findings

LEFT = SensorUse('left', 'lidar', 50, 50)
IMU = SensorUse('imu', 'imu', 500, 40)
GNSS = SensorUse('gnss', 'gnss', 5, 5)


def rules(*sensors):
    return {(item.rule, item.sensor): item for item in sensor_findings(sensors, 60.0)}


def test_sensors_that_are_used():
    assert rules(LEFT, IMU, GNSS) == {}


def test_no_scan_at_all_is_an_error():
    lost = replace(LEFT, used=0, dropped={'bad_layout': 50})
    found = rules(lost, IMU)['no_scan_used', '']
    assert found.severity is Severity.ERROR
    assert 'left: 50 bad_layout' in found.text


def test_one_lidar_of_two_that_is_lost_is_a_warning_with_reasons():
    right = SensorUse('right', 'lidar', 50, 10, {'late': 30, 'no_finite_points': 10})
    found = rules(LEFT, right)['sensor_mostly_unused', 'right']
    assert found.severity is Severity.WARNING
    assert '40 of 50' in found.text and '30 late, 10 no_finite_points' in found.text
    assert set(rules(LEFT, replace(right, used=0))) == {('sensor_unused', 'right')}


def test_scans_of_windows_that_were_not_mapped_were_refused_by_nobody():
    found = rules(LEFT, SensorUse('right', 'lidar', 50, 3))['sensor_mostly_unused', 'right']
    assert '47 of 50' in found.text and 'none was refused' in found.text


def test_imu_and_fixes_that_came_and_are_in_nothing():
    found = rules(LEFT, replace(IMU, used=0), replace(GNSS, used=0, dropped={'low_status': 5}))
    assert set(found) == {('sensor_unused', 'imu'), ('sensor_unused', 'gnss')}
    assert 'low_status' in found['sensor_unused', 'gnss'].text


def test_what_the_settings_name_and_what_they_do_not():
    silent = replace(GNSS, offered=0, used=0)
    assert set(rules(LEFT, silent)) == {('sensor_silent', 'gnss')}
    assert rules(LEFT, replace(silent, configured=False)) == {}
    assert sensor_findings([LEFT, silent], 0.5) == []


def test_an_imu_that_is_switched_off_is_not_missed():
    assert rules(LEFT, replace(IMU, used=0, dropped={'switched_off': 500})) == {}


def test_a_few_lost_scans_are_no_matter():
    assert rules(replace(LEFT, used=45)) == {}


def test_imu_of_which_most_samples_were_left_out():
    rounded = SensorUse('imu', 'imu', 536, 40, {'duplicate_stamp': 480})
    found = rules(LEFT, rounded)['sensor_mostly_unused', 'imu']
    assert '480 of 536' in found.text and 'duplicate_stamp' in found.text
    few = SensorUse('imu', 'imu', 536, 40, {'duplicate_stamp': 20})
    assert rules(LEFT, few) == rules(LEFT, IMU) == {}


def test_a_sensor_of_which_much_came_late():
    """As after a simulator that begins anew: half of the drive is lost, and no more than half."""
    late = replace(LEFT, used=26, dropped={'late': 24})
    found = rules(late, replace(IMU, dropped={'late': 240}), GNSS)
    assert set(found) == {('came_late', 'left'), ('came_late', 'imu')}
    assert '24 of 50' in found['came_late', 'left'].text
    assert rules(replace(LEFT, dropped={'late': 2}), IMU, GNSS) == {}
