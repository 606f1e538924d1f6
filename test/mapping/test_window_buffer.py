"""Gathering into windows: order of arrival, silence, bad stamps, and that nothing gets lost."""

from collections import Counter
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from incremental_mapper.config import WindowSettings
from incremental_mapper.mapping.window_buffer import LEAP_WITNESSES, WindowBuffer
from incremental_mapper.measurements import FixStatus, GnssFix, ImuSample, LidarScan

MS = 1_000_000
EPOCH = 1_544_676_777_000_000_000
LATENESS = 500
SENSORS = ('left', 'right', 'gps', 'imu')


def measurement(sensor, milliseconds):
    stamp = EPOCH + milliseconds * MS
    if sensor == 'imu':
        return ImuSample(stamp, sensor, np.zeros(3), np.zeros(3))
    if sensor == 'gps':
        return GnssFix(stamp, sensor, 36.0, 127.0, 50.0, FixStatus.GBAS)
    return LidarScan(stamp, sensor, np.ones((1, 3), dtype=np.float32))


def buffer(sensors=SENSORS, lateness=LATENESS):
    return WindowBuffer(WindowSettings(duration=0.1, lateness=lateness / 1000), sensors)


def run(sink, measurements):
    """Push everything, popping after every push, and flush."""
    windows = []
    for item in measurements:
        sink.push(item)
        windows.extend(sink.pop_ready())
    return [*windows, *sink.flush()]


