"""Live clocks: when they are looked at, and what is kept of them."""

import numpy as np
import pytest

from incremental_mapper.checks.finding import Severity
from incremental_mapper.ros.clock_log import FIRST_LOOK, ClockLog

NS = 1_000_000_000
NOW = 1_700_000_000 * NS
RATES = {'left': 10, 'imu': 100, 'gnss': 1}


def feed(log, seconds, ahead=None, start=0.0, receiver=0.0, offsets=None):
    """Messages of all sensors in turn; what was found, with the seconds at which it was."""
    found = []
    events = sorted(
        (start + i / rate, name) for name, rate in RATES.items() for i in range(seconds * rate)
    )
    for at, name in events:
        stamp = NOW + round((at + (ahead or {}).get(name, 0.0)) * NS)
        log.take(name, stamp, NOW + round((at + receiver) * NS) + 3_000_000)
        found += [(at - start, item) for item in log.findings(offsets or {})]
    return found


@pytest.mark.parametrize('receiver', [0.0, 1e7])
def test_another_clock_is_told_within_seconds_and_once(receiver):
    log = ClockLog()
    ((at, finding),) = feed(log, 30, {'left': 37.0}, receiver=receiver)
    assert FIRST_LOOK <= at < FIRST_LOOK + 0.1
    assert finding.severity is Severity.MENDED
    assert finding.settings == {'lidars': {'left': {'time_offset': -37.0}}}
    log.restart()
    assert feed(log, 30, {'left': 37.0}, start=30.0, offsets={'left': -37 * NS}) == []


def test_an_offset_of_the_user_is_told_of_only():
    log = ClockLog(('left',))
    found = feed(log, 5, {'left': 37.0}, offsets={'left': NS})
    assert [item.severity for _, item in found] == [Severity.WARNING]


def test_sound_clocks_are_not_accused_however_long():
    assert feed(ClockLog(), 300) == []


def test_what_is_kept_does_not_grow_with_the_drive():
    log = ClockLog()
    for index in range(100_000):
        log.take('imu', NOW + index, NOW + index)
    kept = log._pairs['imu']
    assert len(kept) <= 600
    steps = np.diff([received for received, _ in kept])
    assert steps.min() == steps.max()
