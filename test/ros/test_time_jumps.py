"""Stamps that go back: jumps of the clock, and what is none."""

import numpy as np

from incremental_mapper.config import Config, TimeJumpPolicy, TimeJumpSettings
from incremental_mapper.measurements import ImuSample, LidarScan
from incremental_mapper.ros.time_jumps import JumpFilter

SECOND = 1_000_000_000


def scan(stamp, sensor='left'):
    return LidarScan(stamp, sensor, np.ones((3, 3), dtype=np.float32))


def imu(stamp):
    return ImuSample(stamp, 'imu', np.zeros(3), np.zeros(3))


def feed(jumps, measurements):
    return [jumps.check(item) for item in measurements]


def test_stray_stamps_are_no_jump():
    jumps = JumpFilter(TimeJumpSettings())
    good = [imu(100 * SECOND + i * 10_000_000) for i in range(30)]
    stray = [imu(3 * SECOND + i) for i in range(6)]
    mixed = [item for pair in zip(good, stray * 5, strict=True) for item in pair]
    passed = [item for step in feed(jumps, mixed) for item in step.measurements]
    assert passed == good and jumps.jumps == 0
    assert jumps.drops == {('imu', 'stray_stamp'): 29}


def test_sensor_that_is_late_as_a_whole_is_no_jump():
    jumps = JumpFilter(TimeJumpSettings())
    late = [scan(50 * SECOND + i * SECOND // 10) for i in range(20)]
    on_time = [imu(100 * SECOND + i * SECOND // 10) for i in range(20)]
    steps = feed(jumps, [item for pair in zip(on_time, late, strict=True) for item in pair])
    assert jumps.jumps == 0 and all(len(step.measurements) == 1 for step in steps)


def test_jump_passes_its_witnesses_on_and_leaves_the_rest_of_the_old_run_out():
    jumps = JumpFilter(TimeJumpSettings())
    feed(jumps, [imu(100 * SECOND + i) for i in range(5)])
    feed(jumps, [scan(100 * SECOND), scan(100 * SECOND, 'right')])
    again = [scan(SECOND), *(imu(SECOND + i) for i in range(4))]
    steps = feed(jumps, again)
    assert [step.jumped for step in steps] == [False] * 4 + [True]
    assert list(steps[-1].measurements) == again
    assert feed(jumps, [scan(100 * SECOND + 7, 'right')])[0].measurements == ()
    assert jumps.drops == {('right', 'before_jump'): 1}
    fresh = scan(SECOND + 9, 'right')
    assert feed(jumps, [fresh])[0].measurements == (fresh,)


def test_jump_of_the_clock_needs_one_witness_only():
    jumps = JumpFilter(TimeJumpSettings())
    feed(jumps, [imu(100 * SECOND)])
    jumps.clock_jumped()
    assert jumps.check(imu(SECOND)).jumped


def test_ignored_jump_is_counted():
    jumps = JumpFilter(TimeJumpSettings(policy=TimeJumpPolicy.IGNORE))
    feed(jumps, [imu(100 * SECOND)])
    steps = feed(jumps, [imu(SECOND + i) for i in range(9)])
    assert not any(step.measurements or step.jumped for step in steps)
    assert jumps.drops == {('imu', 'time_jump'): 9}


def test_jump_begins_a_new_map_unless_the_settings_say_otherwise():
    assert Config().time_jump.policy is TimeJumpPolicy.RESET


def test_stamp_is_suspect_from_just_beyond_the_threshold():
    settings = TimeJumpSettings(threshold=0.5)
    newest = 100 * SECOND
    for behind, passes in ((SECOND // 2, True), (SECOND // 2 + 1, False)):
        jumps = JumpFilter(settings)
        feed(jumps, [imu(newest)])
        assert (len(jumps.check(imu(newest - behind)).measurements) == 1) == passes
        # The newest stamp stays what it was, however late others come.
        assert not jumps.check(imu(newest - SECOND // 2 - 1)).measurements
