"""What waits for the worker: how much, in which order, and what is spent on it."""

import numpy as np

from incremental_mapper.config import QueueSettings
from incremental_mapper.mapping.load_shedding import NO_SHEDDING
from incremental_mapper.measurements import ImuSample, LidarScan
from incremental_mapper.ros.inbox import Command, Inbox, Order, View, shedding_at


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
