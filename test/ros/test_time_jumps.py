"""Stamps that jump: of all sensors, of one, stray ones, and hostile orders of them."""

import numpy as np
import pytest

from incremental_mapper.config import Config, TimeJumpPolicy, TimeJumpSettings
from incremental_mapper.measurements import FixStatus, GnssFix, ImuSample, LidarScan
from incremental_mapper.ros.clock_steps import MOST_REALIGNED, step_findings
from incremental_mapper.ros.time_jumps import JumpFilter

SECOND = 1_000_000_000
HOUR = 3600 * SECOND
START = 100 * SECOND
POINT = np.ones((1, 3), dtype=np.float32)
RATES = {'left': 10, 'right': 10, 'imu': 100, 'gnss': 1}
LAGS = {'left': 0.12, 'right': 0.12, 'imu': 0.0, 'gnss': 0.05}
YEAR = 365 * 24 * HOUR


def made(sensor, stamp):
    if sensor == 'imu':
        return ImuSample(stamp, sensor, np.zeros(3), np.zeros(3))
    if sensor == 'gnss':
        return GnssFix(stamp, sensor, 36.0, 127.0, 50.0, FixStatus.GBAS)
    return LidarScan(stamp, sensor, POINT)


def drive(seconds, start=START, sensors=tuple(RATES), change=lambda sensor, at: 0, lags=LAGS):
    """Measurements in the order of arrival; ``change`` moves stamps (ns) by sensor and second."""
    events = []
    for number, sensor in enumerate(sensors):
        for i in range(round(seconds * RATES[sensor])):
            at = (i + 0.11 + 0.2 * number) / RATES[sensor]
            stamp = start + round(at * SECOND) + round(change(sensor, at))
            events.append((at + lags[sensor], made(sensor, stamp)))
    return [item for _, item in sorted(events, key=lambda event: event[0])]


def feed(jumps, measurements):
    """All that passes, and whether a new map begins before it; what is left decides itself."""
    passed, begun = [], []
    for item in measurements:
        step = jumps.check(item)
        if step.jumped:
            begun.append(len(passed))
        passed += step.measurements
    return [*passed, *jumps.settle()], begun


def balanced(jumps, sent, passed):
    return len(passed) + sum(jumps.drops.values()) == len(sent)


@pytest.mark.parametrize('policy', list(TimeJumpPolicy))
@pytest.mark.parametrize('ahead', [1.5, 10.0, 3600.0, 3.2e7, -1.5, -10.0, -3600.0, -3.2e7])
@pytest.mark.parametrize('sensor', ['left', 'imu', 'gnss'])
@pytest.mark.parametrize('place', [0, 3, 300, 700])
def test_one_stray_stamp_costs_one_measurement(policy, ahead, sensor, place):
    sound = drive(8)
    own = next(i for i, item in enumerate(sound) if item.sensor == sensor and i >= place)
    if sensor == 'gnss' and ahead == -1.5:
        ahead = -2.5  # half a second behind the fix before it is in time
    stray = made(sensor, sound[own].stamp + round(ahead * SECOND))
    sent = [*sound[:own], stray, *sound[own + 1 :]]
    jumps = JumpFilter(TimeJumpSettings(policy=policy))
    passed, begun = feed(jumps, sent)
    assert not begun and not jumps.steps
    assert balanced(jumps, sent, passed)
    if place > 3:
        assert passed == [item for item in sent if item is not stray]
    else:
        assert len(passed) >= len(sent) - 2


