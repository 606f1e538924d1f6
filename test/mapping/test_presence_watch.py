"""Presence of sensors as the windows show it."""

import numpy as np

from incremental_mapper.checks.finding import Severity
from incremental_mapper.mapping.presence_watch import PresenceWatch
from incremental_mapper.mapping.window import Window
from incremental_mapper.measurements import ImuSample, LidarScan

NS = 1_000_000_000
START = 1_544_580_000 * NS


def windows(seconds, scans, samples):
    """Windows of 0.5 s; ``scans`` by LiDAR and ``samples`` tell by the time whether it is there."""
    for start in range(0, round(seconds * 10), 5):
        times = [i / 10 for i in range(start, start + 5)]
        core = [
            LidarScan(START + round(t * NS), name, np.ones((1, 3), np.float32))
            for t in times
            for name, there in scans.items()
            if there(t)
        ]
        imu = [
            ImuSample(START + round((t + i / 100) * NS), 'imu', np.zeros(3), np.zeros(3))
            for t in times
            for i in range(10)
            if samples(t)
        ]
        begin = START + round(times[0] * NS)
        yield Window(begin, begin + NS // 2, tuple(core), tuple(imu))


def watched(*args):
    watch = PresenceWatch()
    for window in windows(*args):
        watch.window(window)
    return watch


def always(t):
    return True


def test_sensors_that_are_there_are_not_told():
    watch = watched(70.0, {'left': always, 'right': always}, always)
    assert watch.findings() == watch.so_far() == []


def test_a_lidar_that_dies_is_told():
    watch = watched(5.0, {'left': always, 'right': lambda t: t < 2.5}, always)
    (finding,) = watch.findings()
    assert (finding.rule, finding.sensor) == ('sensor_absent', 'right')
    assert 'to the end' in finding.text
    assert watch.so_far() == []  # a drive that goes on is young


def test_a_hole_of_the_imu_is_told():
    watch = watched(80.0, {'left': always}, lambda t: not 30.0 <= t < 45.0)
    assert [f.text for f in watch.findings()] == [f.text for f in watch.so_far()]
    (finding,) = watch.findings()
    assert 'from 30.0 s to 45.0 s' in finding.text


def test_sensors_without_a_common_time_are_an_error():
    watch = watched(20.0, {'left': lambda t: t < 8.0}, lambda t: t > 12.0)
    (finding,) = watch.findings()
    assert (finding.rule, finding.severity) == ('no_common_time', Severity.ERROR)