def contents(windows):
    """Windows as bounds, core keys and IMU stamps, in milliseconds."""
    return [
        (
            (window.start - EPOCH) / MS,
            (window.end - EPOCH) / MS,
            tuple(((item.stamp - EPOCH) // MS, item.sensor) for item in window.core),
            tuple((item.stamp - EPOCH) // MS for item in window.imu),
        )
        for window in windows
    ]


def counted(windows):
    return sum(len(window.core) + len(window.imu) for window in windows)


def steady(duration, gps_every=100):
    """A drive: two LiDARs at 10 Hz, a receiver, an IMU at 100 Hz; sorted by stamp."""
    keys = [(t, 'left') for t in range(0, duration, 100)]
    keys += [(t, 'right') for t in range(37, duration, 100)]
    keys += [(t, 'gps') for t in range(61, duration, gps_every)]
    keys += [(t, 'imu') for t in range(3, duration, 10)]
    return [measurement(sensor, t) for t, sensor in sorted(keys)]


@st.composite
def streams(draw):
    """Stamps (ms) of every sensor with gaps, and the same in another order of arrival.

    Each sensor's own messages stay in order, and none is overtaken by ``LATENESS`` or more.
    """
    grid = st.integers(0, 30).map(lambda n: 50 * n + 7)
    keys = sorted(draw(st.sets(st.tuples(grid, st.sampled_from(SENSORS)), min_size=1, max_size=25)))
    arrivals = []
    last = dict.fromkeys(SENSORS, -1)
    for t, sensor in keys:
        delay = draw(st.sampled_from([0, 0, 40, 250, LATENESS - 20, LATENESS - 1]))
        last[sensor] = max(last[sensor], t + delay)
        arrivals.append((last[sensor], t, sensor))
    return keys, [(t, sensor) for _, t, sensor in sorted(arrivals)]


@settings(deadline=None, max_examples=250)
@given(streams())
def test_sensors_delayed_by_less_than_lateness_give_the_windows_of_sorted_input(stream):
    keys, delayed = stream
    in_order = contents(run(buffer(), [measurement(sensor, t) for t, sensor in keys]))
    sink = buffer()
    assert contents(run(sink, [measurement(sensor, t) for t, sensor in delayed])) == in_order
    assert not sink.drops
    assert sink.late == 0


def test_fix_within_lateness_keeps_its_window_where_the_scans_have_a_gap():
    # 600 closes the window at 0; the next scan is at 350, but a fix at 150 may still come.
    keys = [('left', 0), ('right', 5), ('gps', 10), ('left', 350), ('right', 360)]
    keys += [('left', 600), ('gps', 150), ('right', 610), ('gps', 620)]
    sink = buffer(('left', 'right', 'gps'))
    windows = contents(run(sink, [measurement(*key) for key in keys]))
    assert [(start, [t for t, _ in core]) for start, _, core, _ in windows] == [
        (0, [0, 5, 10]),
        (100, [150]),
        (300, [350, 360]),
        (600, [600, 610, 620]),
    ]
    assert sink.late == 0


@st.composite
def messy_input(draw):
    """Any order, repeats, and stamps far off."""
    usual = st.tuples(st.integers(0, 2000), st.sampled_from(SENSORS))
    wild = st.tuples(st.integers(-30_000, 60_000), st.sampled_from(SENSORS))
    return draw(st.lists(usual | usual | usual | wild, max_size=50))


@settings(deadline=None, max_examples=150)
@given(messy_input())
def test_everything_pushed_is_handed_out_once_or_counted_as_dropped(keys):
    sink = buffer()
    windows = run(sink, [measurement(sensor, t) for t, sensor in keys])
    assert counted(windows) + sum(sink.drops.values()) == len(keys)
    assert len(sink) == 0
    handed = [(m.stamp, m.sensor) for w in windows for m in (*w.core, *w.imu)]
    assert len(handed) == len(set(handed))


@settings(deadline=None, max_examples=150)
@given(messy_input())
def test_windows_never_go_back_in_time(keys):
    windows = run(buffer(), [measurement(sensor, t) for t, sensor in keys])
    for kind in ('core', 'imu'):
        stamps = [item.stamp for window in windows for item in getattr(window, kind)]
        assert stamps == sorted(stamps)
    for window in windows:
        assert window.start < window.end
        assert all(item.stamp < window.end for item in (*window.core, *window.imu))
    assert all(before.end <= after.end for before, after in pairwise(windows))
    # Late IMU samples that flush hands out by themselves may lie inside an older window.
    assert all(
        before.end <= after.start for before, after in pairwise(w for w in windows if w.core)
    )


def test_flushing_again_for_an_imu_sample_of_a_closed_window_makes_no_window_that_ends_early():
    sink = buffer(('left', 'imu'))
    first = run(sink, [measurement('left', 0), measurement('imu', 10)])
    again = run(sink, [measurement('imu', 50)])
    assert [item.stamp for window in again for item in window.imu] == [EPOCH + 50 * MS]
    assert all(window.start < window.end for window in (*first, *again))
    assert first[-1].end <= again[0].end


def test_windows_of_a_steady_drive_hold_what_their_bounds_say():
    sink = buffer()
    windows = run(sink, steady(1000))
    full = windows[:10]
    assert [window.end - window.start for window in full] == [100 * MS] * 10
    assert [(window.start - EPOCH) // MS for window in full] == list(range(0, 1000, 100))
    for window in full:
        stamps = [item.stamp for item in (*window.core, *window.imu)]
        assert all(window.start <= stamp < window.end for stamp in stamps)
        assert Counter(item.sensor for item in window.core) == {'left': 1, 'right': 1, 'gps': 1}
        assert len(window.imu) == 10
    assert counted(windows) == len(steady(1000))


def test_imu_before_the_first_core_measurement_is_in_the_first_window():
    keys = [('imu', 0), ('imu', 10), ('left', 50), ('imu', 60), ('left', 150), ('imu', 160)]
    windows = contents(run(buffer(('left', 'imu')), [measurement(*key) for key in keys]))
    assert windows[0] == (50, 150, ((50, 'left'),), (0, 10, 60))


def test_empty_stretch_makes_no_empty_windows_and_keeps_the_grid():
    keys = [('left', 0), ('left', 100), ('left', 934)]
    windows = contents(run(buffer(('left',)), [measurement(*key) for key in keys]))
    assert [(start, end) for start, end, _, _ in windows] == [(0, 100), (100, 200), (900, 1000)]


def test_window_closes_as_soon_as_every_sensor_has_passed_its_end():
    sink = buffer(('left', 'right'))
    inside = [('left', 0), ('left', 20), ('right', 37), ('left', 40), ('right', 57)]
    for key in [*inside, ('left', 100)]:
        sink.push(measurement(*key))
        assert sink.pop_ready() == []
    sink.push(measurement('right', 137))
    core = tuple((t, sensor) for sensor, t in inside)
    assert contents(sink.pop_ready()) == [(0, 100, core, ())]


@pytest.mark.parametrize('seen', [True, False])
def test_dead_sensor_is_waited_for_no_longer_than_lateness(seen):
    sink = buffer(('left', 'gps'))
    if seen:
        sink.push(measurement('gps', 20))
    closed = {}
    for t in range(0, 1200, 100):
        sink.push(measurement('left', t))
        for window in sink.pop_ready():
            closed[(window.start - EPOCH) // MS] = t
    assert closed[0] == 100 + LATENESS
    assert closed[100] == 200 + LATENESS
    assert sink.drops == Counter()


def test_sensor_that_nobody_announced_is_waited_for_once_it_is_seen():
    sink = buffer(())
    for key in [('left', 0), ('right', 30), ('left', 40), ('left', 60), ('left', 110)]:
        sink.push(measurement(*key))
    assert sink.pop_ready() == []
    sink.push(measurement('right', 130))
    assert len(sink.pop_ready()) == 1


def test_same_sensor_and_stamp_twice_is_one_measurement():
    sink = buffer(('left', 'imu'))
    keys = [('left', 0), ('imu', 5), ('left', 0), ('imu', 5)]
    windows = run(sink, [measurement(*key) for key in keys])
    assert counted(windows) == 2
    assert sink.drops == {('left', 'duplicate_stamp'): 1, ('imu', 'duplicate_stamp'): 1}


def test_same_stamp_of_two_sensors_is_two_measurements():
    sink = buffer(('left', 'right'))
    windows = run(sink, [measurement('left', 0), measurement('right', 0)])
    assert counted(windows) == 2
    assert not sink.drops


def test_late_scan_that_still_fits_goes_to_the_next_window_with_its_own_stamp():
    sink = buffer(('left', 'right'), lateness=100)
    keys = [('left', 0), ('right', 40), ('left', 100), ('left', 200), ('left', 310)]
    windows = []
    for key in keys:
        sink.push(measurement(*key))
        windows.extend(sink.pop_ready())
    sink.push(measurement('right', 150))  # its window is closed, the scan at 100 is handed out
    windows.extend([*sink.pop_ready(), *sink.flush()])
    assert sink.late == 1
    assert not sink.drops
    held = [[t for t, _ in core] for _, _, core, _ in contents(windows)]
    assert held == [[0, 40], [100], [150, 200], [310]]


def test_late_scan_that_would_break_the_order_is_dropped_and_counted():
    sink = buffer(('left', 'right'), lateness=0)
    for key in [('left', 0), ('right', 10), ('left', 150), ('right', 160), ('left', 210)]:
        sink.push(measurement(*key))
        sink.pop_ready()
    sink.push(measurement('right', 120))
    assert sink.drops == {('right', 'late'): 1}


def test_one_stamp_far_ahead_is_rejected_and_changes_no_window():
    drive = steady(2000)
    expected = contents(run(buffer(), drive))
    sink = buffer()
    bad = measurement('gps', 3_600_000)
    assert contents(run(sink, [*drive[:100], bad, *drive[100:]])) == expected
    assert sink.drops == {('gps', 'stamp_leap'): 1}


def test_very_first_stamp_may_be_far_ahead_too():
    drive = steady(2000)
    expected = contents(run(buffer(), drive))
    sink = buffer()
    assert contents(run(sink, [measurement('gps', 3_600_000), *drive])) == expected
    assert sink.drops == {('gps', 'stamp_leap'): 1}


@pytest.mark.parametrize('sensor', ['left', 'gps', 'imu'])
def test_stamps_far_behind_at_the_start_do_not_begin_the_grid(sensor):
    drive = steady(2000)
    expected = contents(run(buffer(), drive))
    for place in (0, 2, 8):
        sink = buffer()
        stray = measurement(sensor, -3_600_000)
        assert contents(run(sink, [*drive[:place], stray, *drive[place:]])) == expected
        assert sum(sink.drops.values()) == 1


def test_stray_stamps_in_a_row_that_have_nothing_in_common_prove_no_leap():
    drive = steady(2000)
    expected = contents(run(buffer(), drive))
    sink = buffer()
    strays = [measurement('imu', 100_000 * 4**i) for i in range(3 * LEAP_WITNESSES)]
    assert contents(run(sink, [*drive[:100], *strays, *drive[100:]])) == expected
    assert sink.drops == {('imu', 'stamp_leap'): len(strays)}


def test_keyframes_many_seconds_apart_are_all_used():
    sink = buffer(('left',))
    frames = [measurement('left', 15_000 * i) for i in range(20)]
    assert counted(run(sink, frames)) >= len(frames) - LEAP_WITNESSES + 1


def test_stamp_far_ahead_at_the_very_end_is_counted():
    sink = buffer()
    drive = steady(500)
    windows = run(sink, [*drive, measurement('left', 3_600_000)])
    assert counted(windows) == len(drive)
    assert sink.drops == {('left', 'stamp_leap'): 1}


def test_real_gap_is_believed_after_a_few_measurements_and_none_is_lost():
    before, after = steady(1000), steady(1000)
    shift = 3_600_000
    moved = [measurement(m.sensor, (m.stamp - EPOCH) // MS + shift) for m in after]
    sink = buffer()
    for item in [*before, *moved[: LEAP_WITNESSES - 1]]:
        sink.push(item)
        assert all(window.start < EPOCH + 1000 * MS for window in sink.pop_ready())
    windows = run(sink, moved[LEAP_WITNESSES - 1 :])
    assert not sink.drops
    late = [window for window in windows if window.core and window.start > EPOCH + 2000 * MS]
    assert sum(len(window.core) for window in late) == sum(m.sensor != 'imu' for m in moved)


def test_looped_input_is_counted_as_late_and_makes_no_more_windows():
    drive = steady(3000)
    once = contents(run(buffer(), drive))
    sink = buffer()
    windows = []
    for item in [*drive, *drive]:
        sink.push(item)
        windows.extend(sink.pop_ready())
    windows.extend(sink.flush())
    assert contents(windows) == once
    assert sum(sink.drops.values()) == len(drive)
    assert {reason for _, reason in sink.drops} <= {'late', 'duplicate_stamp'}
    assert sum(n for (_, reason), n in sink.drops.items() if reason == 'late') > len(drive) / 2


def test_imu_after_the_last_scan_is_handed_out_by_flush():
    sink = buffer(('left', 'imu'))
    windows = run(sink, [measurement('left', 0), *(measurement('imu', t) for t in (5, 250, 300))])
    assert [item.stamp for window in windows for item in window.imu] == [
        EPOCH + t * MS for t in (5, 250, 300)
    ]


def test_flush_of_an_empty_buffer_gives_nothing():
    assert buffer().flush() == []


def leapt(sensor, milliseconds):
    return measurement(sensor, 3_600_000 + milliseconds)


def test_witnesses_of_a_leap_are_in_their_windows_and_others_may_still_join_them():
    # All witnesses are of one sensor, the last ones in later windows than the first: the other
    # sensor has not passed the first window yet.
    sink = buffer(('left', 'gps'))
    for item in (measurement(*key) for key in [('left', 0), ('gps', 20), ('left', 100)] * 2):
        sink.push(item)
    for t in (0, 120, 240, 330, 450, 460, 470, 480):
        sink.push(leapt('left', t))
        sink.pop_ready()
    for t in (50, 130, 600):
        sink.push(leapt('gps', t))
    windows = contents(sink.flush())
    later = [
        (start - 3_600_000, [(t - 3_600_000, sensor) for t, sensor in core])
        for start, _, core, _ in windows
        if start > 3_000_000
    ]
    assert later == [
        (0, [(0, 'left'), (50, 'gps')]),
        (100, [(120, 'left'), (130, 'gps')]),
        (200, [(240, 'left')]),
        (300, [(330, 'left')]),
        (400, [(t, 'left') for t in (450, 460, 470, 480)]),
        (600, [(600, 'gps')]),
    ]
    assert ('left', 'late') not in sink.drops and ('gps', 'late') not in sink.drops


@pytest.mark.parametrize(
    ('step', 'lateness', 'most'), [(10, 500, 1000), (10, 2000, 4000), (400, 500, 1600)]
)
@pytest.mark.parametrize('beyond', [0, 1])
def test_stamp_far_ahead_for_the_stream_it_is_in_is_a_leap(step, lateness, most, beyond):
    sink = buffer(('left',), lateness)
    for t in range(0, 10 * step, step):
        sink.push(measurement('left', t))
    sink.push(measurement('left', 9 * step + most + beyond))
    sink.push(measurement('left', 10 * step))
    sink.flush()
    assert sink.drops == ({('left', 'stamp_leap'): 1} if beyond else {})


def test_stray_stamp_a_few_seconds_ahead_makes_nothing_late():
    drive = steady(2000)
    expected = contents(run(buffer(), drive))
    for sensor in SENSORS:
        sink = buffer()
        strays = [measurement(sensor, 4000), measurement(sensor, 9000)]
        given = [*drive[:100], strays[0], *drive[100:150], strays[1], *drive[150:]]
        assert contents(run(sink, given)) == expected
        assert sink.drops == {(sensor, 'stamp_leap'): 2}


def test_eight_witnesses_in_a_row_prove_a_leap_and_seven_do_not():
    few, enough = LEAP_WITNESSES - 1, LEAP_WITNESSES
    for count, believed in ((few, False), (enough, True)):
        sink = buffer(('left',))
        for t in range(0, 100, 10):
            sink.push(measurement('left', t))
        for t in range(count):
            sink.push(leapt('left', 10 * t))
        sink.push(leapt('left', 100) if believed else measurement('left', 100))
        sink.flush()
        assert sink.drops == ({} if believed else {('left', 'stamp_leap'): few})
        # One that comes in between says that those before it were wrong.
        sink = buffer(('left',))
        for t in range(0, 100, 10):
            sink.push(measurement('left', t))
        for t in range(count):
            sink.push(leapt('left', 10 * t))
            if t == 1:
                sink.push(measurement('left', 95))
        sink.push(measurement('left', 96))
        sink.flush()
        assert sum(sink.drops.values()) == count


def test_straggler_of_before_a_leap_costs_none_of_its_witnesses():
    sink = buffer(('left', 'imu'))
    for t in range(0, 100, 10):
        sink.push(measurement('imu', t))
    sink.push(measurement('left', 50))
    for t in range(5):
        sink.push(leapt('imu', 10 * t))
    sink.push(measurement('left', 85))
    for t in range(5, 5 + LEAP_WITNESSES):
        sink.push(leapt('imu', 10 * t))
    windows = sink.flush()
    assert not sink.drops
    assert counted(windows) == 12 + 5 + LEAP_WITNESSES


def test_two_that_agree_are_believed_at_the_end_where_nothing_is_after_them():
    sink = buffer()
    drive = steady(500)
    windows = run(sink, [*drive, leapt('left', 0), leapt('imu', 30)])
    assert counted(windows) == len(drive) + 2
    assert not sink.drops


def test_sensor_whose_clock_was_ahead_from_its_first_message_on_is_used():
    drive = [m for m in steady(2000) if m.sensor != 'left']
    ahead = [measurement('left', 5000 + t) for t in range(0, 2000, 100)]
    both = sorted([*drive, *ahead], key=lambda m: m.stamp - 5000 * MS * (m.sensor == 'left'))
    sink = buffer()
    run(sink, both)
    assert not [key for key in sink.drops if key[0] == 'left']


def test_grid_starts_at_the_oldest_measurement_that_is_in_time():
    # The fix is late, but not later than it may be: nothing is handed out before it.
    sink = buffer(('left', 'gps'))
    for t in range(100, 700, 50):
        sink.push(measurement('left', t))
        sink.pop_ready()
    sink.push(measurement('gps', 60))
    windows = contents(sink.flush())
    assert windows[0][:2] == (60, 160)
    assert windows[0][2] == ((60, 'gps'), (100, 'left'), (150, 'left'))
    assert sink.late == 0 and not sink.drops


def test_samples_alone_are_one_window_from_the_first_to_just_behind_the_last():
    sink = buffer(('imu',))
    windows = run(sink, [measurement('imu', t) for t in (30, 10, 20, 40, 50, 55)])
    assert [(window.start - EPOCH, window.end - EPOCH) for window in windows] == [
        (10 * MS, 55 * MS + 1)
    ]
    assert len(windows[0].imu) == 6


@pytest.mark.parametrize('late', [0, 1])
def test_window_is_closed_once_all_have_reached_its_end(late):
    sink = buffer(('left', 'right'))
    for t in (0, 10, 20):
        sink.push(measurement('left', t))
        sink.push(measurement('right', t))
    sink.push(measurement('left', 100))
    sink.push(measurement('right', 100 - late))
    assert len(sink.pop_ready()) == 1 - late


@pytest.mark.parametrize(('ahead', 'leap'), [(1000, False), (1001, True)])
def test_first_stamp_may_be_as_far_ahead_of_the_others_as_any(ahead, leap):
    sink = buffer(('left',))
    for t in (ahead + 20, 0, 10, 20, 30, 40):
        sink.push(measurement('left', t))
    sink.flush()
    assert sink.drops == ({('left', 'stamp_leap'): 1} if leap else {})


@pytest.mark.parametrize('ahead', [60_000, 3_600_000, 10**12])
def test_a_stray_stamp_that_is_repeated_proves_no_leap_and_no_beginning(ahead):
    """A driver that starts says one and the same time, wherever it comes in the drive."""
    drive = list(steady(3000))
    expected = contents(run(buffer(), drive))
    for place in (2, 3, 7, 100):
        sink = buffer()
        strays = [measurement('imu', ahead)] * (4 * LEAP_WITNESSES)
        assert contents(run(sink, [*drive[:place], *strays, *drive[place:]])) == expected
        assert sum(sink.drops.values()) == len(strays)


def test_strays_all_over_among_the_first_messages_do_not_tell_the_time():
    drive = list(steady(3000))
    expected = contents(run(buffer(), drive))
    strays = [measurement('imu', at) for at in (-(10**9), -5 * 10**8, -30_000, 3_600_000, 60_000)]
    given = [drive[0], *strays, *drive[1:3], *strays[::-1], *drive[3:]]
    assert contents(run(buffer(), given)) == expected


def ahead_for(milliseconds, drive, sensors=SENSORS, by=3_600_000):
    """A drive whose sensors are ``by`` ahead for the first while (ms), and what is not."""
    made = [
        measurement(m.sensor, (m.stamp - EPOCH) // MS + by)
        if m.sensor in sensors and m.stamp < EPOCH + milliseconds * MS
        else m
        for m in drive
    ]
    return made, [m for m, before in zip(made, drive, strict=True) if m is before]


@pytest.mark.parametrize('by', [60_000, 3_600_000, 10**11])
@pytest.mark.parametrize(
    ('milliseconds', 'sensors'),
    [(60, ('imu',)), (200, ('imu',)), (60, SENSORS), (300, ('imu', 'left'))],
)
def test_first_stamps_that_all_later_ones_contradict_do_not_tell_the_time(
    milliseconds, sensors, by
):
    given, sound = ahead_for(milliseconds, steady(3000), sensors, by)
    sink = buffer()
    assert contents(run(sink, given)) == contents(run(buffer(), sound))
    strays = Counter((m.sensor, 'stamp_leap') for m in given if not any(m is s for s in sound))
    assert sink.drops == strays


def test_strays_of_one_time_between_sound_ones_from_the_first_on_do_not_tell_it():
    """Never eight sound ones in a row, but far more of them."""
    drive = steady(3000)
    strays = [measurement('imu', 3_600_000 + 10 * t) for t in range(len(drive) // 4)]
    given = strays[:6]
    for number, item in enumerate(drive):
        given.append(item)
        if number % 5 == 4 and number < 200:
            given.append(strays[6 + number // 5])
    sink = buffer()
    windows = run(sink, given)
    assert sum(len(window.core) for window in windows) == sum(m.sensor != 'imu' for m in drive)
    assert max(window.end for window in windows) < EPOCH + 4000 * MS
    assert counted(windows) == len(drive)


def test_what_was_told_before_a_first_time_is_given_up_is_taken_back():
    told = []
    given, sound = ahead_for(70, steady(2000))
    sink = WindowBuffer(
        WindowSettings(),
        SENSORS,
        True,
        begin=told.append,
        sample=told.append,
        restart=told.clear,
    )
    windows = run(sink, given)
    out = [item for window in windows for item in (*window.core, *window.imu)]
    assert {id(item) for item in told} == {id(item) for item in out} == {id(m) for m in sound}


def test_a_few_in_a_row_far_behind_the_first_ones_prove_nothing():
    drive = steady(3000)
    expected = contents(run(buffer(), drive))
    sink = buffer()
    strays = [measurement('imu', 10 * t - 3_600_000) for t in range(LEAP_WITNESSES - 1)]
    assert contents(run(sink, [*drive[:12], *strays, *drive[12:]])) == expected
    assert sink.drops == {('imu', 'stamp_leap'): len(strays)}