@pytest.mark.parametrize('policy', list(TimeJumpPolicy))
@pytest.mark.parametrize('size', [-3.0, -10.0, -3600.0, 2.0, 10.0, 3600.0, 3.2e7])
@pytest.mark.parametrize('sensor', list(RATES))
def test_one_sensor_whose_clock_steps_is_told_and_followed_until_it_comes_back(
    policy, size, sensor
):
    def change(name, at):
        return size * SECOND if name == sensor and 10 <= at < 30 else 0

    sent = drive(40, change=change)
    jumps = JumpFilter(TimeJumpSettings(policy=policy))
    passed, begun = feed(jumps, sent)
    assert not begun and jumps.jumps == 0
    others = [item for item in sent if item.sensor != sensor]
    assert [item for item in passed if item.sensor != sensor] == others
    own = np.array([item.stamp for item in passed if item.sensor == sensor])
    sound = np.array([item.stamp for item in drive(40) if item.sensor == sensor])
    inside = (sound >= START + 10 * SECOND) & (sound < START + 30 * SECOND)
    ((told, step),) = jumps.steps.items()
    if step.followed:
        # It takes a second to be sure of it, and five messages.
        lost = sound[inside][: max(RATES[sensor] + 1, 5)]
        assert own.tolist() == np.setdiff1d(sound, lost).tolist()
    else:
        # Whoever leaves out all stamps that go back wants none of them.
        assert policy is TimeJumpPolicy.IGNORE and size < 0
        assert own.tolist() == sound[~inside].tolist()
    assert balanced(jumps, sent, passed)
    assert told == sensor and set(step.live) <= set(RATES) - {sensor} and step.live
    assert step.size / SECOND == pytest.approx(size, abs=1e-6 if step.followed else 0.3)
    (finding,) = step_findings(jumps.steps, {sensor: 0.5})
    key = sensor if sensor in ('imu', 'gnss') else f'lidars.{sensor}'
    assert finding.rule == 'clock_step' and f'{key}.time_offset: ' in finding.remedy
    tree = finding.settings if sensor in ('imu', 'gnss') else finding.settings['lidars']
    assert tree[sensor]['time_offset'] == pytest.approx(0.5 - size, abs=0.3)


@pytest.mark.parametrize('back', [5.0, 90.0, 3600.0])
@pytest.mark.parametrize('sensors', [tuple(RATES), ('left', 'gnss'), ('left',), ('left', 'imu')])
def test_drive_that_begins_again_is_one_jump_and_nothing_of_it_is_lost(back, sensors):
    for cut in range(0, 40 if 'imu' in sensors else 20, 3):
        jumps = JumpFilter(TimeJumpSettings())
        before = drive(8, sensors=sensors)
        again = drive(8, START + round((8 - back) * SECOND), sensors)[cut:]
        passed, begun = feed(jumps, [*before, *again])
        assert jumps.jumps == 1 and begun == [len(before)]
        assert passed == [*before, *again]
        assert not jumps.drops


def test_what_is_on_its_way_when_all_jump_is_left_out_and_blocks_nobody():
    jumps = JumpFilter(TimeJumpSettings())
    before = drive(5)
    on_the_way = [made('left', START + 5 * SECOND), made('right', START + 5 * SECOND + 7)]
    again = drive(5, START - 50 * SECOND)
    sent = [*before, *again[:4], on_the_way[0], *again[4:8], on_the_way[1], *again[8:]]
    passed, begun = feed(jumps, sent)
    assert len(begun) == 1 and len(before) <= begun[0] <= len(before) + 2
    assert [item for item in passed if all(item is not old for old in on_the_way)] == [
        *before,
        *again,
    ]


