"""A buffer that predicts: windows of the full wait, sooner, and what surprises it is counted."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from incremental_mapper.config import WindowSettings
from incremental_mapper.mapping.window_buffer import PATIENCE, WindowBuffer
from incremental_mapper.measurements import NANOSECONDS, FixStatus, GnssFix, ImuSample, LidarScan

MS = 1_000_000
EPOCH = 1_544_676_777_000_000_000
LATENESS = 0.5
PERIODS = {'left': 100, 'right': 100, 'gnss': 1000, 'imu': 10}


def measurement(sensor, stamp):
    if sensor == 'imu':
        return ImuSample(stamp, sensor, np.zeros(3), np.zeros(3))
    if sensor == 'gnss':
        return GnssFix(stamp, sensor, 36.0, 127.0, 50.0, FixStatus.GBAS)
    return LidarScan(stamp, sensor, np.ones((1, 3), dtype=np.float32))


def drive(seconds, sensors=PERIODS, jitter=0.0, delays=None, noise=0.0, seed=0, without=()):
    """Stamps (ns) and sensors of a drive in the order of their arrival.

    Args:
        seconds: How long.
        sensors: Periods in milliseconds.
        jitter: Stamps are off by up to this share of the period.
        delays: Milliseconds from a stamp to its arrival.
        noise: Milliseconds by which an arrival is later still, at most.
        seed: Of phases, jitter and noise.
        without: Sensors and the spans (s) in which they are silent.
    """
    rng = np.random.default_rng(seed)
    arrivals = []
    for sensor, period in sensors.items():
        phase, last = rng.uniform(0, period), 0.0
        for index in range(int(1000 * seconds / period)):
            stamp = phase + period * (index + rng.uniform(-jitter, jitter))
            delay = (delays or {}).get(sensor, 0.0) + rng.uniform(0, noise)
            last = max(last, stamp + delay)
            away = [(a, b) for name, a, b in without if name == sensor]
            if not any(a <= stamp / 1000 < b for a, b in away):
                arrivals.append((last, EPOCH + round(stamp * MS), sensor))
    return [(stamp, sensor) for _, stamp, sensor in sorted(arrivals)]


def run(keys, predict=True, sensors=PERIODS, lateness=LATENESS):
    """The buffer, its windows by their keys, and how far (s) stamps had gone on at each closing."""
    sink = WindowBuffer(WindowSettings(lateness=lateness), sensors, predict)
    windows, waits, newest = [], [], 0
    for stamp, sensor in keys:
        sink.push(measurement(sensor, stamp))
        newest = max(newest, stamp)
        for window in sink.pop_ready():
            windows.append(window)
            waits.append((window.end, (newest - window.end) / NANOSECONDS))
    windows += sink.flush()
    held = [
        (w.start, w.end, [(m.stamp, m.sensor) for m in w.core], [m.stamp for m in w.imu])
        for w in windows
    ]
    return sink, held, waits


@settings(deadline=None, max_examples=60)
@given(
    seed=st.integers(0, 10**6),
    jitter=st.floats(0, 0.012),
    delays=st.fixed_dictionaries({name: st.floats(0, 150) for name in PERIODS}),
    noise=st.floats(0, 10),
    period=st.sampled_from([100, 200, 333, 1000]),
    lost=st.lists(
        st.tuples(st.sampled_from(['left', 'right', 'gnss']), st.floats(2, 9)), max_size=3
    ),
)
def test_periodic_sensors_give_the_windows_of_the_full_wait_and_none_is_late(
    seed, jitter, delays, noise, period, lost
):
    sensors = PERIODS | {'gnss': period}
    without = [(name, at, at + 0.25) for name, at in lost]
    keys = drive(10, sensors, jitter, delays, noise, seed, without)
    sink, held, _ = run(keys, True, sensors)
    assert not sink.drops and sink.late == 0
    assert held == run(keys, False, sensors)[1]


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 10**6), noise=st.floats(0, 10))
def test_without_an_imu_stamps_go_on_in_steps_and_still_none_is_late(seed, noise):
    sensors = {'left': 100, 'gnss': 1000}
    keys = drive(20, sensors, 0.012, {'left': 100.0, 'gnss': 30.0}, noise, seed)
    sink, held, _ = run(keys, True, sensors)
    assert not sink.drops and sink.late == 0
    assert held == run(keys, False, sensors)[1]


@settings(deadline=None, max_examples=60)
@given(st.data())
def test_whatever_comes_is_in_one_window_or_counted(data):
    keys = drive(4, jitter=0.3, noise=400.0, seed=data.draw(st.integers(0, 10**6)))
    places = data.draw(st.lists(st.integers(0, len(keys) - 1), max_size=60))
    back = data.draw(st.lists(st.integers(-3000, 3000), min_size=60, max_size=60))
    for place, by in zip(places, back, strict=False):
        stamp, sensor = keys[place]
        keys[place] = (stamp + by * MS, sensor)
    sink, held, _ = run(keys)
    handed = sum(len(core) + len(imu) for _, _, core, imu in held)
    assert handed + sum(sink.drops.values()) == len(keys)


def test_window_waits_for_no_fix_that_is_not_due():
    _, _, waits = run(drive(20, jitter=0.005, noise=3.0))
    usual = [wait for end, wait in waits if end > EPOCH + 2 * NANOSECONDS]
    assert len(usual) > 170
    assert np.quantile(usual, 0.5) < 0.015
    assert np.quantile(usual, 0.99) < 0.08


def test_fixes_that_were_missed_do_not_make_the_others_uncertain():
    keys = drive(30, jitter=0.005, noise=3.0, without=[('gnss', 6.0, 12.5)])
    _, _, waits = run(keys)
    after = [wait for end, wait in waits if end > EPOCH + 15 * NANOSECONDS]
    assert len(after) > 140
    # One window of ten has a fix that is due.
    assert np.quantile(after, 0.85) < 0.015


def test_while_fixes_are_missing_only_the_windows_wait_in_which_one_would_be_due():
    keys = drive(40, jitter=0.005, noise=3.0, without=[('gnss', 25.0, 33.5)])
    sink, held, waits = run(keys)
    meanwhile = [
        wait for end, wait in waits if EPOCH + 25.5 * NANOSECONDS < end < EPOCH + 32.5 * NANOSECONDS
    ]
    assert len(meanwhile) > 65
    assert np.quantile(meanwhile, 0.75) < 0.015
    assert not sink.drops and sink.late == 0
    assert held == run(keys, False)[1]


@settings(deadline=None, max_examples=40)
@given(
    seed=st.integers(0, 10**6),
    jitter=st.floats(0, 0.012),
    delay=st.floats(0, 150),
    lost=st.lists(st.tuples(st.floats(8, 18), st.floats(0.5, 5.0)), max_size=3),
)
def test_fixes_that_come_back_at_their_pace_are_in_the_windows_of_the_full_wait(
    seed, jitter, delay, lost
):
    without = [('gnss', at, at + length) for at, length in lost]
    keys = drive(25, PERIODS, jitter, {'gnss': delay}, 5.0, seed, without)
    sink, held, _ = run(keys)
    assert not sink.drops and sink.late == 0
    assert held == run(keys, False)[1]


def test_first_windows_wait_no_longer_than_until_all_sensors_have_sent():
    keys = drive(20, jitter=0.005, noise=3.0)
    seen = {}
    for stamp, sensor in keys:
        seen.setdefault(sensor, stamp)
    _, held, waits = run(keys)
    assert held[0][0] == min(stamp for stamp, sensor in keys if sensor != 'imu')
    assert all(
        end / NANOSECONDS + wait < max(seen.values()) / NANOSECONDS + 0.1 or wait < 0.1
        for end, wait in waits
    )


def begun(keys):
    """The buffer and what it told to begin with."""
    told = []
    sink = WindowBuffer(WindowSettings(), PERIODS, True, begin=told.append)
    windows = []
    for stamp, sensor in keys:
        sink.push(measurement(sensor, stamp))
        windows += sink.pop_ready()
    windows += sink.flush()
    return sink, told, [item for window in windows for item in window.core]


def test_core_measurements_are_told_of_before_their_window_is_closed():
    keys = drive(10, jitter=0.005, noise=3.0)
    sink, told, core = begun(keys)
    assert {id(item) for item in told} == {id(item) for item in core} and len(told) == len(core)
    assert not sink.drops


def prepared(keys, sensors):
    """Stamps by sensor in the order in which they would be prepared: begun, or when handed out."""
    order = {}
    told = set()

    def take(item):
        told.add(id(item))
        order.setdefault(item.sensor, []).append(item.stamp)

    sink = WindowBuffer(WindowSettings(), sensors, True, begin=take)

    def hand_out(windows):
        for window in windows:
            for item in window.core:
                if id(item) not in told:
                    order.setdefault(item.sensor, []).append(item.stamp)

    kept = [measurement(sensor, stamp) for stamp, sensor in keys]
    for item in kept:
        sink.push(item)
        hand_out(sink.pop_ready())
    hand_out(sink.flush())
    return order


@pytest.mark.parametrize('sensors', [{'left': 50}, {'left': 500}, {'left': 100, 'gnss': 1000}])
def test_scans_of_a_lidar_are_prepared_in_their_order_from_the_first_one_on(sensors):
    keys = drive(10, sensors)
    order = prepared(keys, sensors)
    left = [stamp for stamp, sensor in keys if sensor == 'left']
    assert order['left'] == left


@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 10**6), ahead=st.integers(120, 900), noise=st.floats(0, 60))
def test_a_stray_stamp_does_not_change_the_order_in_which_scans_are_prepared(seed, ahead, noise):
    keys = drive(6, {'left': 100, 'imu': 10}, 0.01, noise=noise, seed=seed)
    place = [i for i, (_, sensor) in enumerate(keys) if sensor == 'left'][20]
    keys[place] = (keys[place][0] + ahead * MS, 'left')
    order = prepared(keys, {'left': 100, 'imu': 10})['left']
    assert order == sorted(order)


def test_what_comes_behind_one_that_was_begun_is_late():
    keys = drive(10, {'left': 20, 'imu': 10})
    places = [i for i, (_, sensor) in enumerate(keys) if sensor == 'left']
    at = next(i for i in places[200:] if 20 < (keys[i][0] - keys[places[0]][0]) / MS % 100 < 70)
    keys.insert(at + 3, keys.pop(at))
    sink, told, core = begun(keys)
    left = [item.stamp for item in core if item.sensor == 'left']
    assert left == sorted(left) == [item.stamp for item in told if item.sensor == 'left']
    assert sink.drops == {('left', 'late'): 1}


def test_a_stray_stamp_ahead_is_not_begun():
    keys = drive(10, jitter=0.0)
    place = [i for i, (_, sensor) in enumerate(keys) if sensor == 'left'][40]
    keys[place] = (keys[place][0] + 700 * MS, 'left')
    _, told, core = begun(keys)
    stray = (keys[place][0], 'left')
    assert stray not in {(item.stamp, item.sensor) for item in told}
    assert stray in {(item.stamp, item.sensor) for item in core}


def test_without_prediction_a_window_waits_in_full():
    _, _, waits = run(drive(20, jitter=0.005, noise=3.0), predict=False)
    assert np.quantile([wait for _, wait in waits], 0.5) > 0.4


@pytest.mark.parametrize('dead', ['left', 'right', 'gnss', 'imu'])
def test_sensor_that_dies_soon_delays_no_window(dead):
    keys = drive(20, jitter=0.005, noise=3.0, without=[(dead, 5.0, 99.0)])
    _, _, waits = run(keys)
    after = [wait for end, wait in waits if end > EPOCH + 9 * NANOSECONDS]
    assert len(after) > 90 and max(after) < 0.12


@pytest.mark.parametrize('away', ['left', 'right', 'gnss', 'imu'])
@pytest.mark.parametrize('delay', [0.0, 120.0])
def test_sensor_that_comes_back_is_used_from_its_second_message_on(away, delay):
    span = (away, 5.0, 11.0)
    keys = drive(25, jitter=0.005, noise=3.0, delays={away: delay}, without=[span])
    sink, held, _ = run(keys)
    back = [stamp for stamp, sensor in keys if sensor == away and stamp > EPOCH + 11 * NANOSECONDS]
    used = {m[0] for _, _, core, _ in held for m in core if m[1] == away}
    used |= {stamp for _, _, _, imu in held for stamp in imu} if away == 'imu' else set()
    # What comes in before its lateness is known again may be late; the IMU sends fast.
    missed = len(set(back) - used)
    assert missed <= (delay * 1.2 / PERIODS[away] + 1 if delay else 0)
    assert sum(sink.drops.values()) == missed


def test_sensor_that_never_sends_is_given_up():
    keys = drive(10, jitter=0.005, without=[('gnss', 0.0, 99.0)])
    _, _, waits = run(keys)
    late = [wait for end, wait in waits if end > EPOCH + PATIENCE + NANOSECONDS]
    early = [wait for end, wait in waits if end < EPOCH + PATIENCE - NANOSECONDS]
    assert max(late) < 0.12 and min(early) > 0.39


def test_sensor_that_first_sends_later_is_waited_for_from_then_on():
    keys = drive(20, jitter=0.005, delays={'gnss': 80.0}, without=[('gnss', 0.0, 8.0)])
    sink, held, _ = run(keys)
    used = [m for _, _, core, _ in held for m in core if m[1] == 'gnss']
    assert len(used) >= 11
    assert len(used) + sum(sink.drops.values()) == 12


def test_a_message_that_surprises_goes_to_the_next_window_or_is_counted_and_the_next_is_not_late():
    keys = drive(20, jitter=0.0, seed=3)
    place = next(i for i, (stamp, s) in enumerate(keys) if s == 'gnss' and i > 1200)
    late = keys.pop(place)
    following = next(i for i, (stamp, _) in enumerate(keys) if stamp > late[0] + 300 * MS)
    keys.insert(following, late)
    sink, _, _ = run(keys)
    assert sink.drops + Counter({('gnss', 'late'): sink.late}) == {('gnss', 'late'): 1}
    # As late again, it is waited for by now.
    again = next(i for i, (stamp, s) in enumerate(keys) if s == 'gnss' and stamp > late[0])
    moved = keys.pop(again)
    keys.insert(next(i for i, (stamp, _) in enumerate(keys) if stamp > moved[0] + 300 * MS), moved)
    sink, _, _ = run(keys)
    assert sink.late + sum(sink.drops.values()) == 1


def test_sensor_far_behind_all_others_delays_nobody_for_it_cannot_be_waited_for():
    keys = drive(20, jitter=0.005, noise=3.0, delays={'right': 3000.0})
    sink, _, waits = run(keys)
    after = [wait for end, wait in waits if end > EPOCH + 9 * NANOSECONDS]
    assert np.quantile(after, 0.99) < 0.12
    assert sink.drops['right', 'late'] > 150
