"""What waits for the worker: how much, in which order, and what is spent on it."""

import numpy as np
import pytest

from incremental_mapper.config import QueueSettings
from incremental_mapper.mapping.load_shedding import NO_SHEDDING
from incremental_mapper.measurements import ImuSample, LidarScan
from incremental_mapper.ros.inbox import (
    READ_AHEAD,
    Command,
    Inbox,
    Order,
    View,
    leaves_out,
    shedding_at,
)


def scan(stamp, sensor='left'):
    return LidarScan(stamp, sensor, np.ones((3, 3), dtype=np.float32))


def imu(stamp):
    return ImuSample(stamp, 'imu', np.zeros(3), np.zeros(3))


def test_load_is_shed_by_less_search_before_windows_are_merged():
    limits_at = [shedding_at(filling) for filling in np.linspace(0.0, 1.0, 101)]
    assert limits_at[0] is NO_SHEDDING and limits_at[19] is NO_SHEDDING
    assert limits_at[30].windows == 1 and limits_at[30].candidates < limits_at[21].candidates
    assert limits_at[60].windows == 2 and limits_at[90].windows == 3
    limits = [shedding.candidates for shedding in limits_at if shedding.candidates is not None]
    assert limits == sorted(limits, reverse=True) and limits[-1] > 0


def test_scans_that_stood_too_long_are_left_out_where_newer_ones_wait():
    assert not leaves_out(0.79, 1.0) and leaves_out(0.81, 1.0)
    assert leaves_out(1.7, 2.0) and not leaves_out(1.5, 2.0)
    assert not leaves_out(100.0, 0.0)


class Clock:
    """Seconds, as a test says."""

    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now


def overloaded(max_delay, cost, seconds=20.0):
    """Two LiDARs at 10 Hz, an IMU and fixes for a worker that needs ``cost`` s for a scan.

    Returns:
        The inbox, and how long (s) each scan that was mapped while others came had waited by then.
    """
    clock = Clock()
    inbox = Inbox(QueueSettings(max_delay=max_delay, core=1000), clock)
    due = [
        (0.1 * k + 0.01 * n, scan(100 * k + n, name))
        for k in range(round(10 * seconds))
        for n, name in enumerate(('left', 'right'))
    ]
    due += [(0.01 * k, imu(k)) for k in range(round(100 * seconds))]
    due.sort(key=lambda item: item[0])
    came = {id(item): at for at, item in due}
    waits, free = [], 0.0
    while due:
        while due and (due[0][0] <= free or inbox.waiting() == (0, 0)):
            clock.now, item = due.pop(0)
            inbox.put(item)
        free = max(free, clock.now)
        item, _ = inbox.take()
        if isinstance(item, LidarScan):
            free += cost
            waits.append(free - came[id(item)])
    return inbox, waits


def test_delay_is_bounded_while_the_worker_cannot_follow_and_what_is_left_out_is_counted():
    inbox, waits = overloaded(1.0, 0.125)
    assert max(waits) < 1.2
    lost = inbox.drops()
    assert set(lost) == {('left', 'overload'), ('right', 'overload')}
    assert sum(lost.values()) + len(waits) + inbox.waiting()[0] == 400
    # Not more than the worker has no time for.
    assert len(waits) > 0.95 * 20.0 / 0.125
    assert max(overloaded(0.0, 0.125)[1]) > 10.0


def test_who_follows_loses_nothing():
    inbox, waits = overloaded(1.0, 0.045)
    assert not inbox.drops() and len(waits) > 398 and max(waits) < 0.15
    assert inbox.shedding() is NO_SHEDDING


def test_less_is_spent_while_measurements_wait_and_all_at_once_is_no_delay():
    clock = Clock()
    inbox = Inbox(QueueSettings(max_delay=1.0), clock)
    for number in range(20):
        inbox.put(scan(number))
    clock.now = 5.0
    assert inbox.delay() == 0.0 and inbox.shedding() is NO_SHEDDING
    clock.now = 0.6
    inbox.put(scan(20))
    assert inbox.delay() == pytest.approx(0.6)
    assert inbox.shedding().windows == 2 and inbox.shedding().read_ahead == READ_AHEAD


def test_a_batch_that_waited_in_the_middleware_is_as_old_as_it_came():
    clock = Clock()
    inbox = Inbox(QueueSettings(max_delay=1.0), clock)
    for number in range(31):
        clock.now = 0.1 * number
        inbox.put(scan(number))
    clock.now = 3.05
    inbox.put(scan(31))
    # A clock that is set back makes nothing older or newer.
    clock.now = -100.0
    inbox.put(scan(32))
    item, _ = inbox.take()
    assert item.stamp == 23 and inbox.drops() == {('left', 'overload'): 23}


def test_full_inbox_drops_the_oldest_of_the_kind_and_counts_it():
    inbox = Inbox(QueueSettings(core=10, imu=100))
    inbox.put(imu(0))
    inbox.put(Command(Order.FLUSH, 1))
    for stamp in range(1, 13):
        inbox.put(scan(stamp))
    assert inbox.waiting() == (10, 1)
    assert inbox.nbytes() == 10 * scan(0).points.nbytes
    assert inbox.drops() == {('left', 'queue_full'): 2}
    inbox.request(View.MAP)
    taken = []
    while inbox.waiting() != (0, 0):
        item, views = inbox.take()
        taken.append(item)
        assert views == ({View.MAP} if len(taken) == 1 else set())
    assert isinstance(taken[0], ImuSample) and isinstance(taken[1], Command)
    assert [item.stamp for item in taken[2:]] == list(range(3, 13))
