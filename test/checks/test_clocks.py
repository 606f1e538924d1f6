"""Clocks of sensors: what record times and spans tell of them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from incremental_mapper.checks.clocks import clock_findings
from incremental_mapper.checks.finding import Severity
from incremental_mapper.checks.sensor_clocks import SensorClock
from incremental_mapper.checks.usual_lags import usual_lags
from incremental_mapper.config import Config
from incremental_mapper.datasets.sensor_settings import offset_nanoseconds

NS = 1_000_000_000
START = 1_544_580_000 * NS
RATES = {'left': 10.0, 'right': 10.0, 'imu': 100.0, 'gnss': 1.0}
LATENCY = {'left': 0.11, 'right': 0.12, 'imu': 0.002, 'gnss': 0.2}


def clocks(
    ahead=None,
    seconds=60.0,
    names=tuple(RATES),
    recorder=0.0,
    pace=1.0,
    chosen=(),
    offsets=None,
    latency=LATENCY,
    jitter=0.004,
    drift=None,
):
    """A sound recording; ``ahead`` are seconds, or functions of the time, added to the stamps."""
    rng = np.random.default_rng(4)
    made = []
    for name in names:
        times = np.arange(0.0, seconds, 1.0 / RATES[name])
        wrong = (ahead or {}).get(name, 0.0)
        wrong = wrong(times) if callable(wrong) else np.full(len(times), wrong)
        offset = (offsets or {}).get(name, 0)
        stamps = START + np.round((times + wrong) * 1e6).astype(np.int64) * 1000 + offset
        late = latency[name] + jitter * rng.exponential(size=len(times))
        received = START + np.round((times / pace + late + recorder) * 1e9).astype(np.int64)
        made.append(SensorClock(name, stamps, received, offset, name in chosen))
    return made


def offsets_of(found):
    """Seconds of ``time_offset`` by sensor, of findings that are mended."""
    said = {}
    for finding in found:
        assert (finding.rule, finding.severity) == ('clock_offset', Severity.MENDED)
        section = finding.settings.get('lidars', finding.settings)
        said[finding.sensor] = section[finding.sensor]['time_offset']
    return said


def copied(made):
    """The same as a converter writes it that has no record times."""
    return [SensorClock(c.sensor, c.stamps, c.stamps, c.offset, c.chosen) for c in made]


def folder(made):
    """The same as files, of which nobody knows when they were recorded."""
    return [SensorClock(c.sensor, c.stamps, None, c.offset, c.chosen) for c in made]


def of_one_moment(made):
    """The same as a converter writes it that has no record times either, and writes zeros."""
    return [SensorClock(c.sensor, c.stamps, 0 * c.stamps, c.offset, c.chosen) for c in made]


@pytest.mark.parametrize('form', [list, copied, folder, of_one_moment])
@pytest.mark.parametrize(
    'names', [('left',), ('left', 'imu'), ('left', 'right', 'gnss'), tuple(RATES)]
)
def test_sound_clocks_are_not_accused(form, names):
    assert clock_findings(form(clocks(names=names))) == ()


@pytest.mark.parametrize('recorder', [-3.2, 37.0, 3600.0 * 24 * 365, -1.2e9])
@pytest.mark.parametrize('pace', [0.5, 1.0, 2.0])
def test_a_recorder_with_another_clock_or_a_playback_accuses_nobody(recorder, pace):
    assert clock_findings(clocks(recorder=recorder, pace=pace)) == ()


def test_latencies_of_drivers_accuse_nobody():
    slow = {'left': 0.3, 'right': 0.02, 'imu': 0.0, 'gnss': 0.9}
    assert clock_findings(clocks(latency=slow)) == ()


@pytest.mark.parametrize('recorder', [0.0, 1e8])
@pytest.mark.parametrize('pace', [1.0, 2.0])
@pytest.mark.parametrize('seconds', [37, 18, -18, 3600, -9 * 3600, 3600 + 37, 365 * 86400])
def test_time_scales_are_mended_exactly(seconds, pace, recorder):
    found = clock_findings(clocks({'imu': seconds}, pace=pace, recorder=recorder))
    assert offsets_of(found) == {'imu': -seconds}
    assert f'imu.time_offset: {-float(seconds)!r}' in found[0].remedy


@pytest.mark.parametrize('form', [copied, folder])
@pytest.mark.parametrize('seconds', [37, 18, 3600, -5 * 3600 - 1800, 365 * 86400])
@pytest.mark.parametrize('length', [5.0, 600.0])
def test_spans_alone_tell_time_scales(form, seconds, length):
    found = clock_findings(form(clocks({'left': seconds, 'right': seconds}, length)))
    assert offsets_of(found) == {'left': -seconds, 'right': -seconds}


@pytest.mark.parametrize('form', [copied, folder])
@pytest.mark.parametrize(('span', 'words'), [(3600, 'hour'), (86400, 'day'), (7 * 86400, 'week')])
def test_spans_tell_clocks_that_begin_again_with_the_hour(form, span, words):
    seconds = START // NS % span - START // NS
    found = clock_findings(form(clocks({'left': seconds, 'right': seconds})))
    assert offsets_of(found) == {'left': -seconds, 'right': -seconds}
    assert f'seconds of the {words}' in found[0].text


def test_spans_take_no_clock_from_power_up_for_one_that_begins_again():
    seconds = 700.0 - START / NS
    found = clock_findings(folder(clocks({'left': seconds, 'right': seconds})))
    assert {finding.rule for finding in found} == {'no_common_time'}


def test_the_leap_seconds_are_those_of_the_year():
    shift = (1_317_042_504 - 1_544_580_000) * NS  # September 2011
    made = [
        SensorClock(c.sensor, c.stamps + shift, c.received + shift)
        for c in clocks({'left': 34.0}, names=('left', 'imu', 'gnss'))
    ]
    (finding,) = clock_findings(made)
    assert finding.remedy.endswith('lidars.left.time_offset: -34.0')
    assert 'TAI, 34 s ahead of UTC' in finding.text


@given(
    boot=st.floats(1.0, 1e6),
    names=st.sets(st.sampled_from(['left', 'right', 'imu']), min_size=1),
    recorder=st.sampled_from([0.0, 0.2]),
)
def test_clocks_that_count_from_power_up_are_aligned_by_the_record_times(boot, names, recorder):
    shift = boot - START / NS
    found = clock_findings(clocks(dict.fromkeys(names, shift), recorder=recorder))
    said = offsets_of(found)
    assert said.keys() == names
    for seconds in said.values():
        assert abs(seconds + shift) < 0.35  # the latencies of its messages and of the others'


def test_sensors_on_one_clock_stay_together():
    found = clock_findings(clocks({'left': 700.0 - START / NS, 'imu': 700.0 - START / NS}))
    assert len(set(offsets_of(found).values())) == 1


def test_two_lidars_that_were_switched_on_together_are_aligned_each_for_itself():
    shift = 700.0 - START / NS
    same = dict.fromkeys(RATES, 0.01)
    found = clock_findings(clocks({'left': shift, 'right': shift - 0.2}, latency=same))
    said = offsets_of(found)
    assert said['right'] - said['left'] == pytest.approx(0.2, abs=0.01)


def test_an_offset_of_a_billion_seconds_is_exact_to_a_microsecond():
    shift = 731 * NS - START + 123_456_789
    stamps = START + np.arange(20) * NS // 10
    none = np.zeros(20, dtype=np.int64)
    found = clock_findings(
        [
            SensorClock('left', stamps + shift, stamps + none),
            SensorClock('imu', stamps, stamps + none),
        ]
    )
    config = Config.model_validate(found[0].settings)
    assert abs(offset_nanoseconds(config.lidars['left']) + shift) < 1000


def test_the_end_of_the_sweep_is_no_latency():
    sweep = NS // 10
    made = clocks(
        {'left': 700.0 - START / NS}, names=('left', 'imu'), latency={'left': 0.1, 'imu': 0.0}
    )
    made[0] = SensorClock('left', made[0].stamps, made[0].received, lead=sweep)
    said = offsets_of(clock_findings(made))
    assert said['left'] == pytest.approx(START / NS - 700.0, abs=0.005)


def test_an_offset_that_mends_is_not_told_again():
    made = clocks({'left': 37.0}, offsets={'left': -37 * NS}, chosen=['left'])
    assert clock_findings(made) == ()


def test_an_offset_that_is_wrong_is_told_with_the_right_one():
    made = clocks({'left': 37.0}, offsets={'left': 37 * NS}, chosen=['left'])
    (finding,) = clock_findings(made)
    assert finding.severity is Severity.WARNING
    assert finding.remedy == 'set lidars.left.time_offset: -37.0'


def test_stamps_a_little_behind_may_be_a_queue_and_are_told_only():
    (finding,) = clock_findings(clocks({'imu': -2.3}))
    assert (finding.rule, finding.severity) == ('clock_offset', Severity.WARNING)


def test_a_backlog_that_grows_is_not_mended():
    late = {'imu': lambda times: -0.5 * times}
    assert all(f.severity is Severity.WARNING for f in clock_findings(clocks(late)))


def test_stamps_of_the_future():
    (finding,) = clock_findings(clocks({'gnss': 0.8}, latency=dict.fromkeys(RATES, 0.01)))
    assert (finding.rule, finding.sensor) == ('future_stamps', 'gnss')


@pytest.mark.parametrize('size', [0.3, 2.0, -2.0, 37.0, 1.5e9])
def test_a_clock_that_steps(size):
    (finding,) = clock_findings(clocks({'left': lambda times: size * (times > 21.0)}))
    assert (finding.rule, finding.sensor) == ('clock_step', 'left')
    assert f'{size:+.2f} s' in finding.text
    assert finding.severity is Severity.WARNING


def test_a_pause_of_the_recorder_is_no_step():
    made = [
        SensorClock(c.sensor, c.stamps, c.received + 9 * NS * (c.stamps > START + 30 * NS))
        for c in clocks()
    ]
    assert clock_findings(made) == ()


def test_a_clock_that_drifts():
    (finding,) = clock_findings(clocks({'left': lambda times: 1e-4 * times}, 900.0))
    assert (finding.rule, finding.sensor) == ('clock_drift', 'left')
    assert '+100 ppm' in finding.text or '+99 ppm' in finding.text or '+101 ppm' in finding.text


def test_where_each_sensor_has_a_clock_of_its_own_the_recorder_is_right():
    each = {'left': 37.0, 'right': 1e6 - START / NS, 'imu': 3600.0, 'gnss': 18.0}
    found = offsets_of(clock_findings(clocks(each)))
    assert (found['left'], found['imu'], found['gnss']) == (-37.0, -3600.0, -18.0)
    assert found['right'] == pytest.approx(-each['right'], abs=0.2)  # but for its latency
    assert 'those of the recorder' in clock_findings(clocks(each))[0].text
    # It counts from power-up itself: then the receiver is believed.
    found = offsets_of(clock_findings(clocks(each, recorder=1e5 - START / NS)))
    assert (found['left'], found['imu']) == (-19.0, -3582.0) and 'gnss' not in found


def test_a_clock_that_runs_a_per_cent_fast_is_told_and_one_that_seems_slow_may_be_a_queue():
    (finding,) = clock_findings(clocks({'imu': lambda times: 0.01 * times}))
    assert (finding.rule, finding.sensor) == ('clock_drift', 'imu')
    assert clock_findings(clocks({'imu': lambda times: -0.01 * times})) == ()


def test_a_recorder_that_drifts_accuses_nobody():
    made = [
        SensorClock(c.sensor, c.stamps, c.received + (c.stamps - START) // 5000)
        for c in clocks(seconds=900.0)
    ]
    assert clock_findings(made) == ()


def test_stray_stamps_accuse_nobody():
    made = clocks()
    for clock, index in zip(made, (0, 5, -1, 3), strict=True):
        clock.stamps[index] += 3600 * NS
    assert clock_findings(made) == ()
    assert clock_findings(folder(made)) == ()


def test_record_times_of_a_conversion_topic_by_topic_tell_nothing():
    made = [
        SensorClock(
            c.sensor, c.stamps, START + 10**14 + np.arange(len(c.stamps)) * 1000 + 10**9 * i
        )
        for i, c in enumerate(clocks())
    ]
    assert clock_findings(made) == ()


@pytest.mark.parametrize('form', [copied, folder])
def test_sensors_that_share_no_time(form):
    found = clock_findings(form(clocks({'left': -1.5e9, 'right': -1.5e9}, 5.0)))
    assert {(f.rule, f.severity, f.sensor) for f in found} == {
        ('no_common_time', Severity.ERROR, 'imu'),
        ('no_common_time', Severity.ERROR, 'gnss'),
    }
    assert 'imu.time_offset: -1500000000.0' in found[0].remedy


def test_a_sensor_that_begins_late_or_ends_early_is_on_the_same_clock():
    made = clocks()
    late = SensorClock('imu', made[2].stamps[2000:], made[2].received[2000:])
    early = SensorClock('gnss', made[3].stamps[:10], made[3].received[:10])
    assert clock_findings([made[0], late, early]) == ()
    assert clock_findings(folder([made[0], late, early])) == ()


def test_a_usual_lag_is_that_of_most_messages_all_along():
    made = clocks({'imu': lambda times: np.where(times * 100 % 3 < 1, -30.0, 0.0)})
    usual = usual_lags(made)
    assert usual.keys() == RATES.keys()
    for name, lag in usual.items():
        assert lag / NS == pytest.approx(LATENCY[name], abs=0.01)


@pytest.mark.parametrize('at', [5.0, 30.0, 55.0])
def test_a_clock_that_is_set_has_no_usual_lag(at):
    usual = usual_lags(clocks({'left': lambda times: 37.0 * (times > at)}))
    assert usual.keys() == RATES.keys() - {'left'}


def test_without_record_times_no_lag_is_usual():
    assert usual_lags([SensorClock(c.sensor, c.stamps) for c in clocks()]) == {}


@pytest.mark.parametrize('pace', [0.1, 10.0])
def test_in_a_playback_no_lag_is_usual(pace):
    assert usual_lags(clocks(seconds=3.0, pace=pace)) == {}