def test_jump_of_the_clock_needs_one_witness_of_each_sensor_only():
    jumps = JumpFilter(TimeJumpSettings())
    before = drive(2)
    feed(jumps, before)
    jumps.clock_jumped()
    behind = [made(name, SECOND) for name in RATES]
    passed = [jumps.check(behind[0])]
    # What was on its way is still of the time before.
    on_its_way = made(behind[1].sensor, before[-1].stamp + SECOND // 10)
    assert jumps.check(on_its_way).measurements == (on_its_way,)
    passed += [jumps.check(item) for item in behind[1:]]
    assert [item.jumped for item in passed] == [False] * (len(behind) - 1) + [True]
    assert passed[-1].measurements == tuple(behind)
    assert not jumps.drops


@pytest.mark.parametrize('sensors', [('left',), ('left', 'imu'), tuple(RATES)])
def test_a_clock_that_went_back_while_the_sensors_did_not_proves_nothing_later(sensors):
    jumps = JumpFilter(TimeJumpSettings())
    feed(jumps, drive(2, sensors=sensors))
    jumps.clock_jumped()
    after = drive(8, START + 2 * SECOND, sensors=sensors)
    stray = [made(name, START + SECOND // 2) for name in sensors]
    _, begun = feed(jumps, [*after, *stray, *drive(2, START + 10 * SECOND, sensors=sensors)])
    assert not begun and jumps.jumps == 0


@pytest.mark.parametrize('begin', [-1, 6, 12])
@pytest.mark.parametrize('held_up', [1.2, 2.0, 2.9])
def test_fixes_that_come_late_and_seldom_are_no_leaps(held_up, begin):
    rate, events = 0.8, []
    for sensor, hertz in {**RATES, 'gnss': rate}.items():
        came = 0.0
        for i in range(round(30 * hertz)):
            at = (i + 0.3) / hertz
            late = held_up if sensor == 'gnss' and begin < at < begin + 8 else LAGS[sensor]
            came = max(came, at + late)  # one topic is in order
            events.append((came, made(sensor, START + round(at * SECOND))))
    sent = [item for _, item in sorted(events, key=lambda event: event[0])]
    jumps = JumpFilter(TimeJumpSettings())
    passed, begun = feed(jumps, sent)
    assert passed == sent and not begun and not jumps.drops and not jumps.steps


def test_ignored_jump_is_counted_until_time_catches_up():
    jumps = JumpFilter(TimeJumpSettings(policy=TimeJumpPolicy.IGNORE))
    before, again = drive(5), drive(12, START - 5 * SECOND)
    passed, begun = feed(jumps, [*before, *again])
    assert not begun
    assert balanced(jumps, [*before, *again], passed)
    back = [item for item in passed[len(before) :] if item.stamp > START + 6 * SECOND]
    assert {item.sensor for item in back} == set(RATES)
    assert len(back) > 0.98 * 112
    assert {reason for _, reason in jumps.drops} == {'time_jump'}


def test_jump_begins_a_new_map_unless_the_settings_say_otherwise():
    assert Config().time_jump.policy is TimeJumpPolicy.RESET


@pytest.mark.parametrize('policy', list(TimeJumpPolicy))
@pytest.mark.parametrize('size', [2.0, 20.0, 600.0, 3600.0, 8e4])
@pytest.mark.parametrize('sensors', [tuple(RATES), ('left',), ('left', 'gnss')])
def test_pause_or_clock_set_forward_for_all_loses_nothing(policy, size, sensors):
    before = drive(8, sensors=sensors)
    after = drive(8, START + round((8 + size) * SECOND), sensors)
    jumps = JumpFilter(TimeJumpSettings(policy=policy))
    passed, begun = feed(jumps, [*before, *after])
    assert passed == [*before, *after] and not begun
    assert not jumps.drops and not jumps.steps


def test_pause_after_which_a_sensor_stays_away_loses_nothing():
    before, after = drive(8), drive(8, START + 28 * SECOND, ('left', 'imu'))
    jumps = JumpFilter(TimeJumpSettings())
    passed, _ = feed(jumps, [*before, *after])
    assert passed == [*before, *after]


def test_leap_of_one_sensor_is_believed_once_no_other_is_alive():
    before, after = drive(8), drive(8, START + HOUR, ('left',))
    passed, _ = feed(JumpFilter(TimeJumpSettings()), [*before, *after])
    assert passed == [*before, *after]


def test_a_sensor_whose_clock_steps_for_good_is_realigned_as_its_period_says():
    """Though it jitters, and messages were lost meanwhile."""
    rng = np.random.default_rng(3)
    for sensor, lost in (('left', 0), ('left', 4), ('gnss', 2), ('imu', 0)):

        def change(name, at, sensor=sensor):
            jitter = rng.normal(0.0, 0.02) / RATES[name]
            return (jitter - (12.0 if name == sensor and at >= 20 else 0.0)) * SECOND

        gap = (20.0, 20.0 + (lost + 0.5) / RATES[sensor])
        sent = [
            item
            for item in drive(60, change=change)
            if item.sensor != sensor
            or not gap[0] <= (item.stamp - START) / SECOND + 12.0 < gap[1]
            or item.stamp > START + 15 * SECOND
        ]
        jumps = JumpFilter(TimeJumpSettings())
        passed, begun = feed(jumps, sent)
        assert not begun
        assert jumps.steps[sensor].size / SECOND == pytest.approx(-12.0, abs=0.1 / RATES[sensor])
        late = [item for item in passed if item.sensor == sensor]
        last = [item for item in sent if item.sensor == sensor][-1]
        assert jumps.moved(last).stamp == late[-1].stamp != last.stamp
        assert len(late) > 0.85 * sum(item.sensor == sensor for item in sent)
        assert late[-1].stamp == pytest.approx(START + 60 * SECOND, abs=1.2 * SECOND)
        assert balanced(jumps, sent, passed)


def test_a_sensor_without_a_period_whose_clock_steps_is_left_out():
    """None tells how long after the last message before it the first one behind it was made."""
    rng = np.random.default_rng(3)

    def change(name, at):
        return -12.0 * SECOND if name == 'left' and at >= 20 else 0

    # Keyframes.
    whole = drive(40, change=change)
    sent = [item for item in whole if item.sensor != 'left' or rng.random() < 0.5]
    jumps = JumpFilter(TimeJumpSettings())
    passed, begun = feed(jumps, sent)
    assert not begun and not jumps.steps['left'].followed
    assert max(item.stamp for item in passed if item.sensor == 'left') < START + 21 * SECOND
    assert balanced(jumps, sent, passed)


def test_a_clock_that_is_set_again_and_again_is_not_followed_for_ever():
    def change(name, at):
        return -5.0 * (at // 10) * SECOND if name == 'right' else 0

    sent = drive(90, change=change)
    jumps = JumpFilter(TimeJumpSettings())
    passed, begun = feed(jumps, sent)
    assert not begun and not jumps.steps['right'].followed
    own = [item.stamp for item in passed if item.sensor == 'right']
    assert max(own) < START + (10 * (MOST_REALIGNED + 1) + 1) * SECOND
    assert {item.stamp for item in drive(20) if item.sensor == 'left'} <= {
        item.stamp for item in passed if item.sensor == 'left'
    }
    assert balanced(jumps, sent, passed)


def test_two_sensors_that_jump_together_while_others_do_not_are_followed_each():
    def change(name, at):
        return -50 * SECOND if name in ('left', 'right') and at > 10 else 0

    sent = drive(20, change=change)
    jumps = JumpFilter(TimeJumpSettings())
    passed, begun = feed(jumps, sent)
    assert not begun and set(jumps.steps) == {'left', 'right'}
    moved = [item for item in passed if item.stamp > START + 11.5 * SECOND]
    assert sorted({i.stamp for i in moved}) == sorted(
        {i.stamp for i in drive(20) if i.stamp > START + 11.5 * SECOND}
    )
    assert balanced(jumps, sent, passed)


def test_sensor_whose_stamps_stand_still_has_no_say():
    def change(name, at):
        return -(at - 5) * SECOND if name == 'right' and at > 5 else 0

    before = drive(12, change=change)
    again = drive(8, START - 50 * SECOND, ('left', 'imu', 'gnss'))
    frozen = next(item for item in reversed(before) if item.sensor == 'right')
    sent = [*before]
    for index, item in enumerate(again):
        sent.append(item)
        if index % 10 == 0:
            sent.append(made('right', frozen.stamp))
    jumps = JumpFilter(TimeJumpSettings())
    passed, begun = feed(jumps, sent)
    assert len(begun) == 1
    kept = [item for item in passed if item.sensor != 'right']
    assert kept == [item for item in [*before, *again] if item.sensor != 'right']


def test_half_seconds_back_now_and_then_are_no_jump():
    def change(name, at):
        return -0.5 * SECOND * (at // 10) if name == 'left' else 0

    sent = drive(60, change=change)
    jumps = JumpFilter(TimeJumpSettings())
    passed, begun = feed(jumps, sent)
    assert passed == sent and not begun


def test_sensor_that_is_three_seconds_late_as_a_whole_is_no_jump():
    sent = drive(20, lags=LAGS | {'left': 3.0})
    jumps = JumpFilter(TimeJumpSettings())
    passed, begun = feed(jumps, sent)
    assert passed == sent and not begun and not jumps.steps


def test_backlog_that_comes_and_goes_is_no_step():
    sent = []
    for at, item in enumerate(drive(30)):
        sent.append((at, item))
    stalled = [
        (at + (2500 if 1200 < at < 1500 and item.sensor == 'left' else 0), i, item)
        for i, (at, item) in enumerate(sent)
    ]
    order = [item for _, _, item in sorted(stalled, key=lambda entry: entry[:2])]
    passed, begun = feed(JumpFilter(TimeJumpSettings()), order)
    assert not begun
    assert [i for i in passed if i.sensor != 'left'] == [i for i in order if i.sensor != 'left']


def test_hostile_stamps_that_go_anywhere_are_no_jump():
    rng = np.random.default_rng(4)
    jumps = JumpFilter(TimeJumpSettings())
    sound, sent = drive(8, start=10**9 * SECOND), []
    for item in sound:
        sent.append(item)
        for _ in range(2):  # more than the drive's own
            by = int(10 ** rng.uniform(0.5, 8.0) * SECOND)
            sent.append(made(str(rng.choice(['left', 'gnss'])), item.stamp - by))
    passed, begun = feed(jumps, sent)
    assert not begun
    assert balanced(jumps, sent, passed)
    assert [i for i in passed if i.sensor == 'imu'] == [i for i in sound if i.sensor == 'imu']
    kept = {id(item) for item in passed}
    lost = [item for item in sound if id(item) not in kept]
    assert len(lost) < 5


def test_stamp_is_suspect_from_just_beyond_the_threshold():
    settings = TimeJumpSettings(threshold=0.5)
    for behind, passes in ((SECOND // 2, True), (SECOND // 2 + 1, False)):
        jumps = JumpFilter(settings)
        feed(jumps, [made('imu', START + i) for i in range(5)])
        assert (len(jumps.check(made('imu', START + 4 - behind)).measurements) == 1) == passes


def test_keyframes_many_seconds_apart_are_all_used():
    frames = [made('left', START + 15 * i * SECOND) for i in range(20)]
    passed, _ = feed(JumpFilter(TimeJumpSettings()), frames)
    assert passed == frames


def test_a_computer_that_learns_the_time_begins_a_new_map():
    """It started in 1970: what was mapped by then is no part of the drive half a century later."""
    before, after = drive(3, start=20 * SECOND), drive(5, start=50 * YEAR)
    jumps = JumpFilter(TimeJumpSettings())
    passed, begun = feed(jumps, [*before, *after])
    (place,) = begun
    assert all(item.stamp < YEAR for item in passed[:place])
    assert all(item.stamp > YEAR for item in passed[place:])
    assert len(passed) == len(before) + len(after) and jumps.jumps == 1


def test_a_pause_of_an_hour_does_not():
    jumps = JumpFilter(TimeJumpSettings())
    _, begun = feed(jumps, [*drive(3), *drive(5, start=START + HOUR)])
    assert not begun


def test_stamps_of_a_clock_that_was_never_set_end_no_drive_whatever_their_number():
    """All of second 12, and the last that come; the drive before them is the map."""
    sound = drive(8, start=50 * YEAR)
    rng = np.random.default_rng(2)
    stray = [
        made(sensor, 12 * SECOND + int(rng.integers(0, SECOND)))
        for sensor in rng.choice(list(RATES), 40)
    ]
    jumps = JumpFilter(TimeJumpSettings())
    passed, begun = feed(jumps, [*sound, *stray])
    assert passed == sound and not begun
    assert balanced(jumps, [*sound, *stray], passed)


@pytest.mark.parametrize('seed', range(20))
def test_dozens_of_strays_between_two_messages_are_no_jump(seed):
    """They are near enough to agree by chance, and far more of them than sound ones."""
    rng = np.random.default_rng(seed)
    newest, sent = {}, []
    for number, item in enumerate(drive(5)):
        sent.append(item)
        newest[item.sensor] = item.stamp
        for name in rng.choice(list(newest), 30 if number > 200 else 0):
            leap = np.exp(rng.uniform(np.log(1.5), np.log(3600.0))) * rng.choice([-1, 1])
            sent.append(made(str(name), newest[str(name)] + round(leap * SECOND)))
    jumps = JumpFilter(TimeJumpSettings())
    passed, begun = feed(jumps, sent)
    assert not begun
    assert balanced(jumps, sent, passed)


def test_a_pause_after_which_sensors_come_ten_times_as_seldom_loses_nothing():
    sound = drive(8)
    slow = [item for item in drive(60, START + HOUR) if round(item.stamp / 1e7) % 100 < 2]
    jumps = JumpFilter(TimeJumpSettings())
    passed, begun = feed(jumps, [*sound, *slow])
    assert not begun and len(passed) > len(sound) + 0.9 * len(slow)


@pytest.mark.parametrize('leap', [60, 3600])
def test_a_sensor_whose_first_stamps_were_strays_is_not_left_out_for_ever(leap):
    """With strays among its own that are too many for five sound ones in a row."""
    sent = []
    for number, item in enumerate(drive(8)):
        if item.sensor != 'imu' or number > 20:
            sent.append(item)
        if item.sensor == 'imu' and (number <= 20 or number % 3 == 0):
            sent.append(made('imu', item.stamp + leap * SECOND))
    jumps = JumpFilter(TimeJumpSettings())
    passed, _ = feed(jumps, sent)
    late = [item for item in sent if START + 2 * SECOND < item.stamp < START + 9 * SECOND]
    lost = {id(item) for item in late} - {id(item) for item in passed}
    assert len(lost) < 0.05 * len(late)
    assert balanced(jumps, sent, passed)


@pytest.mark.parametrize('ahead', [60 * SECOND, HOUR, 5 * YEAR])
@pytest.mark.parametrize('first', [0.1, 0.5, 0.9])
def test_a_drive_whose_first_stamps_are_far_ahead_begins_anew_though_a_sensor_came_later(
    ahead, first
):
    """The fixes begin when the others' stamps are right already, or not yet."""
    sent = drive(8, start=50 * YEAR, change=lambda _, at: ahead if at < first else 0)
    sound = [item for item in sent if item.stamp < 50 * YEAR + 10 * SECOND]
    jumps = JumpFilter(TimeJumpSettings())
    passed, begun = feed(jumps, sent)
    assert len(begun) == 1
    new = {id(item) for item in passed[begun[0] :]}
    assert sum(id(item) in new for item in sound) >= len(sound) - 2
    assert balanced(jumps, sent, passed)


@pytest.mark.parametrize('behind', [40 * SECOND, HOUR, 50 * YEAR - 12 * SECOND])
def test_one_slow_sensor_that_stays_in_another_time_does_not_leave_out_all_others(behind):
    """All began in it, too short a time to tell the others' periods."""
    start = 50 * YEAR
    sent = drive(
        9, start=start, change=lambda name, at: -behind if name == 'gnss' or at < 0.5 else 0
    )
    jumps = JumpFilter(TimeJumpSettings())
    passed, begun = feed(jumps, sent)
    sound = {id(item) for item in sent if item.stamp >= start}
    new = {id(item) for item in passed[begun[-1] :]} if begun else {id(item) for item in passed}
    assert len(sound & new) > 0.6 * len(sound)


def test_sensors_whose_first_stamps_were_of_another_time_come_back_without_a_new_map():
    """The IMU had the time from the beginning."""
    sent = drive(
        6,
        start=50 * YEAR,
        change=lambda name, at: -49 * YEAR if name in ('left', 'right') and at < 0.3 else 0,
    )
    passed, begun = feed(JumpFilter(TimeJumpSettings()), sent)
    assert not begun and len(passed) > 0.9 * len(sent)
