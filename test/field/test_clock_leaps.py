"""Recordings in which the stamps of all sensors leap together."""

from dataclasses import replace

import pytest

from incremental_mapper.datasets.open import open_source
from incremental_mapper.measurements import NANOSECONDS

DAY = 86400 * NANOSECONDS


def leaping(recording, by, recorder):
    """With everything in the first half stamped ``by`` (ns) earlier than it was."""
    from lies.recording import restamped, stamp_of

    until = (recording.start + recording.end) // 2
    items = [
        (
            0 if recorder == 'none' else t - by if t < until and recorder == 'leaps' else t,
            topic,
            restamped(m, stamp_of(m) - by) if t < until else m,
        )
        for t, topic, m in recording.items
    ]
    return replace(recording, items=tuple(items))


def seen(path):
    source = open_source(path)
    rules = [found.rule for found in source.info.findings]
    return [(m.sensor, m.stamp) for m in source.measurements()], rules, source


@pytest.mark.parametrize(
    ('by', 'recorder'),
    [
        (40 * DAY, 'leaps'),
        (40 * DAY, 'goes on'),
        (40 * DAY, 'none'),
        (60 * NANOSECONDS, 'goes on'),
        (-3600 * NANOSECONDS, 'goes on'),
        (-3600 * NANOSECONDS, 'none'),
    ],
)
def test_what_comes_before_a_leap_is_moved(recording, tmp_path, by, recorder):
    sound, _, still = seen(recording.write(tmp_path / 'sound'))
    found, rules, source = seen(leaping(recording, by, recorder).write(tmp_path / 'bag'))
    assert rules == ['clock_leap']
    assert [sensor for sensor, _ in found] == [sensor for sensor, _ in sound]
    off = [abs(one[1] - other[1]) for one, other in zip(found, sound, strict=True)]
    assert max(off) < 2_000_000  # what a sample of the IMU is early or late
    if recorder == 'leaps':
        assert source.info.duration == pytest.approx(still.info.duration, abs=0.01)
        assert len(source.truth().stamps) == len(still.truth().stamps)


def test_a_pause_of_days_is_none(recording, tmp_path):
    """Each sensor goes on at another moment of its period."""
    middle = (recording.start + recording.end) // 2
    away = range(middle, middle + 330_000_000)
    paused = recording.with_items(item for item in recording.items if item[0] not in away)
    assert seen(leaping(paused, 2 * DAY, 'leaps').write(tmp_path / 'bag'))[1] == []


def test_a_drive_that_begins_anew_is_none(recording, tmp_path):
    length = recording.end - recording.start + 10_000_000
    again = [(t + length, topic, m) for t, topic, m in recording.items]
    assert 'clock_leap' not in seen(recording.plus(again).write(tmp_path / 'bag'))[1]


def test_seconds_of_the_hour_that_strikes(recording, tmp_path):
    from lies.recording import LIDARS, restamped, stamp_of

    hour, middle = 3600 * NANOSECONDS, (recording.start + recording.end) // 2
    made = recording.each(LIDARS, lambda m: restamped(m, (stamp_of(m) - middle) % hour + 1000))
    sound, _, _ = seen(recording.write(tmp_path / 'sound'))
    found, rules, _ = seen(made.write(tmp_path / 'bag'))
    assert sorted(rules) == ['clock_leap', 'clock_offset', 'clock_offset']
    assert [sensor for sensor, _ in found] == [sensor for sensor, _ in sound]
    off = [abs(one[1] - other[1]) for one, other in zip(found, sound, strict=True)]
    assert max(off) < 200_000_000  # the latency of its messages


def test_a_small_step_is_left_to_the_mapper(recording, tmp_path):
    from lies.recording import LIDARS, restamped, stamp_of

    middle = (recording.start + recording.end) // 2
    made = recording.each(
        LIDARS, lambda m: restamped(m, stamp_of(m) + 3 * 10**8 * (stamp_of(m) > middle))
    )
    assert 'clock_leap' not in seen(made.write(tmp_path / 'bag'))[1]
