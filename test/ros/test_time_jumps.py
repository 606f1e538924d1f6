"""Stamps that go back: jumps of the clock, and what is none."""

import numpy as np
import pytest

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


def steady(seconds, start=100 * SECOND):
    """Samples at 100 Hz, scans of two LiDARs at 10 Hz."""
    made = [imu(start + i * SECOND // 100) for i in range(100 * seconds)]
    for sensor, phase in (('left', 3), ('right', 55)):
        step = SECOND // 10
        made += [scan(start + phase * 10**6 + i * step, sensor) for i in range(10 * seconds)]
    return sorted(made, key=lambda item: item.stamp)


@pytest.mark.parametrize('ahead', [0.5, 3.0, 60.0, 1e8])
@pytest.mark.parametrize('place', [0, 1, 50, 200])
def test_one_stamp_ahead_costs_no_map_and_blocks_nobody(ahead, place):
    drive = steady(5)
    stray = scan(drive[place].stamp + round(ahead * SECOND), 'left')
    jumps = JumpFilter(TimeJumpSettings())
    steps = feed(jumps, [*drive[:place], stray, *drive[place:]])
    assert jumps.jumps == 0
    passed = [item for step in steps for item in step.measurements]
    assert len([item for item in passed if item is not stray]) >= len(drive) - 2


def test_hostile_stamps_that_go_back_anywhere_are_no_jump():
    rng = np.random.default_rng(4)
    jumps = JumpFilter(TimeJumpSettings())
    sent = []
    for item in steady(5, start=10**9 * SECOND):
        sent.append(item)
        for _ in range(2):  # more than the drive's own
            back = int(10 ** rng.uniform(0.5, 8.0) * SECOND)
            sent.append(scan(item.stamp - back, str(rng.choice(['left', 'gnss']))))
    feed(jumps, sent)
    assert jumps.jumps == 0


def test_drive_that_begins_again_is_a_jump_whoever_comes_first():
    for start in range(40):
        jumps = JumpFilter(TimeJumpSettings())
        feed(jumps, steady(5))
        again = steady(2, start=90 * SECOND)[start:]
        steps = feed(jumps, again)
        assert jumps.jumps == 1
        assert [item for step in steps for item in step.measurements] == again


def test_pause_of_the_recording_is_passed_and_going_back_behind_it_is_a_jump():
    jumps = JumpFilter(TimeJumpSettings())
    feed(jumps, steady(2))
    late = steady(2, start=200 * SECOND)
    assert [item for step in feed(jumps, late) for item in step.measurements] == late
    feed(jumps, steady(1, start=100 * SECOND))
    assert jumps.jumps == 1
