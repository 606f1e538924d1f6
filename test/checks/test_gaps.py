"""Holes in a recording."""

import numpy as np

from incremental_mapper.checks.finding import Severity
from incremental_mapper.checks.gaps import Presence, absence_findings, silences
from incremental_mapper.measurements import NANOSECONDS


def every(period, count, start=0.0):
    return ((start + np.arange(count) * period) * NANOSECONDS).astype(np.int64)


def test_a_steady_sensor_is_not_remarked():
    assert silences('left', every(0.1, 100)) == []


def test_keyframes_are_no_holes():
    stamps = np.cumsum([6.0, 0.4, 1.9, 0.6, 2.0, 0.4, 0.8, 0.4, 0.5, 0.6, 0.4]) * NANOSECONDS
    assert silences('left', stamps.astype(np.int64)) == []


def test_holes_are_counted_and_the_longest_is_placed():
    stamps = np.concatenate([every(0.1, 50), every(0.1, 50, 7.0), every(0.1, 50, 15.0)])
    (found,) = silences('left', stamps)
    assert found.severity is Severity.WARNING
    assert found.rule == 'silent_sensor'
    assert found.text.startswith('nothing for 3.1 s, 11.9 s after its first message')
    assert '1 more such holes, 5.2 s together' in found.text


def test_lost_samples_of_an_imu_are_no_hole():
    stamps = np.delete(every(0.01, 1000), np.arange(500, 540))
    assert silences('imu', stamps) == []


def test_time_that_leaps_by_years_is_said_and_nothing_that_follows_from_it():
    """A computer that learned the time in the middle of a recording."""
    before, after = 60 * 10**9, 50 * 365 * 86_400 * 10**9
    both = [
        Presence(sensor, 50 * 10**9, after + 10 * 10**9, ((before, after),))
        for sensor in ('left', 'right', 'imu')
    ]
    (found,) = absence_findings(both)
    assert found.rule == 'clock_set' and found.severity is Severity.ERROR
    assert '18250 days' in found.text
