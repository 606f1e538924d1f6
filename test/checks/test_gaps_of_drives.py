"""Sensors that were away for a considerable part of a drive."""

import numpy as np
import pytest

from incremental_mapper.checks.gaps import Presence, absence_findings, is_uneven, silences

NS = 1_000_000_000


def present(sensor, first=0.0, last=60.0, *holes):
    ends = [(round(a * NS), round(b * NS)) for a, b in holes]
    return Presence(sensor, round(first * NS), round(last * NS), tuple(ends))


WHOLE = [present('left'), present('right'), present('imu'), present('gnss')]


def with_(*changed):
    names = [item.sensor for item in changed]
    return [*(item for item in WHOLE if item.sensor not in names), *changed]


@pytest.mark.parametrize(
    'sensors',
    [
        WHOLE,
        with_(present('left', 1.5, 58.0), present('imu', 0.0, 59.0), present('gnss', 4.0, 55.0)),
        with_(present('gnss', 0.0, 60.0, (10.0, 35.0))),  # a tunnel
        with_(present('gnss', 20.0, 60.0)),
        with_(present('left', 0.0, 60.0, (20.0, 22.0))),
        [present('imu'), present('gnss')],
        [],
    ],
)
def test_what_is_usual_is_not_told(sensors):
    assert absence_findings(sensors) == []


@pytest.mark.parametrize(
    ('sensor', 'words'),
    [
        (present('left', 0.0, 30.0), ('30.0 of 60.0 s', 'from 30.0 s to the end', 'right alone')),
        (present('imu', 25.0, 60.0), ('25.0 of 60.0 s', 'from 0.0 s to 25.0 s')),
        (present('right', 0.0, 60.0, (5.0, 17.0)), ('12.0 of 60.0 s', 'from 5.0 s to 17.0 s')),
        (present('gnss', 40.0, 60.0), ('40.0 of 60.0 s have no fix',)),
        (present('left', 0, 60, (5, 10), (20, 25), (30, 35)), ('15.0 of 60.0', 'in 2 more holes')),
    ],
)
def test_a_considerable_part_is_told_with_when_and_how_long(sensor, words):
    (finding,) = absence_findings(with_(sensor))
    assert (finding.rule, finding.sensor) == ('sensor_absent', sensor.sensor)
    for word in words:
        assert word in finding.line()


def test_keyframes_are_silent_while_the_car_stands():
    keyframes = np.array([6.0, 0.7, 0.5, 0.4, *[0.3] * 5, *[0.2] * 12])
    assert is_uneven(keyframes)
    assert silences('left', np.cumsum(keyframes * NS).astype(np.int64)) == []
    rng = np.random.default_rng(1)
    assert not is_uneven(0.1 + 0.01 * rng.standard_normal(100))
